"""Many ranks give the results of one; what they exchange, against dense sums and plain NumPy."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from mesh_factory import MESHES, cube, rectangle
from small_scene import Alone

import fempm
from fempm import Body, LostParticles, NeoHookean, Simulation, SimulationError, Wall, solver
from fempm.diagnostics import angular_momentum, energies, linear_momentum
from fempm.parallel import Borders, Ranks, RemoteError, bisect, touched
from fempm.particles import Particles

# isort: split
from dolfinx import mesh as dmesh
from mpi4py import MPI

COMM = MPI.COMM_WORLD
RUBBER = NeoHookean(1.0, 30.0, 0.3)
many = pytest.mark.skipif(COMM.size == 1, reason="one rank has nothing to exchange")


def balls(mesh, d, speeds):
    """Two elastic balls on the diagonal with speeds along it."""
    for centre, speed in zip((0.3, 0.7), speeds):
        x = fempm.fill_cells(mesh, 2**d, lambda x, c=centre: np.linalg.norm(x - c, axis=1) < 0.17)
        yield Body(*x, RUBBER, velocity=speed * np.ones(d))


def collision(d, transfer):
    """Two balls, gravity, slip walls, a floor with friction."""
    mesh = rectangle(16, 12) if d == 2 else cube(5)
    fempm.mark_boundary(mesh, "floor", lambda x: x[-1] < 1e-9)
    floor = {tuple(sorted(f)) for f in mesh.facets("floor").tolist()}
    rest = [f for f in mesh.exterior_facets.tolist() if tuple(sorted(f)) not in floor]
    mesh.boundaries["rest"] = np.array(rest, np.int32)
    walls = [Wall("floor", "contact", friction=0.3), Wall("rest", "slip")]
    bodies = list(balls(mesh, d, (0.8, -0.8)))
    gradient = "consistent" if d == 2 else "plain"
    return Simulation(mesh, bodies, walls, gravity=-3 * np.eye(d)[-1], transfer=transfer, gradient=gradient)


def drift(imbalance):
    """A ball that crosses a long box towards a smaller one at rest."""
    mesh = rectangle(40, 8, 5.0, 1.0)
    ball = fempm.fill_cells(mesh, 4, lambda x: np.linalg.norm(x - [0.5, 0.5], axis=1) < 0.3)
    small = fempm.fill_cells(mesh, 4, lambda x: np.linalg.norm(x - [4.6, 0.5], axis=1) < 0.2)
    bodies = [Body(*ball, RUBBER, velocity=(3.0, 0.0)), Body(*small, RUBBER)]
    return Simulation(mesh, bodies, transfer="flip", gradient="plain", imbalance=imbalance)


def watched(monkeypatch):
    """Count particles that change ranks and times that cells are dealt out: {"moved", "dealt"}."""
    count = {"moved": 0, "dealt": 0}
    migrate, distribute = solver.migrate, Simulation.distribute

    def count_moved(*args):
        moved = migrate(*args)
        count["moved"] += moved
        return moved

    def count_dealt(*args):
        count["dealt"] += 1
        distribute(*args)

    monkeypatch.setattr(solver, "migrate", count_moved)
    monkeypatch.setattr(Simulation, "distribute", count_dealt)
    return count


def check_ids(s):
    """Every particle is on one rank, the one that owns its cell."""
    ids = s.ranks.concatenate(s.particles.id)
    np.testing.assert_array_equal(np.sort(ids), np.arange(s.num_particles))
    assert (s.owner[s.particles.cell] == s.ranks.rank).all()


def compare(s, one, tolerance):
    """State and totals of a simulation on all ranks and of the same alone, over the largest entry."""
    names = ("position", "velocity", "deformation_gradient", "stress", "mass", "volume")
    for name in (*names, *(f"state/{n}" for n in one.particles.state)):
        a, b = one.gather(name), s.gather(name)
        np.testing.assert_allclose(b, a, rtol=0, atol=tolerance * max(np.abs(a).max(), 1e-300), err_msg=name)
    np.testing.assert_array_equal(s.gather("cell"), one.gather("cell"))
    a, b = energies(one), energies(s)
    assert b == pytest.approx(a, rel=0, abs=10 * tolerance * max(map(abs, a.values())))
    assert s.stable_step() == pytest.approx(one.stable_step(), rel=10 * tolerance)


@pytest.mark.mpi
@pytest.mark.parametrize("d, transfer, steps", [(2, "apic", 1000), (2, "flip", 300), (3, "flip", 100)])
def test_same_as_on_one_rank(d, transfer, steps, monkeypatch):
    """1e-9 of the largest entry: only the order of sums differs, 1e-16 a step, collisions amplify that."""
    count = watched(monkeypatch)
    s = collision(d, transfer)
    start = s.gather("position")
    dt, steps = 0.5 * s.stable_step(), steps if COMM.size < 3 else steps // 3
    for step in range(steps):
        if step % 50 == 0:
            check_ids(s)
        s.step(dt)
    check_ids(s)
    moved = COMM.allreduce(count["moved"])
    assert np.abs(s.gather("position") - start).max() > 0.1
    assert COMM.size == 1 or moved > 20
    with monkeypatch.context() as patch:
        patch.setattr(solver, "Ranks", Alone)
        one = collision(d, transfer)
    for _ in range(steps if COMM.size > 1 else 0):
        one.step(dt)
    if COMM.size > 1:
        assert min(COMM.allgather(len(s.particles))) > 0.2 * s.num_particles / COMM.size
        compare(s, one, 1e-9)


@pytest.mark.mpi
@pytest.mark.parametrize("d", [2, 3])
def test_momentum_is_conserved(d, monkeypatch):
    """Across rank borders as on one rank: linear to 1e-13 of sum m |v|, angular to 1e-12 of sum m |x| |v|."""
    count = watched(monkeypatch)
    mesh = rectangle(16, 12) if d == 2 else cube(5)
    s = Simulation(mesh, list(balls(mesh, d, (1.0, -0.3))), transfer="apic", gradient="plain")
    p = s.particles
    start, spin = linear_momentum(s), angular_momentum(s)
    size = COMM.allreduce(p.mass @ np.linalg.norm(p.velocity, axis=1))
    for _ in range(60 if d == 2 else 78):
        s.step(0.005)
    assert np.abs(linear_momentum(s) - start).max() < 1e-13 * size
    assert np.abs(angular_momentum(s) - spin).max() < 1e-12 * size
    assert COMM.size == 1 or COMM.allreduce(count["moved"]) > 5


@pytest.mark.mpi
def test_cells_are_dealt_out_again(monkeypatch):
    """A body that leaves its rank's cells takes the borders with it; nothing else changes (1e-10)."""
    count = watched(monkeypatch)
    s = drift(1.1)
    with monkeypatch.context() as patch:
        patch.setattr(solver, "Ranks", Alone)
        one = drift(1.1)
    dealt, fullest = count["dealt"], []
    for _ in range(400):
        s.step(3e-3)
        one.step(3e-3)
        if s.steps % solver.BALANCE_EVERY == 0:
            check_ids(s)
            fullest.append(max(COMM.allgather(len(s.particles))))
    if COMM.size > 1:
        assert count["dealt"] - dealt >= 2
        # by cells of at most 6 particles, on as many levels as there are cuts
        assert max(fullest) <= 1.1 * s.num_particles / COMM.size + 1 + 6 * COMM.size
    else:
        assert count["dealt"] == dealt
    compare(s, one, 1e-10)


