"""Gas and solids under stress: fragments, bodies that fill everything, collide, or leave; small parts."""

import numpy as np
import pytest
from coupled_scenes import GAMMA, advance, block_in_blast
from mesh_factory import rectangle

import fempm
from coupling import Coupled, IdealGas, Outflow, SlipWall, fractions, merging
from coupling.pressure import StepFailed
from coupling.scenes import planar_shock, shocked
from coupling.spaces import build_space

AIR = IdealGas(GAMMA)


def still(x):
    """Gas at rest."""
    return 1.0, 0.0, 1.0


def mass_of(scene):
    """Mass of the gas."""
    return scene.summary()["mass"]


@pytest.mark.parametrize("transfer, openness", [("apic", "least"), ("flip", "ball"), ("apic", "reflective")])
def test_fragments_in_a_blast(transfer, openness):
    """10,000 bodies of one particle each, filling 27 % of the space, hit by a shock of Mach 5."""
    rng = np.random.default_rng(0)
    mesh = fempm.box_mesh((0, 0), (2, 1), 0.04)
    volume = rng.uniform(0.3, 1.7, 10000) * 0.27 / 10000
    x = rng.uniform([0.5, 0.05], [1.5, 0.95], (10000, 2))
    body = fempm.Body(x, volume, fempm.NeoHookean(5.0, 100.0, 0.3), name="fragments")
    solid = fempm.Simulation(mesh, [body], [fempm.Wall("boundary", "slip")], transfer=transfer)
    scene = Coupled(solid, AIR, planar_shock(5.0, 0.3), [SlipWall("boundary")], openness=openness)
    start = scene.summary()
    end = advance(scene, 0.1).summary()
    assert abs(end["mass"] / start["mass"] - 1) < 1e-12
    assert abs(end["energy"] / start["energy"] - 1) < 0.02
    # the shock has reached them: they move along with it, no faster than the gas behind it
    assert 0.01 < scene.particles.velocity[:, 0].mean() < shocked(5.0, 1.0, 1.0)[1]


@pytest.mark.parametrize("share", [0.999, 0.97])
def test_body_that_fills_all_cells(share):
    """Particles leave a thousandth, or three hundredths, of every cell; a blast hits them."""
    mesh = fempm.box_mesh((0, 0), (1, 0.5), 0.05)
    x, volume = fempm.fill_box([0.4, 0], [1, 0.5], 0.0125)
    body = fempm.Body(x, share * volume, fempm.NeoHookean(3.0, 50.0, 0.3))
    solid = fempm.Simulation(mesh, [body], [fempm.Wall("boundary", "slip")])

    def initial(x):
        left = x[:, 0] < 0.2
        return np.where(left, 3.0, 1.0), 0.0, np.where(left, 10.0, 1.0)

    scene = Coupled(solid, AIR, initial, [SlipWall("boundary")])
    start = mass_of(scene)
    deep = mesh.points[:, 0] > 0.5
    assert np.all(scene.theta[deep] == 0)
    advance(scene, 0.3)
    assert mass_of(scene) == pytest.approx(start, rel=1e-12)
    assert 0.01 < np.ptp(scene.particles.jacobian) < 0.5


def test_bodies_collide_in_gas():
    """Two disks close a gap, with the gas between them: mass stays, and the momenta swap as they bounce."""
    mesh = fempm.box_mesh((0, 0), (1, 0.6), 0.03)
    bodies = []
    for name, x0, speed in (("left", 0.3, 1.0), ("right", 0.7, -1.0)):
        x, volume = fempm.fill_box([x0 - 0.1, 0.2], [x0 + 0.1, 0.4], 0.015)
        disk = np.linalg.norm(x - [x0, 0.3], axis=1) < 0.1
        rubber = fempm.NeoHookean(10.0, 300.0, 0.3)
        bodies.append(fempm.Body(x[disk], volume[disk], rubber, velocity=[speed, 0.0], name=name))
    solid = fempm.Simulation(mesh, bodies, [fempm.Wall("boundary", "slip")])
    scene = Coupled(solid, AIR, still, [SlipWall("boundary")])
    start = mass_of(scene)
    advance(scene, 0.4)
    left, right = (scene.particles.velocity[part, 0].mean() for part in scene.particles.ranges)
    assert mass_of(scene) == pytest.approx(start, rel=1e-12)
    assert left < -0.2 and right > 0.2
    assert abs(left + right) < 0.02


def test_body_leaves_through_an_outlet():
    """A block flies out of an open end with all its mass; nothing of it stays behind."""
    mesh = fempm.box_mesh((0, 0), (1, 0.6), 0.05)
    x, volume = fempm.fill_box([0.6, 0.2], [0.8, 0.4], 0.025)
    body = fempm.Body(x, volume, fempm.NeoHookean(10.0, 300.0, 0.3), velocity=[1.0, 0.0])
    walls = [fempm.Wall("top", "slip"), fempm.Wall("bottom", "slip")]
    solid = fempm.Simulation(mesh, [body], walls, outlets=["right"])
    ends = [Outflow("left"), Outflow("right"), SlipWall("top"), SlipWall("bottom")]
    scene = Coupled(solid, AIR, lambda x: (1.0, [[1.0, 0.0]], 1.0), ends)
    mass = scene.particles.mass.sum()
    advance(scene, 0.25)
    kept = scene.particles.mass.sum()
    assert 0 < kept < mass
    assert solid.escaped_mass + kept == pytest.approx(mass, rel=1e-12)
    assert np.all(np.diff(scene.gather("id")) > 0)
    advance(scene, 0.6)
    assert len(scene.particles) == 0 and np.all(scene.theta == 1)
    assert solid.escaped_mass == pytest.approx(mass, rel=1e-12)


