"""The mesh queries of fempm.compat against small meshes whose answers are known."""

import logging
import os
import subprocess
import sys
from itertools import permutations

import meshio
import numpy as np
import pytest
import ufl

from fempm import compat  # before DOLFINx: it loads the right MPI
from fempm.gmsh_reader import gmsh_model_to_mesh

# isort: split
from dolfinx import fem, io, la
from dolfinx import mesh as dmesh
from mpi4py import MPI

COMM = MPI.COMM_WORLD


def unit_simplices(dim, n):
    """Points and cells of the unit interval, square or cube, cut into simplices (Kuhn)."""
    grid = np.stack(np.meshgrid(*[np.arange(n + 1)] * dim, indexing="ij"), -1).reshape(-1, dim)
    stride = (n + 1) ** np.arange(dim)[::-1]
    corners = grid[(grid < n).all(axis=1)] @ stride
    cells = [
        np.stack([corners + stride[list(order[:k])].sum() for k in range(dim + 1)], axis=1)
        for order in permutations(range(dim))
    ]
    return grid / n, np.concatenate(cells)


def unit_mesh(comm, dim, n, partitioner=None):
    """The same as a mesh, its points given by rank 0 alone."""
    points, cells = unit_simplices(dim, n) if comm.rank == 0 else (None, None)
    return compat.create_simplex_mesh(comm, points, cells, partitioner)


def missing_cells(mesh):
    """Number of vertices of owned cells around which this rank lacks a cell."""
    tdim = mesh.topology.dim
    vertices = compat.cell_vertices(mesh)
    vertex_map = mesh.topology.index_map(0)
    owned = vertices[: mesh.topology.index_map(tdim).size_local]
    num_local = vertex_map.size_local + vertex_map.num_ghosts
    everywhere = la.vector(vertex_map, 1)
    everywhere.array[:] = np.bincount(owned.ravel(), minlength=num_local)
    compat.sum_ghosts(everywhere)
    here = np.bincount(vertices.ravel(), minlength=num_local)
    seen = np.unique(owned)
    return int(np.sum(here[seen] != everywhere.array[seen]))


@pytest.mark.smoke
def test_version_and_quiet_compiler(tmp_path):
    assert compat.dolfinx_version().startswith(("0.5.", "0.11."))
    script = (
        "from fempm import compat; import ufl; from dolfinx import fem, mesh; "
        "from mpi4py import MPI; m = mesh.create_unit_interval(MPI.COMM_SELF, 2); "
        "print(fem.assemble_scalar(fem.form(fem.Constant(m, 7.25) * ufl.dx)))"
    )
    # A new cache folder, so that the form is compiled.
    env = {**os.environ, "XDG_CACHE_HOME": str(tmp_path)}
    run = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, env=env)
    assert (run.returncode, run.stdout) == (0, "7.25\n"), run.stderr
    assert "INFO" not in run.stderr and "gcc" not in run.stderr


def test_other_log_records_pass(caplog):
    with caplog.at_level(logging.INFO):
        logging.getLogger().info("a line of the user's")
    assert "a line of the user's" in caplog.text


@pytest.mark.smoke
@pytest.mark.parametrize("dim", [1, 2, 3])
def test_simplex_mesh_keeps_points_and_cells(dim):
    points, cells = unit_simplices(dim, 2)
    mesh = compat.create_simplex_mesh(MPI.COMM_SELF, points, cells)
    assert compat.cell_kind(mesh) == ["interval", "triangle", "tetrahedron"][dim - 1]
    assert compat.geometry_degree(mesh) == 1
    where = compat.input_vertex_index(mesh)
    assert np.array_equal(compat.vertex_points(mesh), points[where])
    found = np.sort(where[compat.cell_vertices(mesh)], axis=1)
    assert np.array_equal(np.unique(found, axis=0), np.unique(np.sort(cells, axis=1), axis=0))


def test_simplex_mesh_with_unused_points():
    points = np.array([[9.0, 9.0], [0, 0], [1, 0], [8, 8], [0, 1]])
    mesh = compat.create_simplex_mesh(MPI.COMM_SELF, points, np.array([[1, 2, 4]]))
    where = compat.input_vertex_index(mesh)
    assert sorted(where) == [1, 2, 4]
    assert np.array_equal(compat.vertex_points(mesh), points[where])


@pytest.mark.parametrize(
    "points, cells, message",
    [
        (np.zeros((3, 2)), np.array([[0, 1, 3]]), "there are 3"),
        (np.zeros((3, 2)), np.array([[0, 1, -1]]), "refer to points"),
        (np.zeros((5, 2)), np.array([[0, 1, 2, 3]]), "no simplex"),
        (np.zeros(3), np.array([[0, 1]]), "two-dimensional"),
        (np.zeros((3, 4)), np.array([[0, 1]]), "one to three"),
    ],
)
def test_simplex_mesh_refuses_nonsense(points, cells, message):
    with pytest.raises(ValueError, match=message):
        compat.create_simplex_mesh(MPI.COMM_SELF, points, cells)


