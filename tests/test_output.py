"""Output files, read back with h5py, meshio and numpy."""

import io
import subprocess
import sys

import h5py
import meshio
import numpy as np
import pytest

from fempm.output import MeshFile, ParticleFile, Progress, TimeLog

SIMPLEX = {
    1: ([[0.0], [1.0], [2.5]], [[0, 1], [1, 2]], "line"),
    2: ([[0.0, 0], [1, 0], [0, 1], [1, 1]], [[0, 1, 2], [1, 3, 2]], "triangle"),
    3: ([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], [[0, 1, 2, 3]], "tetra"),
}


def particle_steps(path):
    with meshio.xdmf.TimeSeriesReader(path) as r:
        for k in range(r.num_steps):
            r.mesh_grid = r.collection[k]
            points, cells = r.read_points_cells()
            yield points, cells, *r.read_data(k)[:2]


@pytest.mark.parametrize("d", [1, 2, 3])
def test_particles_read_back_exactly_and_padded(tmp_path, d):
    rng = np.random.default_rng(d)
    path = tmp_path / "new" / "folder" / "p.xdmf"
    frames = []
    with ParticleFile(path) as f:
        for k, n in enumerate((5, 8, 5)):
            x, s = rng.normal(size=(n, d)), rng.normal(size=(n, d, d))
            fields = {"mass": x[:, 0] ** 2, "velocity": 3 * x, "stress": s, "t": np.arange(n) - k}
            f.write(0.1 * k, x, **fields)
            frames.append((x, fields))
    steps = list(particle_steps(path))
    assert len(steps) == 3
    for k, ((x, fields), (points, cells, t, read)) in enumerate(zip(frames, steps, strict=True)):
        n = len(x)
        assert t == 0.1 * k
        assert points.shape == (n, 3)
        assert np.array_equal(points[:, :d], x) and not points[:, d:].any()
        assert cells[0].type == "vertex" and np.array_equal(cells[0].data[:, 0], np.arange(n))
        assert np.array_equal(read["mass"], fields["mass"])
        assert read["t"].dtype.kind == "i" and np.array_equal(read["t"], fields["t"])
        assert read["velocity"].shape == (n, 3) and not read["velocity"][:, d:].any()
        assert np.array_equal(read["velocity"][:, :d], fields["velocity"])
        tensor = read["stress"].reshape(n, 3, 3)
        assert np.array_equal(tensor[:, :d, :d], fields["stress"])
        assert np.count_nonzero(tensor) == n * d * d


@pytest.mark.parametrize("d", [1, 2, 3])
def test_mesh_file_stores_the_mesh_once(tmp_path, d):
    points, cells, kind = SIMPLEX[d]
    points = np.array(points)
    with MeshFile(tmp_path / "m.xdmf", points, cells) as f:
        for k in range(3):
            f.write(0.5 * k, u=k * points, p=points[:, 0] + k, cell_fields={"J": np.ones(len(cells))})
    with meshio.xdmf.TimeSeriesReader(tmp_path / "m.xdmf") as r:
        read_points, blocks = r.read_points_cells()
        assert np.array_equal(read_points[:, :d], points) and not read_points[:, d:].any()
        assert blocks[0].type == kind and np.array_equal(blocks[0].data, cells)
        for k in range(r.num_steps):
            t, fields, cell_fields = r.read_data(k)
            assert t == 0.5 * k
            assert np.array_equal(fields["u"][:, :d], k * points)
            assert np.array_equal(fields["p"], points[:, 0] + k)
            assert np.array_equal(cell_fields["J"][0], np.ones(len(cells)))
        assert r.num_steps == 3
    with h5py.File(tmp_path / "m.h5") as h:
        found = []
        h.visititems(lambda name, item: found.append(name) if hasattr(item, "shape") else None)
    assert len(found) == 2 + 3 * 3


def test_plane_strain_tensors_keep_their_third_direction(tmp_path):
    s = np.random.default_rng(0).normal(size=(4, 3, 3))
    with ParticleFile(tmp_path / "p.xdmf") as f:
        f.write(0, np.zeros((4, 2)), stress=s)
    with h5py.File(tmp_path / "p.h5") as h:
        assert np.array_equal(h["0/Node/stress"][()].reshape(4, 3, 3), s)


