"""What goes wrong says what, when and where."""

import re
from pathlib import Path

import meshio
import numpy as np
import pytest
from mesh_factory import cube, graded_interval, rectangle

from fempm import (
    Body,
    Hencky,
    LinearElastic,
    LostParticles,
    NeoHookean,
    SimplexMesh,
    Simulation,
    SimulationError,
    Wall,
    fill_box,
    mark_boundary,
    run,
)

MATERIAL = NeoHookean(density=1.0, young=1.0)


def block(**options):
    return Body(*fill_box((0.3, 0.3), (0.7, 0.7), 0.1), options.pop("material", MATERIAL), **options)


def read_frames(path):
    """[(time, points, fields), ...] of a particle file."""
    out = []
    with meshio.xdmf.TimeSeriesReader(path) as reader:
        for k in range(reader.num_steps):
            reader.mesh_grid = reader.collection[k]
            points, _ = reader.read_points_cells()
            time, fields, _ = reader.read_data(k)
            out.append((time, points, fields))
    return out


@pytest.mark.smoke
def test_unknown_options():
    """Each message repeats the wrong word and lists the right ones."""
    mesh, bodies = rectangle(4, 4), [block()]
    with pytest.raises(ValueError, match="transfer 'flipp': give one of apic, flip, pic"):
        Simulation(mesh, bodies, transfer="flipp")
    with pytest.raises(ValueError, match="gradient 'exact': give 'consistent' or 'plain'"):
        Simulation(mesh, bodies, gradient="exact")
    with pytest.raises(ValueError, match=r"flip 1.5: the share of FLIP lies in \[0, 1\]"):
        Simulation(mesh, bodies, transfer="flip", flip=1.5)
    with pytest.raises(ValueError, match="wall kind 'stick': give 'sticky', 'slip' or 'contact'"):
        Wall("boundary", "stick")
    mark_boundary(mesh, "floor", lambda x: x[1] < 1e-9)
    with pytest.raises(KeyError, match=r"unknown boundary tag 'flor': this mesh has \['boundary', 'floor'\]"):
        Simulation(mesh, bodies, [Wall("flor")])


def test_options_of_run():
    """Runs that could not advance are refused before anything is written."""
    s = Simulation(rectangle(4, 4), [block()])
    with pytest.raises(ValueError, match="until -1: the simulation is at time 0.0 already"):
        run(s, -1)
    for dt in (0.0, -0.1, np.nan):
        with pytest.raises(ValueError, match=f"dt {dt}: the time step must be positive"):
            run(s, 1, dt=dt)
    for options in ({"frames": 0}, {"log_every": 0}):
        with pytest.raises(ValueError, match="frames .*, log_every .*: give at least 1 each"):
            run(s, 1, **options)
    assert s.steps == 0


def test_walls_that_share_a_facet():
    """Both walls and the facet are named; a boundary inside the mesh is none."""
    mesh = mark_boundary(rectangle(4, 4, jitter=0), "floor", lambda x: x[1] < 1e-9)
    with pytest.raises(ValueError, match=r"walls 'boundary' and 'floor' share facet \(\d+, \d+\)"):
        Simulation(mesh, [block()], [Wall("boundary"), Wall("floor", "slip")])
    mesh.boundaries["middle"] = np.array([[6, 12]])
    with pytest.raises(ValueError, match=r"wall 'middle': facet \(6, 12\) lies inside the mesh"):
        Simulation(mesh, [block()], [Wall("middle")])


def test_particles_outside_at_the_start():
    """Particle 1 of the second body is number 17 of all."""
    stray = Body([[0.5, 0.5], [0.5, 1.25]], 0.01, MATERIAL)
    message = r"1 particle\(s\) outside the mesh \(which spans \[0. 0.\] to \[1. 1.\]\): 17 at \[0.5 , 1.25\]"
    with pytest.raises(LostParticles, match=message) as caught:
        Simulation(rectangle(4, 4), [block(), stray])
    np.testing.assert_array_equal(caught.value.ids, [17])