@pytest.mark.mpi
@pytest.mark.parametrize("what", ["inverted", "lost", "not a number"])
def test_an_error_is_raised_on_all_ranks(what):
    """The rank that has the particle names it; the others say that it happened elsewhere, and why."""
    block = Body(*fempm.fill_box((0.2, 0.2), (1.6, 0.8), 0.1), RUBBER)
    single = Body([[2.7, 0.5]], 0.01, RUBBER, name="single")
    s = Simulation(rectangle(12, 4, 3.0, 1.0), [block, single], gradient="plain")
    number = s.num_particles - 1
    p = s.particles
    mine = np.flatnonzero(p.id == number)
    p.velocity[mine] = {"inverted": 0.0, "lost": 1000.0, "not a number": np.nan}[what]
    if what == "inverted":
        p.deformation_gradient[mine] = np.diag([-1.0, 1.0])
    expected = SimulationError if what == "inverted" else (LostParticles, SimulationError)
    with pytest.raises(expected if len(mine) else RemoteError) as caught:
        s.step(1e-3)
    message = str(caught.value)
    assert "time 0.001, step 1" in message
    assert f"particle {number} of" in message or f"{number} at [" in message
    kinds = COMM.allgather(type(caught.value).__name__)
    assert kinds.count("RemoteError") == COMM.size - 1


@pytest.mark.mpi
def test_lost_at_the_start_on_all_ranks():
    """The first rank's errors of a mesh, and those of particles outside, come on all ranks."""
    with pytest.raises(LostParticles, match=": 1 at "):
        Simulation(rectangle(4, 4), [Body([[0.5, 0.5], [5.0, 0.5]], 0.1, RUBBER)])
    assert COMM.allreduce(1) == COMM.size


