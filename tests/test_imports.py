"""What a scene does not use costs nothing; what a run writes is what it returns."""

import subprocess
import sys

import meshio
import numpy as np
import pytest
from mesh_factory import cube, graded_interval, rectangle

from fempm import Body, NeoHookean, Simulation, Wall, fill_box, fill_cells, run

MATERIAL = NeoHookean(density=2.0, young=10.0, poisson=0.2)


def block(d, **options):
    return Body(*fill_box([0.3] * d, [0.6] * d, 0.05), MATERIAL, **options)


@pytest.mark.smoke
@pytest.mark.parametrize("module", ["fempm", "fempm.cli", "fempm.compat", "fempm.output"])
def test_import_loads_no_optional_packages(module):
    """What only some scenes need is loaded by them; Numba's own look at scipy's version does not count.

    `fempm` is among the names to see that the check works.
    """
    names = {"torch", "gmsh", "matplotlib", "scipy", "meshio", "fempm"}
    code = f"import sys, numba; before = set(sys.modules); import {module}; new = set(sys.modules) - before"
    code += f"; print(*{{m.split('.')[0] for m in new}} & {names})"
    out = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    assert out.stdout.split() == ["fempm"]


def test_arrays_of_unused_parts_are_empty():
    """Affine matrices are APIC's, increments FLIP's, phi that of graded meshes, mirrors those of walls."""
    uniform, graded, walls = rectangle(8, 8, jitter=0), rectangle(8, 8), [Wall()]
    for transfer, affine, increments in (("apic", 1, 0), ("flip", 0, 1), ("pic", 0, 0)):
        s = Simulation(uniform, [block(2)], transfer=transfer)
        assert len(s.particles.affine) == affine * len(s.particles)
        assert len(s.increment) == increments * len(uniform.points)
    assert not any(s.active_parts().values())
    assert len(s.kernel.phi) == len(s.layer.owner) == 0 and len(s.kernel.points) == len(uniform.points)
    assert len(Simulation(uniform, [block(2)], transfer="flip", flip=0.0).increment) == 0
    plain = Simulation(graded, [block(2)], walls, gradient="plain", transfer="pic")
    assert len(plain.kernel.phi) == 0
    assert [name for name, on in plain.active_parts().items() if on] == ["mirror vertices along walls"]
    full = Simulation(
        graded,
        [block(2)],
        [Wall(velocity=lambda t: np.zeros(2))],
        gravity=(0, -1),
        body_force=lambda x, t: x,
        transfer="flip",
        threads=2,
    )
    off = [name for name, on in full.active_parts().items() if not on]
    unused = {"affine matrices (APIC)", "barrier contact", "F-bar", "condition on vertices", "several ranks"}
    assert set(off) == unused | {"outlets"}
    assert len(full.kernel.phi) == len(full.kernel.points) > len(graded.points)


@pytest.mark.parametrize("walls", [[], [Wall("boundary", "slip")]], ids=["open", "walls"])
def test_cells_and_vertices_without_particles(walls):
    """Mass and velocity vanish outside the rings of the cells that held particles, found here by sets."""
    mesh = rectangle(16, 16)
    s = Simulation(mesh, [block(2, velocity=(1.0, 0.2))], walls)
    around = [set(mesh.adjacency[a:b]) for a, b in zip(mesh.adjacency_start[:-1], mesh.adjacency_start[1:])]
    ever = set()
    for _ in range(20):
        cells = np.unique(s.particles.cell)
        ring = {v for c in cells for q in mesh.cells[c] for v in {q} | around[q]}
        ever |= ring
        assert s.num_active == len(cells) < len(mesh.cells) / 3
        np.testing.assert_array_equal(np.sort(s.active[: s.num_active]), cells)
        assert {v for v in s.vertices[: s.num_vertices] if v < len(mesh.points)} == ring
        outside = np.setdiff1d(np.arange(len(mesh.points)), list(ring))
        fields = s.vertex_fields()
        assert np.all(fields["mass"][outside] == 0) and np.all(fields["velocity"][outside] == 0)
        assert fields["mass"].sum() == pytest.approx(s.particles.mass.sum(), rel=1e-12)
        s.step(0.01)
    never = np.setdiff1d(np.arange(len(mesh.points)), list(ever))
    assert len(ever) > len(ring) and len(never) > 50
    assert np.all(s.grids[:, never] == 0) and np.all(s.velocity[never] == 0)


