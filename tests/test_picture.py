"""Pictures, checked by their pixels."""

import subprocess
import sys
import time

import matplotlib.image
import numpy as np
import pytest

from fempm.picture import convergence_plot, snapshot, snapshot_strip

# Points and cells of a small mesh of each dimension.
MESH = {
    1: ([[0.0], [1.0], [2.5]], [[0, 1], [1, 2]]),
    2: ([[0.0, 0], [1, 0], [0, 1], [1, 1]], [[0, 1, 2], [1, 3, 2]]),
    3: ([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], [[0, 1, 2, 3]]),
}


def picture(path):
    image = matplotlib.image.imread(path)[..., :3]
    assert min(image.shape[:2]) > 200
    return image


@pytest.mark.parametrize("d", [1, 2, 3])
def test_snapshot_shows_the_values(tmp_path, d):
    x = np.random.default_rng(d).random((2000, d))
    points, cells = map(np.array, MESH[d])
    for name, values in (("low", np.zeros(2000)), ("high", np.ones(2000))):
        mesh = np.pad(points, [(0, 0), (0, 3 - d)]), cells
        snapshot(tmp_path / "out" / name, x, values, mesh, "u in m", "title", limits=(0, 1))
    low, high = picture(tmp_path / "out" / "low"), picture(tmp_path / "out" / "high")
    yellow = [np.mean((i[..., 0] > i[..., 2] + 0.3) & (i[..., 1] > 0.3)) for i in (low, high)]
    assert yellow[1] > yellow[0] + (0.1 if d > 1 else 0)
    snapshot(tmp_path / "plain.png", x)
    assert np.mean(picture(tmp_path / "plain.png") < 0.99) > 0.01


def test_snapshot_of_extreme_particles(tmp_path):
    for d in (1, 2, 3):
        snapshot(tmp_path / "one.png", np.ones((1, d)), [2.0])
        x = np.array([[0.0] * d, [1.0] * d, [np.nan] * d])
        snapshot(tmp_path / "nan.png", x, [1.0, np.nan, 0.0])
        assert picture(tmp_path / "nan.png").std() > 0


def test_near_spheres_hide_far_ones(tmp_path):
    """Seen from the front (negative y), a yellow wall hides a dark one behind, in any order."""
    a, b = np.meshgrid(np.linspace(0, 1, 60), np.linspace(0, 1, 60))
    front = np.stack([a.ravel(), 0 * a.ravel(), b.ravel()], axis=1)
    for order in (1, -1):
        x = np.concatenate([front, front + [0, 0.3, 0]][::order])
        values = np.repeat([1.0, 0.0][::order], len(front))
        snapshot(tmp_path / "p.png", x, values)
        image = picture(tmp_path / "p.png")
        rows, columns = image.shape[:2]
        centre = image[rows // 2 - 40 : rows // 2 + 40, columns // 3 - 40 : columns // 3 + 40]
        assert np.all(centre[..., 0] > centre[..., 2])


def test_many_particles_are_drawn_fast(tmp_path):
    x = np.random.default_rng(0).random((100_000, 3))
    start = time.perf_counter()
    snapshot(tmp_path / "p.png", x, x[:, 0])
    assert time.perf_counter() - start < 15


def test_strip_and_convergence_plot(tmp_path):
    rng = np.random.default_rng(0)
    frames = [(0.1 * k, rng.random((100 + k, 2)), np.full(100 + k, k)) for k in range(3)]
    snapshot_strip(tmp_path / "strip.png", frames, label="v in m/s")
    strip = picture(tmp_path / "strip.png")
    assert strip.shape[1] > 2 * strip.shape[0]
    h = 0.5 ** np.arange(4)
    convergence_plot(tmp_path / "order.png", h, {"a": h**2, "b": list(h)}, "error in m")
    assert picture(tmp_path / "order.png").std() > 0.05


def test_missing_matplotlib_says_how_to_get_it(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(ImportError, match=r"matplotlib.*pip install fempm\[plot\]"):
        snapshot(tmp_path / "p.png", np.zeros((3, 2)))


def test_import_needs_no_matplotlib():
    code = "import sys; sys.modules['matplotlib'] = None; import fempm.picture"
    subprocess.run([sys.executable, "-c", code], check=True)
