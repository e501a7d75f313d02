"""Pictures of a gas, checked by their pixels, and what is measured in it."""

import sys

import matplotlib.image
import numpy as np
import pytest
from mesh_factory import cube, graded_interval, rectangle

from coupling import cases
from coupling.picture import colour_strip, profiles, schlieren_strip, spread
from coupling.probes import probe, stopped_pressure, wall_force
from coupling.riemann import State, star_state


@pytest.mark.parametrize(
    "mesh", [graded_interval(0.3, 2.0), rectangle(5, 4), cube(3)], ids=["1d", "2d", "3d"]
)
def test_probes_are_exact_for_linear_fields(mesh):
    """Inside and at vertices; NaN outside."""
    low, high = mesh.points.min(axis=0), mesh.points.max(axis=0)
    x = np.concatenate([low + np.random.default_rng(1).random((50, mesh.dim)) * (high - low), mesh.points])
    slope = np.arange(1, mesh.dim + 1)
    field = np.stack([mesh.points @ slope, 3 - mesh.points @ slope], axis=1)
    assert probe(mesh, x, field) == pytest.approx(np.stack([x @ slope, 3 - x @ slope], axis=1), abs=1e-12)
    assert np.isnan(probe(mesh, [high + 1, low - 1], field[:, 0])).all()


def test_force_on_a_wall():
    """Constant pressure pushes nothing that is closed, one that rises with y lifts (Archimedes)."""
    mesh = rectangle(6, 5)
    area = mesh.volumes.sum()
    assert wall_force(mesh, "boundary", np.ones(len(mesh.points))) == pytest.approx(0, abs=1e-13)
    assert wall_force(mesh, "boundary", mesh.points[:, 1]) == pytest.approx([0, area], abs=1e-13)


def test_stopped_pressure():
    """Continuous at Mach 1, to second order p + rho u^2 / 2 below, and NACA 1135's tables above."""
    assert stopped_pressure(1.0) == pytest.approx(stopped_pressure(1 + 1e-12))
    assert stopped_pressure(0.01) == pytest.approx(1 + 0.7e-4, abs=1e-8)
    assert [stopped_pressure(m) for m in (2, 3)] == pytest.approx([5.640, 12.061], abs=1e-3)


def test_cases():
    """The exact solution of a tube holds its star state; others say that they have none."""
    p, u = star_state(State(1, 0, 1), State(0.125, 0, 0.1))
    density, velocity, pressure = cases.CASES["sod"].exact(np.array([0.0, 0.62, 1.0]), 0.15)
    assert (velocity[1], pressure[1]) == pytest.approx((u, p)) and density[[0, 2]].tolist() == [1, 0.125]
    with pytest.raises(ValueError, match="no exact solution"):
        cases.exact_density("blast", np.zeros(1))
    x = np.linspace(0, 1, 11)
    assert cases.mean_error(x, x, 0 * x) == pytest.approx(0.5)


def image(path):
    pixels = matplotlib.image.imread(path)[..., :3]
    assert min(pixels.shape[:2]) > 200
    return pixels


@pytest.mark.parametrize(
    ("mesh", "plane"), [(rectangle(20, 20), None), (cube(6), (2, 0.4))], ids=["2d", "3d"]
)
def test_strips(tmp_path, mesh, plane):
    """Where the density changes it is dark, where it does not it is white; colours follow the values."""
    still, steep = np.zeros(len(mesh.points)), np.ones(len(mesh.points))
    frames = [(0.0, {"schlieren": still}), (1.0, {"schlieren": steep})]
    light, dark = (schlieren_strip(tmp_path / f"{k}", mesh, frames[k : k + 1], plane=plane) for k in (0, 1))
    assert np.mean(image(light) > 0.9) > 0.8 and np.mean(image(dark) < 0.1) > 0.3
    path = colour_strip(tmp_path / "colours", mesh, frames, "schlieren", "label", plane=plane)
    yellow = (image(path)[..., 0] > 0.9) & (image(path)[..., 2] < 0.3)
    assert 0.05 < np.mean(yellow) < 0.6


def test_a_strip_needs_a_plane(tmp_path):
    for mesh in (graded_interval(0.3, 2.0), cube(2)):
        frame = [(0.0, {"schlieren": np.ones(len(mesh.points))})]
        with pytest.raises(ValueError, match="plane"):
            schlieren_strip(tmp_path / "no", mesh, frame)


def test_profiles(tmp_path, monkeypatch):
    """Points over a black line; a clear message without matplotlib."""
    x = np.linspace(0, 1, 50)
    fields = {name: np.sin(6 * x) for name in ("density", "velocity", "pressure")}
    points = image(profiles(tmp_path / "points", x, fields, marks=[0.5]))
    both = image(profiles(tmp_path / "deep" / "both", x, fields, (x, fields), title="title"))
    blue = [np.mean(p[..., 2] - p[..., 0] > 0.3) for p in (points, both)]
    assert min(blue) > 1e-3 and np.mean(both.max(axis=2) < 0.1) > np.mean(points.max(axis=2) < 0.1)
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    with pytest.raises(ImportError, match=r"pip install fempm\[plot\]"):
        profiles(tmp_path / "none", x, fields)


def test_frames_of_a_strip():
    """Evenly, the last one with them, the first one not, none twice."""
    assert spread(list(range(21)), 4) == [5, 10, 15, 20]
    assert spread(list(range(3)), 5) == [1, 2] and spread([0], 3) == [0]