@pytest.mark.parametrize("d", [1, 2, 3])
def test_files_of_a_run(tmp_path, d):
    """The CSV equals record.log to the last bit, XDMF frames equal record.frames; vertices carry the mass."""
    mesh = {1: graded_interval(0.1, 1.0), 2: rectangle(6, 6), 3: cube(3)}[d]
    body = Body(*fill_cells(mesh, 2**d, lambda x: np.abs(x - 0.5).max(axis=1) < 0.3), MATERIAL, velocity=0.1)
    transfer = "apic" if d < 3 else "flip"
    s = Simulation(mesh, [body], [Wall()], -np.eye(d)[-1], transfer=transfer, gradient="plain")
    options = {"dt": 0.005, "frames": 4, "log_every": 5, "progress": False}
    record = run(s, 0.05, tmp_path / "a" / "run", watch=lambda s: {"count": s.steps}, **options)
    assert [p.name for p in record.files] == ["run.xdmf", "run_mesh.xdmf", "run.csv"]
    log = np.genfromtxt(tmp_path / "a" / "run.csv", delimiter=",", names=True)
    assert log.dtype.names == ("step", *record.log)
    for name, column in record.log.items():
        np.testing.assert_array_equal(log[name], column)
    np.testing.assert_array_equal(log["step"], record.log["count"])
    assert log["step"].tolist() == [0, 5, 10, 12]  # 2.5 steps a frame are rounded up
    assert log["time"][-1] == s.time == 0.05
    times = np.linspace(0, 0.05, 5)
    with meshio.xdmf.TimeSeriesReader(tmp_path / "a" / "run.xdmf") as reader:
        assert reader.num_steps == len(record.frames) == 5
        for k, (time, position, velocity) in enumerate(record.frames):
            reader.mesh_grid = reader.collection[k]
            points, _ = reader.read_points_cells()
            t, fields, _ = reader.read_data(k)
            assert t == time == times[k]
            np.testing.assert_array_equal(points[:, :d], position)
            np.testing.assert_array_equal(fields["velocity"].reshape(len(points), -1)[:, :d], velocity)
            np.testing.assert_array_equal(fields["id"].ravel(), np.arange(len(points)))
    with meshio.xdmf.TimeSeriesReader(tmp_path / "a" / "run_mesh.xdmf") as reader:
        points, cells = reader.read_points_cells()
        assert reader.num_steps == 5 and len(cells[0].data) == len(mesh.cells)
        for k in range(5):
            t, fields, _ = reader.read_data(k)
            assert t == times[k]
            assert fields["mass"].sum() == pytest.approx(s.particles.mass.sum(), rel=1e-12)


def test_energy_and_momentum_of_the_log():
    """Rigid translation: kinetic energy m v^2 / 2, momentum m v, spin m x cross v; gravity energy m g y."""
    body = block(2, velocity=(0.3, 0.4))
    s = Simulation(rectangle(8, 8), [body], gravity=(0.0, -2.0))
    log = run(s, 0.1, frames=1, log_every=1, progress=False).log
    m = 2.0 * 0.09
    t, vy = log["time"], 0.4 - 2.0 * log["time"]
    y = 0.45 + np.cumsum(np.append(0, np.diff(t)) * vy)
    expected = {
        "kinetic": 0.5 * m * (0.09 + vy**2),
        "elastic": 0 * t,
        "gravity": 2.0 * m * y,
        "momentum_x": m * 0.3 + 0 * t,
        "momentum_y": m * vy,
        "spin_z": m * ((0.45 + 0.3 * t) * vy - y * 0.3),
    }
    for name, column in expected.items():
        np.testing.assert_allclose(log[name], column, rtol=1e-11, atol=1e-13, err_msg=name)
    np.testing.assert_allclose(log["total"], log["kinetic"] + log["elastic"] + log["gravity"], rtol=1e-14)
