"""The generator of cylinder flows: exact channel flow, order in time, files, and that it can go on."""

import importlib
import sys
from pathlib import Path

import h5py
import meshio
import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent.parent / "demos"))
from fempm import compat  # noqa: E402

# isort: split
from dolfinx import mesh as dmesh  # noqa: E402
from mpi4py import MPI  # noqa: E402

cylinder = importlib.import_module("dataset_cylinder")
PARAMETERS = {"centre": (0.3, 0.18), "radius": 0.06, "peak": 1.0}


@pytest.fixture(scope="module")
def trajectory(tmp_path_factory):
    """Path of a mini trajectory of three frames."""
    path = tmp_path_factory.mktemp("cylinder") / "cylinder_0000.xdmf"
    cylinder.make(path, "mini", PARAMETERS, frames=3)
    return path


def empty_channel(peak, dt, viscosity):
    """Flow through the channel without a cylinder."""
    size = [cylinder.LENGTH, cylinder.HEIGHT]
    mesh = dmesh.create_rectangle(MPI.COMM_SELF, [[0.0, 0.0], size], [12, 5])

    def facets(*conditions):
        found = [dmesh.locate_entities_boundary(mesh, 1, condition) for condition in conditions]
        return np.concatenate(found)

    inlet, outlet = facets(lambda x: np.isclose(x[0], 0)), facets(lambda x: np.isclose(x[0], size[0]))
    walls = facets(lambda x: np.isclose(x[1], 0), lambda x: np.isclose(x[1], size[1]))

    def inflow(x):
        return np.outer(4 * peak * x[:, 1] * (size[1] - x[:, 1]) / size[1] ** 2, [1, 0])

    return cylinder.IncompressibleFlow(mesh, inlet, walls, outlet, inflow, dt, viscosity=viscosity)


def test_poiseuille_flow_is_exact():
    """Parabola and linear pressure lie in the spaces: closed form up to round-off.

    The velocity is disturbed first, so that the steps and not only the Stokes flow at the start must find it:
    at viscosity 0.5 the slowest mode decays with 0.5 (pi / 0.41)^2 = 29 1/s, by exp(-117) in 4 s.
    """
    peak, viscosity, height = 0.7, 0.5, cylinder.HEIGHT
    flow = empty_channel(peak, 0.02, viscosity)
    flow.velocity = 1.2 * flow.velocity
    for _ in range(200):
        flow.step()
    x, y = compat.vertex_points(flow.mesh).T
    velocity, pressure = flow.vertex_values()
    slope = 8 * viscosity * peak / height**2
    # Rounding of direct solutions, with condition numbers of some thousand.
    assert np.abs(velocity - np.outer(4 * peak * y * (height - y) / height**2, [1, 0])).max() < 1e-11
    assert np.abs(pressure - slope * (cylinder.LENGTH - x)).max() < 1e-11 * slope
    assert flow.mean_divergence() < 1e-11


def test_drag_of_steady_flow():
    """Benchmark 2D-1 of Schaefer and Turek (Re = 20): drag coefficient from 5.57 to 5.59.

    1 %: the polygon of 26 sides in place of the circle has 0.5 % less diameter, as the root of its area.
    """
    mesh, facets = cylinder.channel_mesh((0.2, 0.2), 0.05, 0.012, 0.06, length=2.2)
    flow = cylinder.channel_flow(mesh, facets, 0.3, 0.005)
    for _ in range(600):
        flow.step()
    # Mean velocity 0.2 m/s, diameter 0.1 m
    assert flow.force(facets["cylinder"])[0] * 2 / (0.2**2 * 0.1) == pytest.approx(5.58, rel=0.01)


def test_unstable_flow_is_reported():
    """A wiggle at a step 50 times as long as the stable one."""
    with pytest.raises(ValueError, match="dt = 0"):
        empty_channel(1.0, 0, 1e-3)
    flow = empty_channel(1.0, 0.5, 1e-3)
    flow.velocity = flow.velocity * (1 + 0.1 * np.sin(np.arange(flow.velocity.shape[1])))
    with pytest.raises(FloatingPointError, match="0.5 s is too long"):
        for _ in range(100):
            flow.step()


def test_second_order_in_time():
    """Halving the step leaves a quarter of the error, of velocity and forces, up to the next order."""
    mesh, facets = cylinder.channel_mesh(PARAMETERS["centre"], 0.06, 0.03, 0.08)
    found = []
    for steps in (40, 80, 160):
        flow = cylinder.channel_flow(mesh, facets, 1.0, 0.08 / steps)
        for _ in range(steps):
            flow.step()
        found.append((flow.velocity, flow.force(facets["cylinder"])))
    for coarse, middle, fine in zip(*found):
        ratio = np.linalg.norm(coarse - middle) / np.linalg.norm(middle - fine)
        assert ratio == pytest.approx(4, abs=0.5)