@pytest.mark.parametrize("kind, corners", [("quadrilateral", 4), ("hexahedron", 8)])
def test_queries_on_tensor_cells(kind, corners):
    cell_type = getattr(dmesh.CellType, kind)
    if kind == "quadrilateral":
        mesh = dmesh.create_unit_square(MPI.COMM_SELF, 3, 2, cell_type)
    else:
        mesh = dmesh.create_unit_cube(MPI.COMM_SELF, 3, 2, 1, cell_type)
    assert compat.cell_kind(mesh) == kind
    points = compat.vertex_points(mesh)[compat.cell_vertices(mesh)]
    assert points.shape == (6, corners, mesh.geometry.dim)
    assert np.allclose(np.ptp(points, axis=1)[:, 0], 1 / 3)


@pytest.mark.smoke
@pytest.mark.mpi
@pytest.mark.parametrize("dim", [1, 2, 3])
def test_exterior_facets(dim):
    n = 3
    mesh = unit_mesh(COMM, dim, n)
    facets = compat.exterior_facets(mesh)
    per_side = [1, n, 2 * n * n][dim - 1]
    assert COMM.allreduce(len(facets)) == 2 * dim * per_side
    points = compat.vertex_points(mesh)[compat.facet_vertices(mesh, facets)]
    assert points.shape == (len(facets), dim, dim)
    on_side = (points == points[:, :1]).all(axis=1) & np.isin(points[:, 0], (0.0, 1.0))
    assert on_side.any(axis=1).all()


@pytest.mark.smoke
@pytest.mark.mpi
def test_index_map_arrays():
    mesh = unit_mesh(COMM, 2, 4, compat.vertex_partitioner())
    for dim, total in ((0, 25), (1, 56), (2, 32)):
        num_owned, global_ids, owners = compat.index_map_arrays(mesh, dim)
        assert (global_ids.dtype, owners.dtype) == (np.int64, np.int32)
        assert np.array_equal(owners == COMM.rank, np.arange(len(owners)) < num_owned)
        everywhere = np.concatenate(COMM.allgather(global_ids[:num_owned]))
        assert np.array_equal(np.sort(everywhere), np.arange(total))


@pytest.mark.mpi
def test_global_ids_agree_with_the_input_index():
    mesh = unit_mesh(COMM, 2, 4, compat.vertex_partitioner())
    points, _ = unit_simplices(2, 4)
    where = compat.input_vertex_index(mesh)
    assert np.array_equal(compat.vertex_points(mesh), points[where])
    global_ids = compat.index_map_arrays(mesh, 0)[1]
    pairs = np.concatenate(COMM.allgather(np.column_stack([global_ids, where])))
    assert len(np.unique(pairs, axis=0)) == len(points)


@pytest.mark.smoke
@pytest.mark.mpi
@pytest.mark.parametrize("kind", ["interval", "triangle", "tetrahedron", "quadrilateral"])
def test_vertex_partitioner_leaves_no_vertex_incomplete(kind):
    partitioner = compat.vertex_partitioner()
    if kind == "quadrilateral":
        cell_type = dmesh.CellType.quadrilateral
        mesh = dmesh.create_unit_square(COMM, 6, 6, cell_type, partitioner=partitioner)
        num_cells = 36
    else:
        dim = ["interval", "triangle", "tetrahedron"].index(kind) + 1
        mesh = unit_mesh(COMM, dim, 6, partitioner)
        num_cells = [6, 72, 1296][dim - 1]
    assert missing_cells(mesh) == 0
    assert mesh.topology.index_map(mesh.topology.dim).size_global == num_cells
    one = fem.Constant(mesh, 1.0)
    assert COMM.allreduce(fem.assemble_scalar(fem.form(one * ufl.dx))) == pytest.approx(1)
    assert len(compat.exterior_facets(mesh)) <= mesh.topology.index_map(mesh.topology.dim - 1).size_local


@pytest.mark.mpi
@pytest.mark.skipif(COMM.size == 1, reason="one rank has no ghosts")
def test_facet_ghosts_alone_would_leave_vertices_incomplete():
    # Shows that the check above can fail.
    assert COMM.allreduce(missing_cells(unit_mesh(COMM, 3, 6))) > 0


