"""Meshes and trajectories of the learned models, against meshio, fempm, DOLFINx and TFRecords made here."""

import itertools
import pickle
import subprocess
import sys

import h5py
import meshio
import numpy as np
import pytest
from gnn_fields import box, dolfinx_box, random_fields

from fempm import compat  # before DOLFINx: it loads the right MPI
from fempm.output import MeshFile
from gnn.graph import INFLOW, OUTFLOW, WALL, from_cells, read_mesh_graph
from gnn.trajectory import Trajectory, write_trajectory

# isort: split
from dolfinx import fem, io
from dolfinx import mesh as dmesh
from mpi4py import MPI

COMM = MPI.COMM_SELF
KIND = {1: "line", 2: "triangle", 3: "tetra"}


def write_mesh_file(path, d, nt, static=None):
    """fempm's file of random fields; points, cells and the fields."""
    points, cells = box(d)
    fields = random_fields(len(points), d, nt, seed=d)
    with MeshFile(path, points, cells, static=static) as f:
        for k in range(nt):
            f.write(0.25 * k, cell_fields={"J": np.ones(len(cells))}, **{n: a[k] for n, a in fields.items()})
    return points, cells, fields


@pytest.mark.smoke
def test_imports_no_solver_and_no_torch():
    code = "import sys\nfor name in ('torch', 'dolfinx', 'fempm', 'coupling'): sys.modules[name] = None\n"
    code += "import gnn.graph, gnn.xdmf, gnn.trajectory, gnn.tfrecord"
    subprocess.run([sys.executable, "-c", code], check=True)


@pytest.mark.parametrize("d", [1, 2, 3])
def test_edges_are_those_of_the_cells(d):
    """Each pair of a cell's nodes once, counted in plain Python."""
    points, cells = box(d)
    graph = from_cells(points, cells)
    pairs = {tuple(sorted(map(int, p))) for cell in cells for p in itertools.combinations(cell, 2)}
    assert graph.edges.dtype == np.int32 and [tuple(e) for e in graph.edges.tolist()] == sorted(pairs)
    assert graph.cells.dtype == np.int64 and graph.points.dtype == np.float64
    assert graph.node_type.dtype == np.int32 and not graph.node_type.any()


def test_flat_coordinates_are_dropped_as_far_as_the_cells_allow():
    flat = [[0.0, 0, 0], [1, 0, 0], [2, 0, 0], [0, 1, 0]]
    assert from_cells(flat, [[0, 1, 3], [1, 2, 3]]).points.shape == (4, 2)
    assert from_cells(flat[:3], [[0, 1], [1, 2]]).points.shape == (3, 1)
    assert from_cells(flat, [[0, 1], [1, 2], [2, 3]]).points.shape == (4, 2)
    lifted = np.array(flat) + [0, 0, 0.5]
    assert from_cells(lifted, [[0, 1, 3], [1, 2, 3]]).points.shape == (4, 3)


SQUARE = np.array([[0.0, 0], [1, 0], [0, 1], [1, 1]])


@pytest.mark.parametrize(
    "points, cells, node_type, message",
    [
        (SQUARE, np.zeros((0, 3), int), None, "no cells"),
        (SQUARE, [[0, 1, 2]], None, r"1 node\(s\) in no cell: 3"),
        (np.repeat(SQUARE, 3, axis=0), [[0, 1, 2]], None, r"9 node\(s\) in no cell: 3, 4, 5, 6, 7, \.\.\."),
        (SQUARE + [[0, 0], [0, np.nan], [0, 0], [0, 0]], [[0, 1, 2], [1, 3, 2]], None, "point 1 .* nan"),
        (SQUARE, [[0, 1, 2], [1, 4, 2]], None, "nodes 0 to 4, there are 4"),
        (SQUARE, [[0, 1, 2], [1, -1, 2]], None, "nodes -1 to 2, there are 4"),
        (SQUARE, [[0, 1, 2], [1, 3, 3]], None, r"cell 1 has a node twice: \[1, 3, 3\]"),
        (SQUARE, [[0, 1, 3, 2]], None, r"shape \(1, 4\) in 2 dim"),
        (SQUARE, [[0.0, 1, 2], [1, 3, 2]], None, "cells of type float64"),
        (SQUARE, [[0, 1, 2], [1, 3, 2]], [0, 0, 9, 0], "node 2 has type 9, types are 0 to 8"),
        (SQUARE, [[0, 1, 2], [1, 3, 2]], [0, 0, 0.5, 0], "integers expected, there is 0.5"),
        (SQUARE, [[0, 1, 2], [1, 3, 2]], [0, 0], r"node_type has shape \(2,\), not \(4,\)"),
        (SQUARE[0], [[0, 1, 2]], None, r"points have shape \(2,\)"),
    ],
)
def test_bad_meshes_are_named(points, cells, node_type, message):
    with pytest.raises(ValueError, match=message):
        from_cells(points, cells, node_type)


