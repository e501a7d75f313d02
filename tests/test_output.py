"""Output files, read back with h5py, meshio and numpy."""

import io
import subprocess
import sys
import warnings
import xml.etree.ElementTree as ET
from pathlib import Path

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


@pytest.mark.parametrize("d", [1, 2, 3])
def test_static_fields_are_stored_once_and_named_in_every_frame(tmp_path, d):
    """Also those of a continued file, which may be given them again."""
    points, cells, _ = SIMPLEX[d]
    static = {"node_type": np.arange(len(points)) % 3, "rest": 2 * np.array(points)}
    for keep in (-np.inf, 1.5):
        with MeshFile(tmp_path / "m.xdmf", points, cells, keep, static=static) as f:
            for k in range(len(f.times), 4):
                f.write(k, p=np.full(len(points), k))
    with meshio.xdmf.TimeSeriesReader(tmp_path / "m.xdmf") as r:
        r.read_points_cells()
        for k in range(4):
            t, fields, _ = r.read_data(k)
            assert t == k and set(fields) == {"node_type", "rest", "p"} and np.all(fields["p"] == k)
            assert fields["node_type"].dtype.kind == "i"
            assert np.array_equal(fields["node_type"], static["node_type"])
            assert np.array_equal(fields["rest"][:, :d], static["rest"])
        assert r.num_steps == 4
    with h5py.File(tmp_path / "m.h5") as h:
        assert set(h) == {"points", "cells", "static", *"0123"}
        assert set(h["static"]) == set(static) and all(set(h[f"{k}/Node"]) == {"p"} for k in range(4))


def test_bad_static_fields(tmp_path):
    points, cells, _ = SIMPLEX[2]
    with pytest.raises(ValueError, match="node_type: shape"):
        MeshFile(tmp_path / "m.xdmf", points, cells, static={"node_type": np.zeros(3)})
    with MeshFile(tmp_path / "m.xdmf", points, cells, static={"node_type": np.zeros(4)}) as f:
        with pytest.raises(ValueError, match="node_type: this field is static"):
            f.write(0, node_type=np.zeros(4))
        assert not (tmp_path / "m.xdmf").exists()


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
    with TimeLog(path) as log:
        for k in range(21):
            log.write(2 * k, t=a[k], energy=np.float64(b[k]), n=np.int64(k**2))
            assert len(path.read_text().splitlines()) == 2 + k
        with pytest.raises(ValueError, match="columns"):
            log.write(42, t=0.0)
    table = np.genfromtxt(path, names=True, delimiter=",")
    assert table.dtype.names == ("step", "t", "energy", "n")
    assert np.array_equal(table["step"], np.arange(0, 42, 2))
    assert np.array_equal(table["t"], a) and np.array_equal(table["energy"], b)
    assert np.array_equal(table["n"], np.arange(21) ** 2)


def write_series(folder, frames, keep_before=None):
    """A particle file, mesh file and log of some frames; text of the light data and all arrays."""
    points, cells, _ = SIMPLEX[2]
    time, step = (-np.inf, None) if keep_before is None else (0.1 * keep_before, keep_before)
    with (
        ParticleFile(folder / "p.xdmf", time) as particles,
        MeshFile(folder / "m.xdmf", points, cells, time) as mesh,
        TimeLog(folder / "l.csv", step) as log,
    ):
        kept = len(particles.times), len(mesh.times), len(log.columns.get("t", []))
        for k in frames:
            x = np.random.default_rng(k).normal(size=(4 + k, 2))
            particles.write(0.1 * k, x, v=2 * x)
            mesh.write(0.1 * k, m=np.arange(4) + k)
            log.write(k, t=0.1 * k, x=x[0, 0])
    files = [(folder / name).read_text() for name in ("p.xdmf", "m.xdmf", "l.csv")]
    arrays = {}
    for name in ("p.h5", "m.h5"):
        with h5py.File(folder / name) as h:
            h.visititems(lambda key, a: arrays.update({key: a[()].tolist()} if hasattr(a, "shape") else {}))
    return kept, files, arrays


@pytest.mark.parametrize("keep", [0, 1, 3, 5])
def test_series_are_continued(tmp_path, keep):
    """Frames before a moment are kept, later ones written again: the files are those of one go."""
    whole, parts = tmp_path / "whole", tmp_path / "parts"
    _, files, arrays = write_series(whole, range(7))
    write_series(parts, range(5))
    kept, files_of_parts, arrays_of_parts = write_series(parts, range(keep, 7), keep_before=keep)
    assert kept == (keep, keep, keep)
    assert files_of_parts == files
    arrays_of_parts = {k: a for k, a in arrays_of_parts.items() if k in arrays}  # HDF5 keeps unused cells/n
    assert arrays_of_parts == arrays


def cut(path):
    path.write_bytes(path.read_bytes()[:-40])


def garble(path):
    path.write_bytes(b"\xff\x00,1\nstep" * 5)


@pytest.mark.parametrize("damage, warned", [(cut, 1), (garble, 1), (Path.unlink, 0)])
def test_series_that_cannot_be_continued_start_anew(tmp_path, damage, warned):
    """With a warning that names the file, unless it is just missing."""
    for name in ("p.xdmf", "p.h5", "m.xdmf", "l.csv"):
        write_series(tmp_path, range(5))
        damage(tmp_path / name)
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            kept, files, _ = write_series(tmp_path, range(3, 7), keep_before=3)
        anew = {"p": 0, "m": 1, "l": 2}[name[0]]
        if (damage, name) == (cut, "l.csv"):  # the rows that are kept are whole
            assert not caught and kept == (3, 3, 3)
            continue
        assert len(caught) == warned and all(f"/{name[0]}." in str(w.message) for w in caught)
        assert [k for i, k in enumerate(kept) if i != anew] == [3, 3] and kept[anew] == 0
        assert len(list(particle_steps(tmp_path / "p.xdmf"))) == (4 if anew == 0 else 7)


def test_import_needs_no_dolfinx():
    code = "import sys; sys.modules['dolfinx'] = None; import fempm.output"
    subprocess.run([sys.executable, "-c", code], check=True)


def test_light_data_are_appended(tmp_path):
    """A frame rewrites the closing tags and no more: the file is whole after each, as long as its frames."""
    path, sizes = tmp_path / "p.xdmf", [0]
    with ParticleFile(path) as f:
        for k in range(9):
            f.write(k, np.zeros((2, 2)), v=np.zeros(2))
            sizes.append(path.stat().st_size)
            assert len(ET.parse(path).findall(".//Time")) == k + 1
    assert len(set(np.diff(sizes)[1:])) == 1


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