@pytest.mark.smoke
@pytest.mark.parametrize("shape", [(), (2,), (2, 2)])
def test_functionspace(shape):
    mesh = unit_mesh(MPI.COMM_SELF, 2, 2)
    element = ("Lagrange", 1, shape) if shape else ("Lagrange", 1)
    function = fem.Function(compat.functionspace(mesh, element))
    assert len(function.x.array) == 9 * max(1, int(np.prod(shape)))
    assert function.ufl_shape == shape


@pytest.fixture
def gmsh_model():
    gmsh = pytest.importorskip("gmsh", exc_type=ImportError)
    gmsh.initialize()
    gmsh.option.setNumber("General.Terminal", 0)
    yield gmsh.model
    gmsh.finalize()


def square_in_halves(model, size=0.25):
    """Two unit squares side by side, meshed; returns the surfaces and the left side."""
    surfaces = [model.occ.addRectangle(x, 0, 0, 1, 1) for x in (0, 1)]
    model.occ.fragment([(2, surfaces[0])], [(2, surfaces[1])])
    model.occ.synchronize()
    left = [t for _, t in model.getEntitiesInBoundingBox(-0.1, -0.1, -0.1, 0.1, 1.1, 0.1, 1)]
    model.mesh.setSize(model.getEntities(0), size)
    return surfaces, left


@pytest.mark.smoke
@pytest.mark.mpi
def test_gmsh_groups(gmsh_model):
    (one, two), left = square_in_halves(gmsh_model)
    for dim, entities, tag, name in (
        (2, [one], 7, "ice"),
        (2, [two], 3, "rock"),
        (1, left, 5, "left"),
    ):
        gmsh_model.addPhysicalGroup(dim, entities, tag)
        gmsh_model.setPhysicalName(dim, tag, name)
    gmsh_model.mesh.generate(2)
    model = gmsh_model if COMM.rank == 0 else None
    mesh, cell_tags, facet_tags, names = gmsh_model_to_mesh(model, COMM, 0, 2, compat.vertex_partitioner())
    assert names == {(2, "ice"): 7, (2, "rock"): 3, (1, "left"): 5}
    assert compat.geometry_degree(mesh) == 1
    assert missing_cells(mesh) == 0
    points = compat.vertex_points(mesh)
    centre = points[compat.cell_vertices(mesh)].mean(axis=1)
    assert len(cell_tags.indices) == len(centre)
    assert np.array_equal(cell_tags.values == 7, centre[cell_tags.indices, 0] < 1)
    facets = facet_tags.find(5)
    assert np.array_equal(facets, facet_tags.indices)
    assert (points[compat.facet_vertices(mesh, facets)][:, :, 0] == 0).all()
    owned = facets[facets < compat.index_map_arrays(mesh, 1)[0]]
    assert COMM.allreduce(len(owned)) == 4


def test_gmsh_without_groups(gmsh_model):
    gmsh_model.occ.addBox(0, 0, 0, 1, 1, 1)
    gmsh_model.occ.synchronize()
    gmsh_model.mesh.setSize(gmsh_model.getEntities(0), 0.5)
    gmsh_model.mesh.generate(3)
    mesh, cell_tags, facet_tags, names = gmsh_model_to_mesh(gmsh_model, MPI.COMM_SELF, 0, 3)
    assert compat.cell_kind(mesh) == "tetrahedron"
    assert list(names) == [(3, "all")]
    assert (cell_tags.values == names[3, "all"]).all()
    assert len(cell_tags.values) == len(compat.cell_vertices(mesh))
    assert len(facet_tags.indices) == 0


def test_gmsh_problems(gmsh_model):
    with pytest.raises(ValueError, match="no mesh cells"):
        gmsh_model_to_mesh(gmsh_model, MPI.COMM_SELF, 0, 2)
    (one, two), _ = square_in_halves(gmsh_model)
    gmsh_model.mesh.setRecombine(2, one)
    gmsh_model.mesh.generate(2)
    with pytest.raises(ValueError, match="Quadrilateral 4.*only simplex"):
        gmsh_model_to_mesh(gmsh_model, MPI.COMM_SELF, 0, 2)
    gmsh_model.removePhysicalGroups()
    gmsh_model.addPhysicalGroup(2, [two])
    gmsh_model.addPhysicalGroup(2, [two])
    with pytest.raises(ValueError, match="more than one physical group"):
        gmsh_model_to_mesh(gmsh_model, MPI.COMM_SELF, 0, 2)
    gmsh_model.removePhysicalGroups()
    gmsh_model.addPhysicalGroup(2, [two])
    gmsh_model.mesh.setOrder(2)
    with pytest.raises(ValueError, match="Triangle 6.*straight"):
        gmsh_model_to_mesh(gmsh_model, MPI.COMM_SELF, 0, 2)