def test_particles_must_not_leave_elsewhere(tmp_path):
    """Only named boundaries are outlets."""
    mesh = fempm.box_mesh((0, 0), (1, 1), 0.1)
    x, volume = fempm.fill_box([0.7, 0.4], [0.9, 0.6], 0.05)
    body = fempm.Body(x, volume, fempm.NeoHookean(10.0, 300.0, 0.3), velocity=[1.0, 0.0])
    with pytest.raises(KeyError, match="side"):
        fempm.Simulation(mesh, [body], outlets=["side"])
    with pytest.raises(TypeError, match="list of names"):
        fempm.Simulation(mesh, [body], outlets="right")
    solid = fempm.Simulation(mesh, [body], outlets=["left"])
    with pytest.raises(fempm.LostParticles):
        fempm.run(solid, until=0.5, output=tmp_path / "lost", progress=False)


@pytest.mark.parametrize("pair", ["B1-B0", "B2-B1"])
def test_fractions_add_up(pair):
    """Particles share out exactly their volume, and full cells are full to what their spacing resolves."""
    mesh = rectangle(8, 8)
    space = build_space(mesh, pair)
    x, volume = fempm.fill_box((0.1, 0.1), (0.9, 0.9), 0.03)
    solid = fempm.Simulation(mesh, [fempm.Body(x, volume, fempm.NeoHookean(1.0, 1.0))])
    p, sums = solid.particles, np.zeros((len(space.points), 1))
    lists = mesh.cells, mesh.points, mesh.inverse, mesh.neighbours, space.cell_nodes
    sizes = (1,) * 2, (1,) * space.cell_nodes.shape[1]
    fractions.add_volumes(*sizes, p.position, p.cell, p.volume[:, None].copy(), *lists, sums)
    assert sums.sum() == pytest.approx(0.64, rel=1e-13)
    inside = np.all(np.abs(space.points - 0.5) < 0.2, axis=1)
    # a lattice of h / 4, each point in four: hat functions are summed to (1 / 8)^2 of their curvature
    assert np.abs(sums[inside, 0] / space.volumes[inside] - 1).max() < 0.05


def test_open_share():
    """Nothing below 15 %, the share itself from 40 % on, and in between a line."""
    np.testing.assert_allclose(
        fractions.open_share(np.array([0.0, 0.3, 0.6, 0.725, 0.85, 1.1])),
        [1, 0.7, 0.4, 0.2, 0, 0],
        atol=1e-15,
    )


def test_states_are_shared_and_kept():
    """A chain of ever fuller nodes shares the state of the open one, totals stay; a pocket keeps its gas."""
    start, adjacent = merging.adjacency(np.array([[0, 1], [1, 2], [2, 3], [4, 5]]), 6)
    theta, held = np.array([1.0, 0.4, 0.2, 0.0, 0.0, 0.0]), np.array([True, True, True, True, True, False])
    root = np.arange(6, dtype=np.int32)
    merging.settle(np.arange(6), held, theta, start, adjacent, root)
    assert root.tolist() == [0, 0, 0, 0, 4, -1]
    assert theta.tolist() == [1.0, 0.4, 0.2, 0.0, merging.POCKET, 0.0]
    means = merging.means(root[:4], theta[:4], np.array([[2.0], [1.0], [0.0], [0.2]]))
    np.testing.assert_allclose(means[:, 0], 3.2 / 1.6)


def test_a_vertex_opens_only_beside_gas():
    """Where particles thin out inside of a solid no gas appears."""
    start, adjacent = merging.adjacency(np.array([[0, 1], [1, 2]]), 3)
    theta, root = np.array([1.0, 0.3, 0.3]), np.arange(3, dtype=np.int32)
    merging.settle(np.arange(3), np.array([True, False, False]), theta, start, adjacent, root)
    assert theta.tolist() == [1.0, 0.3, 0.0]
    assert root.tolist() == [0, 0, -1]


def test_shock_relations():
    """The Mach-3 shock of the cylinder scene (reference README)."""
    np.testing.assert_allclose(shocked(3.0, 1.4, 1.0), (5.4, 2.2222, 10.3333), rtol=1e-4)


def test_a_failed_step_is_repeated_in_halves():
    """Where the gas fails, the solid has not moved yet: both make the two halves, and no gas is lost."""
    scene = block_in_blast()
    start, solve = mass_of(scene), scene.stages.implicit_pressure
    calls = []

    def failing(*args, **options):
        calls.append(args)
        if len(calls) == 2:
            raise StepFailed("on purpose")
        return solve(*args, **options)

    scene.stages.implicit_pressure = failing
    for _ in range(3):
        scene.step(1e-3)
    assert (scene.steps, scene.repeated, scene.solid.steps) == (3, 1, 4)
    assert scene.solid.time == pytest.approx(scene.time)
    assert mass_of(scene) == pytest.approx(start, rel=1e-13)


def test_an_inverted_particle_ends_the_run(tmp_path):
    """With time and place, and the last state in a file."""
    scene = block_in_blast(density=0.1, young=10.0)
    with pytest.raises(fempm.SimulationError, match="inverted.*last state in .*_last.xdmf"):
        fempm.run(scene, until=0.5, dt=0.02, output=tmp_path / "broken", progress=False)
    assert (tmp_path / "broken_last.xdmf").exists()