@pytest.mark.smoke
@pytest.mark.parametrize("d", [1, 2, 3])
@pytest.mark.parametrize("encoding", ["HDF5", "ASCII"])
def test_node_types_from_facet_tags_of_dolfinx(tmp_path, d, encoding):
    """Nodes by their coordinates; those of two tags get the larger type, and cell tags are no facet tags."""
    mesh, path = dolfinx_box(d), tmp_path / "mesh.xdmf"
    sides = {2: lambda x: x[0] == 0, 3: lambda x: x[0] == 2, 5: lambda x: (x[1] == 0) & (d > 1)}
    where = {tag: dmesh.locate_entities_boundary(mesh, d - 1, f) for tag, f in sides.items()}
    facets = np.concatenate(list(where.values())).astype(np.int32)
    tags = np.repeat(list(where), [len(w) for w in where.values()]).astype(np.int32)
    order = np.argsort(facets)
    facet_tags = dmesh.meshtags(mesh, d - 1, facets[order], tags[order])
    cell_tags = dmesh.meshtags(mesh, d, np.arange(2, dtype=np.int32), np.full(2, 3, np.int32))
    facet_tags.name, cell_tags.name = "facets", "regions"
    with io.XDMFFile(COMM, str(path), "w", getattr(io.XDMFFile.Encoding, encoding)) as file:
        file.write_mesh(mesh)
        compat.write_meshtags(file, mesh, cell_tags)
        compat.write_meshtags(file, mesh, facet_tags)
    types = {**({5: WALL} if d > 1 else {}), 3: OUTFLOW, 2: INFLOW}
    graph = read_mesh_graph(path, types)
    x = graph.points
    assert x.shape[1] == d and len(graph.cells) == len(compat.cell_vertices(mesh))
    corners = x[graph.cells]
    volumes = np.abs(np.linalg.det(corners[:, 1:] - corners[:, :1])) / (1, 2, 6)[d - 1]
    assert volumes.sum() == pytest.approx(2, rel=1e-14)
    expected = np.where(x[:, 0] == 0, INFLOW, np.where(x[:, 0] == 2, OUTFLOW, 0))
    if d > 1:
        expected = np.where(x[:, 1] == 0, WALL, expected)
    assert np.array_equal(graph.node_type, expected) and len(set(expected)) == (3 if d == 1 else 4)
    assert not read_mesh_graph(path).node_type.any()
    with pytest.raises(ValueError, match=r"mesh.xdmf has no facets tagged \[7\], only \[2, 3"):
        read_mesh_graph(path, types | {7: WALL})
    with pytest.raises(ValueError, match="tag 2 has node type 9, types are 0 to 8"):
        read_mesh_graph(path, {2: 9})


@pytest.mark.parametrize("d", [1, 2, 3])
@pytest.mark.parametrize("options", [{"data_format": "HDF"}, {"compression": None}, {"data_format": "XML"}])
def test_meshes_of_meshio(tmp_path, d, options):
    points, cells = box(d)
    stored = np.pad(points, ((0, 0), (0, max(0, 2 - d))))  # meshio knows no 1D points
    mesh = meshio.Mesh(stored, [(KIND[d], cells)], point_data={"node_type": np.arange(len(points)) % 7})
    meshio.write(tmp_path / "m.xdmf", mesh, **options)
    graph = read_mesh_graph(tmp_path / "m.xdmf")
    assert np.array_equal(graph.points, points) and np.array_equal(graph.cells, cells)
    assert np.array_equal(graph.node_type, np.arange(len(points)) % 7)