def random_particles(rng, counts, first_id=0):
    """Particles with random arrays of several shapes and types; `mark` repeats the id."""
    n = sum(counts)
    number = first_id + rng.permutation(n)
    arrays = {
        "position": rng.random((n, 2)),
        "mass": number + 0.5,
        "deformation_gradient": number[:, None, None] + np.arange(4).reshape(2, 2),
        "cell": rng.integers(0, 9, n).astype(np.int32),
        "id": number,
        "state/mark": number.astype(np.int8),
    }
    return arrays, np.repeat(np.arange(len(counts)), counts)


def test_replace():
    """Random sets leave and arrive, 1 to 4 bodies, some empty: the same rows as with plain lists."""
    rng = np.random.default_rng(0)
    for trial in range(400):
        bodies = rng.integers(1, 5)
        arrays, body = random_particles(rng, rng.integers(0, 12, bodies) * rng.integers(0, 2, bodies))
        particles = Particles({k: v.copy() for k, v in arrays.items()}, np.bincount(body, minlength=bodies))
        if trial % 3:
            particles.reserve(len(body) + int(rng.integers(0, 30)))
        leaving = np.flatnonzero(rng.random(len(body)) < rng.choice([0, 0.2, 0.8, 1]))
        new, new_body = random_particles(rng, rng.integers(0, 9, bodies) * rng.integers(0, 2, bodies), 1000)
        shuffle = rng.permutation(len(new_body))
        new, new_body = {k: v[shuffle] for k, v in new.items()}, new_body[shuffle]
        particles.replace(leaving, new, new_body)
        stay = np.setdiff1d(np.arange(len(body)), leaving)
        wanted = np.concatenate([body[stay], new_body])
        assert particles.counts == np.bincount(wanted, minlength=bodies).tolist()
        for b, part in enumerate(particles.ranges):
            rows = np.argsort(particles.id[part])
            expected = {k: np.concatenate([arrays[k][stay], new[k]])[wanted == b] for k in arrays}
            order = np.argsort(expected["id"])
            for name, values in expected.items():
                np.testing.assert_array_equal(particles.arrays[name][part][rows], values[order], err_msg=name)
                assert particles.arrays[name].dtype == arrays[name].dtype


@pytest.mark.parametrize("parts", [1, 2, 3, 4, 7, 8])
def test_bisect_balances(parts):
    """Each cut is off by less than one cell, so each part by one cell per cut above it."""
    rng = np.random.default_rng(parts)
    for d in (1, 2, 3):
        centres = rng.random((500, d))
        weights = rng.integers(0, 9, 500) * (centres[:, 0] < 0.6)
        owner = bisect(centres, weights, parts)
        assert owner.shape == (500,) and set(owner.tolist()) == set(range(parts))
        share = np.bincount(owner, weights, parts)
        cuts = np.ceil(np.log2(parts))
        # the thousandth of the mean weight that empty cells count is below one cell in all
        assert np.abs(share - weights.sum() / parts).max() <= (9 + 1) * cuts


@pytest.mark.parametrize("where", [0, 7, 19])
def test_bisect_of_one_heavy_cell(where):
    """All particles in one cell, or more parts than cells: some parts are empty, no cell is left out."""
    centres = np.linspace(0, 1, 20)[:, None]
    weights = np.zeros(20, int)
    weights[where] = 1000
    for parts in (2, 4, 8, 64):
        owner = bisect(centres, weights, parts)
        assert owner.min() >= 0 and owner.max() < parts
    assert len(set(bisect(centres[:2], np.ones(2), 8).tolist())) == 2


@pytest.mark.mpi
def test_vertex_fields(monkeypatch):
    """Complete on the first rank, also where the lowest rank that shares a vertex has no particle near it."""
    s = drift(1e9)
    with monkeypatch.context() as patch:
        patch.setattr(solver, "Ranks", Alone)
        one = drift(1e9)
    different = 0
    for _ in range(20):
        for x in (s, one):
            for _ in range(20):
                x.step(3e-3)
        a, b = one.vertex_fields(), s.vertex_fields()
        different += any(np.abs(a[k] - b[k]).max() > 1e-10 * np.abs(a[k]).max() for k in a)
    assert COMM.bcast(different) == 0


