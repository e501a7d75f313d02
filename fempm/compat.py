"""Every difference between DOLFINx 0.5.2 (Debian 12) and 0.11 (PyPI) that fempm meets.

The other modules import this one before anything of DOLFINx, and hold no version branch of their
own. It answers, in numpy arrays, what they need to know of a mesh.
"""

import contextlib
import logging
import os
import sys
import xml.etree.ElementTree as ElementTree
from pathlib import Path

# The wheels of 0.11 load their own MPI, which has to happen before DOLFINx is imported.
with contextlib.suppress(ModuleNotFoundError):
    import dolfinx_solver  # noqa: F401
import dolfinx
import numpy as np
import ufl
from dolfinx import fem, graph, io, la
from dolfinx import mesh as dmesh
from mpi4py import MPI

# DOLFINx lets all that is loaded after it see Debian's BLAS; torch would multiply with that, 20 times slower.
sys.setdlopenflags(sys.getdlopenflags() | getattr(os, "RTLD_DEEPBIND", 0))

_OLD = not hasattr(fem, "functionspace")
_ADD = la.ScatterMode.add if _OLD else la.InsertMode.add
_adjacency_list = graph.create_adjacencylist if _OLD else graph.adjacencylist
_num_vertices = dolfinx.cpp.mesh.cell_num_vertices
if not _OLD:
    import basix.ufl

# 0.5.2 compiles forms through distutils, which reports every compiler call to the root logger.
logging.getLogger().addFilter(
    lambda record: record.levelno >= logging.WARNING or "distutils" not in record.pathname
)
for _name in ("ffcx", "FFCx", "UFL", "ufl", "compilers"):  # the last one of newer setuptools
    logging.getLogger(_name).setLevel(logging.WARNING)


def dolfinx_version():
    """Version of the DOLFINx in use, such as "0.5.2"."""
    return dolfinx.__version__


def functionspace(mesh, element):
    """Function space of ``element``: ``(family, degree)``, ``(family, degree, shape)`` or ufl's.

    The shape is ``(n,)`` for vectors and ``(m, n)`` for tensors.
    """
    if not _OLD:
        return fem.functionspace(mesh, element)
    if isinstance(element, tuple):
        family, degree, shape = (*element, ())[:3]
        make = (ufl.FiniteElement, ufl.VectorElement, ufl.TensorElement)[len(shape)]
        element = make(family, mesh.ufl_cell(), degree, *((shape,) if len(shape) == 2 else shape))
    return fem.FunctionSpace(mesh, element)


def sum_ghosts(vector):
    """Replace in a `dolfinx.la.Vector` what the ranks hold for an entry by the sum. Collective."""
    vector.scatter_reverse(_ADD)
    vector.scatter_forward()


# Making meshes


def create_simplex_mesh(comm, points, cells, partitioner=None):
    """Create a first-order mesh of intervals, triangles or tetrahedra. Collective.

    Each rank gives any part of the points and cells, for instance rank 0 all of them and the
    others None; points are numbered from rank to rank.

    Parameters
    ----------
    comm : mpi4py.MPI.Comm
    points : (n, gdim) float
    cells : (m, tdim + 1) int, point numbers of each cell
    partitioner : see `vertex_partitioner`; by default a rank has as ghosts the cells across facets

    Returns
    -------
    dolfinx.mesh.Mesh

    Raises
    ------
    ValueError
        on all ranks, if the arrays of one do not fit
    """
    points = None if points is None else np.asarray(points, np.float64)
    cells = None if cells is None else np.asarray(cells, np.int64)
    # Ranks without data learn the widths from those with some.
    width = [0 if a is None else a.shape[1] if a.ndim == 2 else -1 for a in (points, cells)]
    gdim, nv = (comm.allreduce(w, op=MPI.MAX) for w in width)
    count = comm.allreduce(0 if points is None else len(points))
    problem = None
    if -1 in width:
        problem = "points and cells must be two-dimensional arrays"
    elif not 1 <= gdim <= 3:
        problem = f"points must have one to three coordinates, not {gdim}"
    elif not 2 <= nv <= gdim + 1:
        problem = f"{nv} points make no simplex in {gdim} dimension(s)"
    elif width[0] not in (0, gdim) or width[1] not in (0, nv):
        problem = "points or cells differ in width between ranks"
    elif width[1] and cells.size and (cells.min() < 0 or cells.max() >= count):
        problem = f"cells refer to points {cells.min()} to {cells.max()}, there are {count}"
    raise_everywhere(comm, problem and ValueError(problem))
    points = np.empty((0, gdim)) if points is None else points
    cells = np.empty((0, nv), np.int64) if cells is None else cells
    kind = ("interval", "triangle", "tetrahedron")[nv - 2]
    return _create_mesh(comm, points, cells, kind, 1, partitioner)