def test_files_that_hold_no_mesh_for_us(tmp_path):
    path = tmp_path / "m.xdmf"
    triangles, quad = [[0, 1, 2], [1, 3, 2]], [[0, 1, 3, 2]]
    cases = {
        "quadrilateral cells": ([("quad", quad)], {"data_format": "XML"}),
        "mixed cells": ([("triangle", triangles), ("line", [[0, 1]])], {"data_format": "XML"}),
        "data as Binary .*write them as HDF or XML": ([("triangle", triangles)], {"data_format": "Binary"}),
    }
    for message, (blocks, options) in cases.items():
        meshio.write(path, meshio.Mesh(SQUARE, blocks), **options)
        with pytest.raises(ValueError, match=f"m.xdmf: .*{message}"):
            read_mesh_graph(path)
    for text, message in (("no mesh", "not an XDMF"), ("<Xdmf><Domain/></Xdmf>", "holds no mesh")):
        path.write_text(text)
        with pytest.raises(ValueError, match=f"m.xdmf.*{message}"):
            read_mesh_graph(path)
    with pytest.raises(FileNotFoundError, match="no.xdmf"):
        read_mesh_graph(tmp_path / "no.xdmf")
    meshio.write(path, meshio.Mesh(SQUARE, [("triangle", triangles[:1])]), data_format="XML")
    with pytest.raises(ValueError, match=r"m.xdmf: 1 node\(s\) in no cell: 3"):
        read_mesh_graph(path)


@pytest.mark.parametrize("d", [1, 2, 3])
def test_trajectory_of_fempm(tmp_path, d):
    path = tmp_path / "run.xdmf"
    n = len(box(d)[0])
    static = {"node_type": np.arange(n) % 7, "stiffness": np.linspace(1, 2, n)}
    points, cells, fields = write_mesh_file(path, d, 4, static)
    run = Trajectory(path)
    assert np.array_equal(run.graph.points, points) and np.array_equal(run.graph.cells, cells)
    assert np.array_equal(run.graph.node_type, static["node_type"])
    assert run.times.tolist() == [0, 0.25, 0.5, 0.75] and len(run) == 4 and run.path == path
    assert run.fields == {"p": 1, "v": d, "stiffness": 1} and run.static == {"stiffness"}
    for name, written in (fields | {"stiffness": np.tile(static["stiffness"], (4, 1))}).items():
        written = written.astype(np.float32)
        for k in range(4):
            read = run.read(name, k)
            assert read.dtype == np.float32 and np.array_equal(read, written[k])
        assert np.array_equal(run.read_many(name, 1, 4), written[1:4])
        assert run.read_many(name, 2, 2).shape == (0, *written.shape[1:])
    copy = pickle.loads(pickle.dumps(run))  # for workers that load data
    assert np.array_equal(copy.read("v", 3), fields["v"][3].astype(np.float32))
    with pytest.raises(KeyError, match=r"run.xdmf has no field 'w' .*'p', 'stiffness', 'v'"):
        run.read("w", 0)
    for k in (-1, 4):
        with pytest.raises(IndexError, match=f"run.xdmf has no frames {k} to"):
            run.read("v", k)


def test_tensors_keep_their_nine_components(tmp_path):
    points, cells = box(2)
    stress = np.random.default_rng(0).normal(size=(len(points), 3, 3))
    with MeshFile(tmp_path / "m.xdmf", points, cells) as f:
        f.write(0, stress=stress, v=stress[:, 0])
    run = Trajectory(tmp_path / "m.xdmf")
    assert run.fields["stress"] == 9
    assert np.array_equal(run.read("stress", 0), stress.reshape(-1, 9).astype(np.float32))
    with pytest.raises(ValueError, match="vector v has a component out of the 2D mesh in frame 0"):
        run.read("v", 0)


@pytest.mark.smoke
@pytest.mark.parametrize("d", [1, 2, 3])
def test_trajectory_of_dolfinx_functions(tmp_path, d):
    """One series a function in the file; values by a formula in the positions and the time."""
    mesh = dolfinx_box(d)
    p = fem.Function(compat.functionspace(mesh, ("Lagrange", 1)), name="p")
    v = fem.Function(compat.functionspace(mesh, ("Lagrange", 1, (d,))), name="v")
    with io.XDMFFile(COMM, str(tmp_path / "f.xdmf"), "w") as file:
        file.write_mesh(mesh)
        for t in (0.0, 0.5, 1.0):
            p.interpolate(lambda x, t=t: x[0] + t)
            v.interpolate(lambda x, t=t: (1 + t) * x[:d])
            file.write_function(p, t)
            file.write_function(v, t)
    run = Trajectory(tmp_path / "f.xdmf")
    x = run.graph.points
    assert run.times.tolist() == [0, 0.5, 1] and run.fields == {"p": 1, "v": d}
    for k, t in enumerate(run.times):
        # Interpolation multiplies in double precision, reading rounds to single.
        assert np.allclose(run.read("p", k), x[:, 0] + t, rtol=1e-6, atol=1e-7)
        assert np.allclose(run.read("v", k).reshape(x.shape), (1 + t) * x, rtol=1e-6, atol=1e-7)