@pytest.mark.mpi
@many
def test_add_shared():
    """The rows a rank uses hold the sum over all ranks that use them; the others are left alone."""
    ranks, mesh = Ranks(), rectangle(12, 9)
    s = Simulation(mesh, [Body([[0.5, 0.5]], 1.0, RUBBER)], [Wall("boundary", "slip")], gradient="plain")
    rings = (s.kernel.ring_start, s.kernel.ring_vertex)
    nv = len(s.kernel.points)
    for seed in range(5):
        weights = np.random.default_rng(seed).integers(0, 5, len(mesh.cells))
        owner = bisect(mesh.points[mesh.cells].mean(axis=1), weights, ranks.size)
        borders = Borders(ranks, owner, *rings, nv)
        rng = np.random.default_rng([seed, ranks.rank])
        mine = touched(owner, ranks.rank, *rings, nv)
        stamp = np.where(mine & (rng.random(nv) < 0.7), 3, 1)
        values = rng.normal(size=(nv, 5))
        dense = COMM.allreduce(np.where(stamp[:, None] == 3, values, 0.0))
        expected = np.where(stamp[:, None] == 3, dense, values)
        borders.add_shared(values, stamp, 3)
        np.testing.assert_allclose(values, expected, rtol=0, atol=1e-14)


def same_everywhere(mesh):
    """The arrays of a mesh on this rank are those of the first one."""
    arrays = {k: v for k, v in vars(mesh).items() if isinstance(v, np.ndarray)}
    for name, group in (("", arrays), ("boundary ", mesh.boundaries), ("region ", mesh.regions)):
        first = COMM.bcast(group)
        assert list(first) == list(group)
        for key, array in group.items():
            np.testing.assert_array_equal(array, first[key], err_msg=name + key)


@pytest.mark.mpi
def test_meshes_are_the_same_on_all_ranks():
    pytest.importorskip("gmsh")
    for file, options in (("disk.geo", {"h": 0.3}), ("sphere.geo", {"h": 0.25}), ("metatron.msh", {})):
        same_everywhere(fempm.read_mesh(MESHES / file, **options))
    same_everywhere(cube(3))


def tagged(comm, d):
    """A DOLFINx mesh of the unit square or cube, its left and right facets tagged 1 and 2."""
    mesh = dmesh.create_unit_square(comm, 5, 4) if d == 2 else dmesh.create_unit_cube(comm, 3, 2, 3)
    sides = [dmesh.locate_entities_boundary(mesh, d - 1, lambda x, s=s: np.isclose(x[0], s)) for s in (0, 1)]
    facets = np.concatenate(sides).astype(np.int32)
    values = np.repeat([1, 2], [len(f) for f in sides]).astype(np.int32)
    order = np.argsort(facets)
    return mesh, dmesh.meshtags(mesh, d - 1, facets[order], values[order])


@pytest.mark.smoke
@pytest.mark.mpi
@pytest.mark.parametrize("d", [2, 3])
def test_spread_meshes(d):
    """Spread over the ranks or alone: the same points, cells and tagged facets under the same numbers."""
    one = fempm.from_dolfinx(*tagged(MPI.COMM_SELF, d), {"left": 1})
    mesh = fempm.from_dolfinx(*tagged(COMM, d), {"left": 1})
    np.testing.assert_array_equal(mesh.points, one.points)
    np.testing.assert_array_equal(mesh.cells, one.cells)
    assert list(mesh.boundaries) == list(one.boundaries) == ["boundary", "left", "2"]
    for name in mesh.boundaries:
        a, b = (np.sort(np.sort(m.facets(name)), axis=0) for m in (mesh, one))
        np.testing.assert_array_equal(a, b)
    assert (mesh.points[mesh.facets("left")][..., 0] == 0).all()
    same_everywhere(mesh)


@pytest.mark.slow
@pytest.mark.skipif(COMM.size > 1, reason="starts MPI itself")
def test_three_ranks():
    """The tests above marked mpi, on three ranks, but for the longest."""
    own = Path(sys.executable).parent / "mpirun"
    mpirun = str(own) if own.exists() else shutil.which("mpirun")
    env = {k: v for k, v in os.environ.items() if not k.startswith(("PMI", "OMPI_COMM", "PMIX"))}
    env |= {"OMPI_ALLOW_RUN_AS_ROOT": "1", "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1", "OMP_NUM_THREADS": "1"}
    env |= {"OMPI_MCA_rmaps_base_oversubscribe": "1", "OMPI_MCA_hwloc_base_binding_policy": "none"}
    env |= {"OMPI_MCA_mpi_yield_when_idle": "1", "NUMBA_NUM_THREADS": "1"}
    command = [
        mpirun,
        "-n",
        "3",
        sys.executable,
        "-m",
        "mpi4py",
        "-m",
        "pytest",
        "-q",
        "-x",
        "-m",
        "mpi",
        "-k",
        "not 2-",
    ]
    done = subprocess.run([*command, __file__], env=env, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stdout[-4000:] + done.stderr[-2000:]