def test_killed_run_leaves_readable_files(tmp_path):
    code = """if True:
        import os, sys, numpy as np
        from fempm.output import ParticleFile
        f = ParticleFile(sys.argv[1])
        for k in range(3):
            f.write(k, np.full((4, 2), k), v=np.full(4, k))
        os._exit(3)
    """
    path = tmp_path / "p.xdmf"
    assert subprocess.run([sys.executable, "-c", code, path]).returncode == 3
    steps = list(particle_steps(path))
    assert [t for _, _, t, _ in steps] == [0, 1, 2]
    assert np.all(steps[2][3]["v"] == 2)
    assert not list(tmp_path.glob("*.part"))


def test_readable_from_another_process_while_open(tmp_path):
    path = tmp_path / "p.xdmf"
    code = "import h5py, sys; assert h5py.File(sys.argv[1], 'r')['1/Node/v'][()].tolist() == [1, 1]"
    with ParticleFile(path) as f:
        for k in range(2):
            f.write(k, np.zeros((2, 3)), v=np.full(2, k))
        subprocess.run([sys.executable, "-c", code, path.with_suffix(".h5")], check=True)
        f.write(2, np.zeros((2, 3)))
    assert len(list(particle_steps(path))) == 3


def test_bad_fields_are_named_and_nothing_is_written(tmp_path):
    with ParticleFile(tmp_path / "p.xdmf") as f:
        with pytest.raises(ValueError, match="mass.*shape"):
            f.write(0, np.zeros((4, 2)), mass=np.zeros(3))
        with pytest.raises(ValueError, match="phase"):
            f.write(0, np.zeros((4, 2)), phase=np.zeros(4, complex))
        with pytest.raises(ValueError, match="a/b"):
            f.write(0, np.zeros((4, 2)), **{"a/b": np.zeros(4)})
        with pytest.raises(ValueError, match="positions"):
            f.write(0, np.zeros((4, 4)))
        assert not (tmp_path / "p.xdmf").exists()
        f.write(0, np.zeros((4, 2)))
    assert len(list(particle_steps(tmp_path / "p.xdmf"))) == 1
    with pytest.raises(ValueError, match=".xdmf"):
        ParticleFile(tmp_path / "p.h5")
    with pytest.raises(ValueError, match="cells"):
        MeshFile(tmp_path / "m.xdmf", np.zeros((4, 3)), [[0, 1, 2]])


def test_time_log_round_trip_is_exact(tmp_path):
    path = tmp_path / "logs" / "run.csv"
    rng = np.random.default_rng(0)
    a, b = rng.normal(size=(2, 21)) * 10.0 ** rng.integers(-300, 300, 21)
    with TimeLog(path, every=2) as log:
        for k in range(21):
            log.write(k, t=a[k], energy=np.float64(b[k]), n=np.int64(k**2))
            assert len(path.read_text().splitlines()) == 2 + k // 2
        with pytest.raises(ValueError, match="columns"):
            log.write(22, t=0.0)
    table = np.genfromtxt(path, names=True, delimiter=",")
    assert table.dtype.names == ("step", "t", "energy", "n")
    assert np.array_equal(table["step"], np.arange(0, 21, 2))
    assert np.array_equal(table["t"], a[::2]) and np.array_equal(table["energy"], b[::2])
    assert np.array_equal(table["n"], np.arange(0, 21, 2) ** 2)


def test_import_needs_no_dolfinx():
    code = "import sys; sys.modules['dolfinx'] = None; import fempm.output"
    subprocess.run([sys.executable, "-c", code], check=True)


def test_progress_in_a_file_prints_few_lines():
    stream = io.StringIO()
    with Progress(2.0, stream=stream) as bar:
        for k in range(1001):
            bar.update(0.002 * k, note=f"step {k}")
    lines = stream.getvalue().splitlines()
    assert 5 <= len(lines) <= 12
    assert "100.0%" in lines[-1] and "2/2 s" in lines[-1] and "step 1000" in lines[-1]
    assert "\r" not in stream.getvalue()


def test_progress_on_a_terminal_is_one_short_line():
    class Terminal(io.StringIO):
        def isatty(self):
            return True

    stream = Terminal()
    with Progress(1.0, stream=stream) as bar:
        for k in range(1000):
            bar.update(k / 1000, note="n" * 500)
    text = stream.getvalue()
    assert text.count("\n") == 1 and text.count("\r") < 30
    assert "99.9%" in text.split("\r")[-1]