@pytest.mark.smoke
@pytest.mark.parametrize("d", [1, 2, 3])
def test_written_trajectories_come_back_and_meshio_reads_them(tmp_path, d):
    points, cells = box(d)
    graph = from_cells(points, cells, np.arange(len(points)) % 7)
    fields = random_fields(len(points), d, 3) | {
        "wide": np.random.default_rng(1).normal(size=(3, len(points), 4))
    }
    static = {"thickness": points[:, :1] + 1 if d > 1 else points[:, 0] + 1}
    path = tmp_path / "new" / "t.xdmf"
    write_trajectory(path, graph, [0.0, 0.1, 0.3], fields, static)
    run = Trajectory(path)
    assert run.times.tolist() == [0.0, 0.1, 0.3] and run.static == {"thickness"}
    for name in vars(graph):
        assert np.array_equal(getattr(run.graph, name), getattr(graph, name)), name
    for name, a in fields.items():
        assert np.array_equal(run.read_many(name, 0, 3), a.astype(np.float32))
    assert np.array_equal(run.read("thickness", 2), (points[:, 0] + 1).astype(np.float32))
    with meshio.xdmf.TimeSeriesReader(path) as r:
        read_points, blocks = r.read_points_cells()
        assert np.array_equal(read_points[:, :d], points) and not read_points[:, d:].any()
        assert blocks[0].type == KIND[d] and np.array_equal(blocks[0].data, cells)
        for k in range(3):
            t, read, _ = r.read_data(k)
            assert t == run.times[k] and set(read) == {"node_type", "thickness", *fields}
            assert np.array_equal(read["node_type"], graph.node_type)
            assert np.array_equal(read["v"][:, :d], fields["v"][k].astype(np.float32))
        assert r.num_steps == 3
    with h5py.File(path.with_suffix(".h5")) as h:
        assert set(h["static"]) == {"node_type", "thickness"} and set(h["1"]) == set(fields)


def test_a_flat_mesh_may_move_in_space(tmp_path):
    """Positions with more components than the mesh has directions are no vectors of the plane."""
    points, cells = box(2)
    position = np.random.default_rng(0).normal(size=(2, len(points), 3))
    write_trajectory(tmp_path / "t.xdmf", from_cells(points, cells), [0, 1], {"position": position})
    run = Trajectory(tmp_path / "t.xdmf")
    assert run.graph.points.shape[1] == 2 and run.fields == {"position": 3}
    assert np.array_equal(run.read_many("position", 0, 2), position.astype(np.float32))


def test_trajectory_of_meshio(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # meshio puts the HDF5 file of a series there
    points, cells = box(2)
    fields = random_fields(len(points), 2, 3)
    for options in ({"data_format": "HDF"}, {"data_format": "XML"}):
        with meshio.xdmf.TimeSeriesWriter(str(tmp_path / "s.xdmf"), **options) as w:
            w.write_points_cells(points, [(KIND[2], cells)])
            for k in range(3):
                w.write_data(k, point_data={name: a[k] for name, a in fields.items()})
        run = Trajectory(tmp_path / "s.xdmf")
        assert np.array_equal(run.graph.cells, cells) and run.fields == {"p": 1, "v": 2}
        for name, a in fields.items():
            assert np.array_equal(run.read_many(name, 0, 3), a.astype(np.float32))


def test_only_the_frames_asked_for_are_read(tmp_path, monkeypatch):
    write_mesh_file(tmp_path / "m.xdmf", 2, 9, {"node_type": np.zeros(15)})
    read, original = [], h5py.Dataset.__getitem__

    def spy(dataset, *args, **kwargs):
        read.append(dataset.name)
        return original(dataset, *args, **kwargs)

    monkeypatch.setattr(h5py.Dataset, "__getitem__", spy)
    run = Trajectory(tmp_path / "m.xdmf")
    assert sorted(read) == ["/cells", "/points", "/static/node_type"]
    read.clear()
    run.read("v", 7)
    run.read_many("p", 2, 4)
    assert read == ["/7/Node/v", "/2/Node/p", "/3/Node/p"]


def test_read_while_another_process_has_the_file_locked(tmp_path):
    write_mesh_file(tmp_path / "m.xdmf", 2, 3)
    code = "import sys; from gnn.trajectory import Trajectory; Trajectory(sys.argv[1]).read('p', 2)"
    with h5py.File(tmp_path / "m.h5", "r+", locking=True):
        subprocess.run([sys.executable, "-c", code, tmp_path / "m.xdmf"], check=True)


def edit(path, old, new, count=1):
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, count))