def test_what_flows_in_flows_out():
    """At the outlet it is (2/3) peak height again, per m of depth."""
    mesh, facets = cylinder.channel_mesh(PARAMETERS["centre"], 0.06, 0.03, 0.08)
    flow = cylinder.channel_flow(mesh, facets, 1.0, 0.001)
    for _ in range(100):
        flow.step()
    x, (velocity, _) = compat.vertex_points(mesh), flow.vertex_values()
    end = np.flatnonzero(np.isclose(x[:, 0], cylinder.LENGTH))
    end = end[np.argsort(x[end, 1])]
    through = (velocity[end[1:], 0] + velocity[end[:-1], 0]) / 2 @ np.diff(x[end, 1])
    # The trapezoidal rule with spacing h = 0.08 loses h^2 / 12 times the jump of the slope, 8 peak / height.
    assert through == pytest.approx(2 / 3 * cylinder.HEIGHT, abs=1.2 * 0.08**2 / 12 * 8 / cylinder.HEIGHT)
    assert flow.mean_divergence() < 1e-2


def test_node_types_by_position(trajectory):
    """Every vertex on a side has the type of that side, found from its coordinates; all others have none."""
    with meshio.xdmf.TimeSeriesReader(trajectory) as series:
        points, _ = series.read_points_cells()
        types = series.read_data(0)[1]["node_type"]
    x, y = points[:, :2].T
    expected = np.zeros(len(x))
    expected[np.isclose(x, 0)] = 4
    expected[np.isclose(x, 1.6)] = 5
    expected[np.isclose(y, 0) | np.isclose(y, 0.41)] = 6
    distance = np.hypot(x - PARAMETERS["centre"][0], y - PARAMETERS["centre"][1])
    expected[np.isclose(distance, PARAMETERS["radius"])] = 6
    assert np.array_equal(types, expected)
    assert {0, 4, 5, 6} == set(types) and (types[np.isclose(distance, PARAMETERS["radius"])] == 6).sum() > 10


def test_frames(trajectory):
    """Three frames 0.01 s apart, boundary values as given, parameters as attributes, about 500 nodes."""
    with meshio.xdmf.TimeSeriesReader(trajectory) as series:
        points, _ = series.read_points_cells()
        frames = [series.read_data(k) for k in range(series.num_steps)]
    assert np.allclose([t for t, _, _ in frames], [0.01, 0.02, 0.03])
    assert 450 < len(points) < 750
    y = points[:, 1]
    for _, fields, _ in frames:
        velocity, types = fields["velocity"], fields["node_type"]
        parabola = np.outer(4 * PARAMETERS["peak"] * y * (0.41 - y) / 0.41**2, [1, 0, 0])
        # Single precision
        assert np.allclose(velocity[types == 4], parabola[types == 4], atol=1e-6)
        assert not velocity[types == 6].any() and np.isfinite(fields["pressure"]).all()
    assert not np.array_equal(frames[0][1]["velocity"], frames[2][1]["velocity"])
    with h5py.File(trajectory.with_suffix(".h5")) as h5:
        assert h5.attrs["size"] == "mini" and h5.attrs["radius"] == PARAMETERS["radius"]
        assert np.array_equal(h5.attrs["centre"], PARAMETERS["centre"])


def test_too_long_a_step_is_halved(tmp_path):
    """Steps of 0.01 s, a whole cell of 0.02 m at 2 m/s, are unstable; the file has the shorter ones."""
    path = tmp_path / "a.xdmf"
    cylinder.make(path, "mini", PARAMETERS | {"peak": 2.0}, frames=10, refine=0.05)
    with h5py.File(path.with_suffix(".h5")) as h5:
        assert h5.attrs["steps_per_frame"] > 1
    with meshio.xdmf.TimeSeriesReader(path) as series:
        assert series.num_steps == 10


def test_set_goes_on(tmp_path, monkeypatch, capsys):
    """What is complete stays, what was interrupted is made again, with the same parameters."""
    monkeypatch.setitem(cylinder.SIZES, "mini", (0.04, 0.1, 2))
    cylinder.main(["--trajectories", "2", "--out", str(tmp_path)])
    files = sorted(path.name for path in tmp_path.iterdir())
    assert files == [f"cylinder_000{k}.{end}" for k in (0, 1) for end in ("h5", "xdmf")]
    kept = (tmp_path / "cylinder_0000.h5").stat().st_mtime_ns
    with h5py.File(tmp_path / "cylinder_0001.h5") as h5:
        first = h5["1/Node/velocity"][:]
    (tmp_path / "cylinder_0001.xdmf").unlink()
    (tmp_path / ".cylinder_0001").mkdir()
    capsys.readouterr()
    cylinder.main(["--trajectories", "2", "--out", str(tmp_path)])
    assert capsys.readouterr().out.count("xdmf") == 1
    assert (tmp_path / "cylinder_0000.h5").stat().st_mtime_ns == kept
    assert sorted(path.name for path in tmp_path.iterdir()) == files
    with h5py.File(tmp_path / "cylinder_0001.h5") as h5:
        assert h5.attrs["radius"] == cylinder.draw(0, 1)["radius"]
        assert np.array_equal(h5["1/Node/velocity"], first)
    with pytest.raises(ValueError, match="give another folder"):
        cylinder.main(["--trajectories", "2", "--seed", "1", "--out", str(tmp_path)])