def _create_mesh(comm, points, cells, kind, degree, partitioner):
    points, cells = np.ascontiguousarray(points), np.ascontiguousarray(cells, np.int64)
    gdim = points.shape[1]
    if _OLD:
        cell = ufl.Cell(kind, geometric_dimension=gdim)
        domain = ufl.Mesh(ufl.VectorElement("Lagrange", cell, degree))
        given = {"partitioner": partitioner} if partitioner else {}
        return dmesh.create_mesh(comm, cells, points, domain, **given)
    domain = ufl.Mesh(basix.ufl.element("Lagrange", kind, degree, shape=(gdim,)))
    partitioner = partitioner or dmesh.create_cell_partitioner(dmesh.GhostMode.shared_facet, 2)
    return dmesh.create_mesh(comm, cells=cells, x=points, e=domain, partitioner=partitioner)


def raise_everywhere(comm, error):
    """Raise the first rank's exception, None where there is none, on all ranks. Collective."""
    error = next((e for e in comm.allgather(error) if e is not None), None)
    if error is not None:
        raise error


def vertex_partitioner():
    """Partitioner that makes a ghost of each cell sharing a vertex with an owned one.

    DOLFINx itself offers only ghosts across facets. Which rank owns which cell stays the decision
    of DOLFINx's graph partitioner. The functions here and ``dolfinx.mesh.create_*`` take it as
    ``partitioner``.
    """
    if _OLD:
        base = dmesh.create_cell_partitioner()

        def partition(comm, nparts, tdim, cells, ghost_mode):
            # A rank without cells cannot tell how many vertices a cell has.
            n = cells.num_nodes
            nv = comm.allreduce(len(cells.array) // n if n else 0, op=MPI.MAX)
            owners = base(comm, nparts, tdim, cells, dmesh.GhostMode.none).array[:n]
            return _vertex_destinations(comm, owners, cells.array.reshape(n, nv))

    else:
        base = dmesh.create_cell_partitioner(dmesh.GhostMode.none, 2)

        def partition(comm, nparts, cell_types, cells):
            vertices = cells[0].reshape(-1, _num_vertices(cell_types[0]))
            owners = base(comm, nparts, cell_types, cells).array[: len(vertices)]
            return _vertex_destinations(comm, owners, vertices)._cpp_object

    return partition


def _vertex_destinations(comm, owners, cells):
    """Ranks that get each cell: its owner first, then the owners of cells sharing a vertex."""
    n, nv = cells.shape
    pairs = np.unique(np.column_stack([cells.ravel(), np.repeat(owners, nv)]), axis=0)
    # The rank that collects all (vertex, rank) pairs of a vertex sees whether it is shared.
    office = pairs[:, 0] % comm.size
    received = comm.alltoall([pairs[office == rank] for rank in range(comm.size)])
    pairs = np.unique(np.concatenate(received), axis=0)
    _, count = np.unique(pairs[:, 0], return_counts=True)
    shared = np.concatenate(comm.allgather(pairs[np.repeat(count > 1, count)]))
    shared = shared[np.argsort(shared[:, 0], kind="stable")]

    # Join each cell's vertices with the table of shared ones: rows first to first + length.
    first = np.searchsorted(shared[:, 0], cells.ravel(), side="left")
    length = np.searchsorted(shared[:, 0], cells.ravel(), side="right") - first
    start = np.cumsum(length) - length
    rows = np.arange(length.sum()) + np.repeat(first - start, length)
    cell = np.repeat(np.repeat(np.arange(n), nv), length)
    ghosts = np.unique(np.column_stack([cell, shared[rows, 1]]), axis=0)
    ghosts = ghosts[ghosts[:, 1] != owners[ghosts[:, 0]]]

    offsets = np.zeros(n + 1, np.int32)
    np.cumsum(1 + np.bincount(ghosts[:, 0], minlength=n), out=offsets[1:])
    is_owner = np.zeros(offsets[-1], bool)
    is_owner[offsets[:-1]] = True
    data = np.empty(offsets[-1], np.int32)
    data[is_owner], data[~is_owner] = owners, ghosts[:, 1]
    return _adjacency_list(data, offsets)


# Asking meshes


def cell_kind(mesh):
    """Name of the mesh's cells, such as "triangle"; ValueError if there are several kinds."""
    if not _OLD:
        kinds = mesh.topology.entity_types[mesh.topology.dim]
        if len(kinds) > 1:
            names = ", ".join(kind.name for kind in kinds)
            raise ValueError(f"the mesh has cells of several kinds ({names}), only one can be used")
    return mesh.topology.cell_name()


def geometry_degree(mesh):
    """Polynomial degree of the mesh's geometry, 1 for straight cells."""
    return int(mesh.geometry.cmap.degree if _OLD else mesh.geometry.cmaps[0].degree)


def cell_vertices(mesh):
    """(nc, vertices per cell) int32 local vertices of the cells, owned ones first, then ghosts."""
    cell_kind(mesh)
    tdim = mesh.topology.dim
    mesh.topology.create_connectivity(tdim, 0)
    # The explicit width keeps the shape on a rank without entities.
    width = _num_vertices(mesh.topology.cell_type)
    return mesh.topology.connectivity(tdim, 0).array.astype(np.int32).reshape(-1, width)


def _vertex_nodes(mesh):
    """Geometry node of each local vertex: a cell's first nodes are its vertices, in order."""
    if _OLD:
        dofmap = mesh.geometry.dofmap
        nodes = dofmap.array.reshape(dofmap.num_nodes, -1)
    else:
        nodes = mesh.geometry.dofmaps[0]
    vertices = cell_vertices(mesh)
    vertex_map = mesh.topology.index_map(0)
    out = np.empty(vertex_map.size_local + vertex_map.num_ghosts, np.int32)
    out[vertices] = nodes[:, : vertices.shape[1]]
    return out


def vertex_points(mesh):
    """(nv, gdim) coordinates of the local vertices."""
    return np.ascontiguousarray(mesh.geometry.x[_vertex_nodes(mesh), : mesh.geometry.dim])


def input_vertex_index(mesh):
    """(nv,) int64 where the local vertices stood in the points that the mesh was made from."""
    return np.asarray(mesh.geometry.input_global_indices, np.int64)[_vertex_nodes(mesh)]


def index_map_arrays(mesh, dim):
    """How the mesh's entities of one dimension are spread over the ranks. Collective.

    Returns
    -------
    num_owned : int, the local entities below it belong to this rank, the others are ghosts
    global_ids : (num_local,) int64
    owners : (num_local,) int32 ranks
    """
    mesh.topology.create_entities(dim)
    index_map = mesh.topology.index_map(dim)
    num_owned = index_map.size_local
    global_ids = np.concatenate([np.arange(*index_map.local_range), index_map.ghosts])
    owners = np.concatenate([np.full(num_owned, mesh.comm.rank), index_map.owners])
    return num_owned, global_ids.astype(np.int64), owners.astype(np.int32)


def exterior_facets(mesh):
    """Local numbers, ascending, of this rank's facets on the mesh's boundary. Collective."""
    _connect(mesh, mesh.topology.dim - 1)
    return np.sort(np.asarray(dmesh.exterior_facet_indices(mesh.topology), np.int32))


def facet_vertices(mesh, facets):
    """(nf, vertices per facet) int32 local vertices of the facets of given numbers. Collective."""
    fdim = mesh.topology.dim - 1
    _connect(mesh, fdim)
    kind = dolfinx.cpp.mesh.cell_entity_type(mesh.topology.cell_type, fdim, 0)
    table = mesh.topology.connectivity(fdim, 0).array.reshape(-1, _num_vertices(kind))
    return table[np.asarray(facets, np.int64)].astype(np.int32)


def _connect(mesh, dim):
    mesh.topology.create_entities(dim)
    mesh.topology.create_connectivity(dim, mesh.topology.dim)
    mesh.topology.create_connectivity(dim, 0)


# Reading and writing meshes


def distribute_tags(mesh, dim, nodes, values):
    """MeshTags of entities given by (n, dim + 1) input point numbers, on any rank. Collective."""
    _connect(mesh, dim)
    if mesh.comm.allreduce(len(values)) == 0:
        return dmesh.meshtags(mesh, dim, np.empty(0, np.int32), np.empty(0, np.int32))
    if _OLD:
        entities, local = dolfinx.cpp.io.distribute_entity_data(mesh._mesh, dim, nodes, values)
    else:
        entities, local = io.distribute_entity_data(mesh, dim, nodes, values)
    local = np.asarray(local, np.int32)
    return dmesh.meshtags_from_entities(mesh, dim, _adjacency_list(entities), local)


def read_xdmf_mesh(comm, path, partitioner=None):
    """Read a mesh, and tags beside it, from an XDMF file of DOLFINx or meshio. Collective.

    Coordinates beyond the cells' dimension are dropped where they are the same everywhere.

    Parameters
    ----------
    comm : mpi4py.MPI.Comm
    path : str or Path
    partitioner : as in `create_simplex_mesh`

    Returns
    -------
    mesh : dolfinx.mesh.Mesh
    cell_tags, facet_tags : dolfinx.mesh.MeshTags or None, first integer data of cells and facets

    Raises
    ------
    FileNotFoundError, ValueError
        for a missing file, or one without a mesh that DOLFINx can read
    """
    found = comm.bcast(_xdmf_grids(Path(path)) if comm.rank == 0 else None, root=0)
    if isinstance(found, Exception):
        raise found
    grids, encoding = found
    domain = "/Xdmf/Domain"
    with contextlib.ExitStack() as stack:
        try:
            file = io.XDMFFile(comm, str(path), "r", getattr(io.XDMFFile.Encoding, encoding))
            stack.enter_context(file)
            kind, degree = file.read_cell_type(grids[0][0], domain)
            cells = file.read_topology_data(grids[0][0], domain)
            points = file.read_geometry_data(grids[0][0], domain)
        except RuntimeError as error:
            # The HDF5 in the wheel of 0.11 cannot decompress, and meshio compresses by default.
            raise ValueError(
                f"DOLFINx cannot read the data of {path} ({error}); if they are compressed, write "
                "them without compression (meshio: compression=None)"
            ) from error
        tdim = dolfinx.cpp.mesh.cell_dim(kind)
        extra = np.unique(points[:, tdim:], axis=0)
        if len(np.unique(np.concatenate(comm.allgather(extra)), axis=0)) == 1:
            points = points[:, :tdim]
        mesh = _create_mesh(comm, points, cells, kind.name, degree, partitioner)
        _connect(mesh, tdim - 1)
        tags = {}
        for grid, tagged in grids:
            if tagged and tags.keys() != {tdim, tdim - 1}:
                read = file.read_meshtags(mesh, grid)
                tags.setdefault(read.dim, read)
    return mesh, tags.get(tdim), tags.get(tdim - 1)


def _xdmf_grids(path):
    """[(grid name, whether its first data are integers on cells)] and encoding, or an error."""
    if not path.is_file():
        return FileNotFoundError(f"no such file: {path}")
    try:
        domain = ElementTree.parse(path).getroot().find("Domain")
    except ElementTree.ParseError as error:
        return ValueError(f"{path} is not an XDMF file: {error}")
    grids = []
    for grid in () if domain is None else domain.findall("Grid[Topology]"):
        topology = grid.find("Topology")
        if topology.get("TopologyType", topology.get("Type", "")).lower() == "mixed":
            return ValueError(f"{path}: the grid has cells of several kinds, only one can be used")
        # DOLFINx's tags state no type; its functions are not among these grids.
        item = grid.find("Attribute[@Center='Cell']/DataItem")
        tagged = item is not None and item.get("NumberType", item.get("DataType", "Int")) == "Int"
        grids.append((grid.get("Name"), tagged))
    if not grids:
        return ValueError(f"{path} holds no mesh")
    formats = {item.get("Format", "XML").upper() for item in domain.iter("DataItem")}
    if formats not in ({"HDF"}, {"XML"}):
        return ValueError(f"{path} holds data as {', '.join(sorted(formats))}, not as HDF or XML")
    return grids, "HDF5" if formats == {"HDF"} else "ASCII"


def write_meshtags(file, mesh, tags):
    """Write MeshTags to an open `dolfinx.io.XDMFFile` that holds their mesh. Collective."""
    _connect(mesh, tags.dim)
    file.write_meshtags(tags, *() if _OLD else (mesh.geometry,))