def test_bad_trajectories_are_named(tmp_path):
    path = tmp_path / "m.xdmf"
    points, cells, _ = write_mesh_file(path, 2, 3)
    n = len(points)

    def fails(message, call=lambda: Trajectory(path)):
        with pytest.raises(ValueError, match=f"m.xdmf: .*{message}"):
            call()
        write_mesh_file(path, 2, 3)

    run = Trajectory(path)
    with h5py.File(path.with_suffix(".h5"), "r+") as h:
        h["1/Node/v"][4, 1] = np.nan
        h["2/Node/p"][3] = 1e300
    assert np.isfinite(run.read("v", 0)).all()
    with pytest.raises(ValueError, match="m.xdmf: field p is inf in frame 2 at node 3"):
        with np.errstate(over="ignore"):
            run.read("p", 2)
    fails("field v is nan in frame 1 at node 4", lambda: run.read_many("v", 0, 3))
    edit(path, f'Dimensions="{n}" NumberType="Float" Precision="8">m.h5:/1', 'Dimensions="3">m.h5:/1')
    fails(rf"field p has shape \(3,\) in frame 1, the mesh has {n} nodes")
    edit(path, 'Name="p"', 'Name="q"')
    fails("field q is missing in frame 1")
    edit(path, 'Value="0.5"', 'Value="0.1"')
    fails("no time series with increasing times")
    with h5py.File(path.with_suffix(".h5"), "r+") as h:
        del h["1/Node/p"]
        h["1/Node/p"] = np.zeros(3)
    fails(r"m.h5:/1/Node/p has shape \(3,\), not", lambda: run.read("p", 1))
    with h5py.File(path.with_suffix(".h5"), "r+") as h:
        del h["1/Node/p"]
    fails("cannot read m.h5:/1/Node/p", lambda: run.read("p", 1))
    path.with_suffix(".h5").unlink()
    fails("there is no file .*m.h5")
    path.with_suffix(".h5").write_bytes(b"no HDF5")
    with pytest.raises(ValueError, match="m.h5 cannot be read"):
        Trajectory(path)
    with pytest.raises(FileNotFoundError, match="no.xdmf"):
        Trajectory(tmp_path / "no.xdmf")
    meshio.write(path, meshio.Mesh(points, [(KIND[2], cells)]), data_format="XML")
    with pytest.raises(ValueError, match="no time series"):
        Trajectory(path)


def test_the_mesh_may_be_stored_again_but_not_change(tmp_path):
    path = tmp_path / "m.xdmf"
    points, *_ = write_mesh_file(path, 2, 2)
    edit(path, "m.h5:/points", "m.h5:/again")
    with h5py.File(path.with_suffix(".h5"), "r+") as h:
        h["again"] = h["points"][()]
    assert np.array_equal(Trajectory(path).graph.points, points)
    with h5py.File(path.with_suffix(".h5"), "r+") as h:
        h["again"][0, 0] += 0.1
    with pytest.raises(ValueError, match="m.xdmf: the mesh of frame 1 is not that of the first.*'position'"):
        Trajectory(path)
    with MeshFile(path, *box(2)) as f:
        for k in range(2):
            f.write(k, node_type=np.full(len(points), k))
    with pytest.raises(ValueError, match="m.xdmf: node_type changes in time"):
        Trajectory(path)


def test_bad_input_is_not_written(tmp_path):
    points, cells = box(2)
    graph, n = from_cells(points, cells), len(points)
    cases = [
        ([0, 1], {"p": np.zeros((3, n))}, None, "field p has 3 frames, there are 2 times"),
        ([0, 1], {"p": np.zeros((2, n + 1))}, None, rf"p has shape \({n + 1},\), not \({n},\)"),
        ([0, 0], {"p": np.zeros((2, n))}, None, "times must increase"),
        ([0, 1], {"a/b": np.zeros((2, n))}, None, "must not contain .*'a/b'"),
        ([0, 1], {"p": np.zeros((2, n))}, {"p": np.zeros(n)}, "field p is given twice"),
        ([0, 1], {"node_type": np.zeros((2, n))}, None, "field node_type is given twice"),
    ]
    for times, fields, static, message in cases:
        with pytest.raises(ValueError, match=f"t.xdmf: .*{message}"):
            write_trajectory(tmp_path / "t.xdmf", graph, times, fields, static)
    with pytest.raises(ValueError, match="t.h5: the file name must end in .xdmf"):
        write_trajectory(tmp_path / "t.h5", graph, [0], {})