@pytest.mark.mpi
def test_gmsh_problems_reach_all_ranks(gmsh_model):
    with pytest.raises(ValueError, match="no mesh cells"):
        gmsh_model_to_mesh(gmsh_model if COMM.rank == 0 else None, COMM, 0, 2)


@pytest.mark.smoke
@pytest.mark.mpi
def test_xdmf_of_dolfinx(tmp_path):
    path = COMM.bcast(tmp_path) / "square.xdmf"
    written = unit_mesh(COMM, 2, 4)
    left = dmesh.locate_entities_boundary(written, 1, lambda x: x[0] == 0)
    facets = dmesh.meshtags(written, 1, left, np.full(len(left), 4, dtype=np.int32))
    below = dmesh.locate_entities(written, 2, lambda x: x[1] < 0.51)
    cells = dmesh.meshtags(written, 2, below, np.full(len(below), 9, dtype=np.int32))
    facets.name, cells.name = "sides", "parts"
    with io.XDMFFile(COMM, str(path), "w") as file:
        file.write_mesh(written)
        for tags in (facets, cells):
            compat.write_meshtags(file, written, tags)

    mesh, cell_tags, facet_tags = compat.read_xdmf_mesh(COMM, path, partitioner=compat.vertex_partitioner())
    assert missing_cells(mesh) == 0
    points = compat.vertex_points(mesh)
    assert points.shape[1] == 2
    owned = facet_tags.indices < compat.index_map_arrays(mesh, 1)[0]
    assert COMM.allreduce(int(owned.sum())) == 4 and set(facet_tags.values) <= {4}
    ends = points[compat.facet_vertices(mesh, facet_tags.indices)]
    assert (ends[:, :, 0] == 0).all()
    corners = points[compat.cell_vertices(mesh)]
    assert np.array_equal(np.flatnonzero((corners[:, :, 1] < 0.51).all(1)), cell_tags.indices)


@pytest.mark.smoke
@pytest.mark.parametrize("options", [{"compression": None}, {"data_format": "XML"}])
def test_xdmf_of_meshio(tmp_path, options):
    points, cells = unit_simplices(2, 3)
    inside = points[cells].mean(axis=1)
    parts = np.where(inside[:, 0] < 0.5, 1, 2)
    path = tmp_path / "flat.xdmf"
    flat = np.column_stack([points, np.zeros(len(points))])
    data = meshio.Mesh(flat, [("triangle", cells)], cell_data={"part": [parts]})
    meshio.write(path, data, **options)
    mesh, cell_tags, facet_tags = compat.read_xdmf_mesh(MPI.COMM_SELF, path)
    assert facet_tags is None
    where = compat.input_vertex_index(mesh)
    assert np.allclose(compat.vertex_points(mesh), points[where])
    centre = compat.vertex_points(mesh)[compat.cell_vertices(mesh)].mean(axis=1)
    assert np.array_equal(cell_tags.values == 1, centre[cell_tags.indices, 0] < 0.5)
    assert len(cell_tags.values) == len(cells)


def test_compressed_xdmf_is_read_or_explained(tmp_path):
    points, cells = unit_simplices(2, 3)
    path = tmp_path / "small.xdmf"
    meshio.write(path, meshio.Mesh(points, [("triangle", cells)]))
    try:
        mesh, *_ = compat.read_xdmf_mesh(MPI.COMM_SELF, path)
    except ValueError as error:
        assert "compression=None" in str(error)
    else:
        assert len(compat.cell_vertices(mesh)) == len(cells)


def test_xdmf_problems(tmp_path):
    with pytest.raises(FileNotFoundError, match="nowhere"):
        compat.read_xdmf_mesh(MPI.COMM_SELF, tmp_path / "nowhere.xdmf")
    (tmp_path / "text.xdmf").write_text("not XML")
    with pytest.raises(ValueError, match="not an XDMF file"):
        compat.read_xdmf_mesh(MPI.COMM_SELF, tmp_path / "text.xdmf")
    (tmp_path / "empty.xdmf").write_text("<Xdmf><Domain/></Xdmf>")
    with pytest.raises(ValueError, match="no mesh"):
        compat.read_xdmf_mesh(MPI.COMM_SELF, tmp_path / "empty.xdmf")
    square = [("triangle", np.array([[0, 1, 2]])), ("quad", np.array([[0, 1, 2, 3]]))]
    corners = np.array([[0.0, 0], [1, 0], [1, 1], [0, 1]])
    meshio.write(tmp_path / "mixed.xdmf", meshio.Mesh(corners, square))
    with pytest.raises(ValueError, match="several kinds"):
        compat.read_xdmf_mesh(MPI.COMM_SELF, tmp_path / "mixed.xdmf")