@pytest.mark.parametrize("d", [1, 2, 3])
def test_flat_cell(d):
    """A cell whose last corner is moved onto its first one has no volume."""
    mesh = {1: graded_interval(0.2, 1.0), 2: rectangle(3, 3), 3: cube(1)}[d]
    cells = mesh.cells.copy()
    cells[-1, -1] = cells[-1, 0]
    with pytest.raises(ValueError, match=rf"cell {len(cells) - 1} has no volume \(corners .*: remove it"):
        SimplexMesh(mesh.points, cells)


def test_unused_vertex():
    mesh = rectangle(3, 3)
    points = np.vstack([mesh.points[:5], [[0.5, 0.5]], mesh.points[5:]])
    with pytest.raises(ValueError, match="vertex 5 belongs to no cell: remove unused points from the mesh"):
        SimplexMesh(points, mesh.cells + (mesh.cells >= 5))


def squeeze(x):
    return 0.3 * (0.5 - x)


BLOW_UPS = {
    "squeezed": (block(velocity=squeeze), [Wall()], {"dt": 4.0}),
    "torn apart": (block(velocity=lambda x: -squeeze(x)), [], {"dt": 4.0}),
    "linear": (block(velocity=squeeze, material=LinearElastic(1.0, 1.0)), [Wall()], {"dt": 4.0}),
    "Hencky": (block(velocity=squeeze, material=Hencky(1.0, 1.0)), [Wall()], {"dt": 4.0}),
    "leaving": (block(velocity=(1.0, 0.0)), [], {}),
}


@pytest.mark.parametrize("name", BLOW_UPS)
def test_run_that_goes_wrong(tmp_path, name):
    """Time and step of the message are the simulation's; the named file holds the state of that time."""
    body, walls, options = BLOW_UPS[name]
    s = Simulation(rectangle(8, 8), [body], walls)
    with pytest.raises((SimulationError, LostParticles)) as caught:
        run(s, 1000.0, tmp_path / "out" / "bad", frames=1, progress=False, **options)
    message = str(caught.value)
    found = re.search(
        r"time ([\d.e+]+), step (\d+)[,:].*(?:position|at) \[ *([-\d.e+]+|nan|inf).*; last state in (\S+)$",
        message.replace("\n", " "),
    )
    assert found, message
    assert isinstance(caught.value, LostParticles) == (name == "leaving"), message
    assert float(found[1]) == pytest.approx(s.time, rel=1e-5) and int(found[2]) == s.steps > 0
    ((time, points, fields),) = read_frames(found[4])
    assert Path(found[4]) == tmp_path / "out" / "bad_last.xdmf"
    assert time == s.time
    np.testing.assert_array_equal(points[:, :2], s.gather("position"))
    np.testing.assert_array_equal(fields["velocity"][:, :2], s.gather("velocity"))


def test_last_state_without_output(tmp_path, monkeypatch):
    """It goes to the current directory, and nothing else is written."""
    monkeypatch.chdir(tmp_path)
    body = block(velocity=(1.0, 0.0))
    with pytest.raises(LostParticles, match="last state in fempm_last.xdmf$"):
        run(Simulation(rectangle(8, 8), [body]), 10.0, progress=False)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["fempm_last.h5", "fempm_last.xdmf"]
    ((_, points, _),) = read_frames("fempm_last.xdmf")
    assert len(points) == len(body.position) and points[:, 0].max() > 1


def test_files_up_to_the_failure_are_complete(tmp_path):
    """The block's front, at 0.65 + t, leaves at t = 0.35: frames every 0.1 up to there can be read."""
    s = Simulation(rectangle(8, 8), [block(velocity=(1.0, 0.0))])
    with pytest.raises(LostParticles):
        run(s, 1.0, tmp_path / "bad", frames=10, log_every=1, progress=False)
    times, points, _ = zip(*read_frames(tmp_path / "bad.xdmf"))
    assert times == pytest.approx([0, 0.1, 0.2, 0.3])
    assert [x[:, 0].max() for x in points] == pytest.approx([0.65, 0.75, 0.85, 0.95], rel=1e-9)
    log = np.genfromtxt(tmp_path / "bad.csv", delimiter=",", names=True)
    assert 0.3 <= log["time"][-1] < 0.35
