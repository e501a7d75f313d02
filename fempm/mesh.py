"""Simplex meshes as the flat arrays that particle codes need, made from any DOLFINx mesh."""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from .parallel import Ranks

SIMPLICES = ("interval", "triangle", "tetrahedron")


@dataclass
class SimplexMesh:
    """A mesh of intervals, triangles or tetrahedra, the whole of it on every MPI rank.

    Attributes
    ----------
    points : (nv, d) vertex coordinates
    cells : (nc, d + 1) int32 vertices of each cell
    neighbours : (nc, d + 1) int32 cell across the facet opposite each vertex, -1 where there is none
    inverse : (nc, d, d) maps x - points[cells[c, 0]] to the barycentric coordinates 1..d
    adjacency_start, adjacency : CSR lists of each vertex's edge neighbours, without itself
    boundaries : boundary name -> (nf, d) int32 vertices of its facets; "boundary" is all of it
    regions : region name -> int32 numbers of its cells, from the physical groups or cell tags of a file
    """

    points: np.ndarray
    cells: np.ndarray
    boundaries: dict = field(default_factory=dict)
    regions: dict = field(default_factory=dict)

    def __post_init__(self):
        self.points = np.ascontiguousarray(self.points, np.float64)
        self.cells = np.ascontiguousarray(self.cells, np.int32)
        nv = len(self.points)
        if self.cells.ndim != 2 or self.cells.shape[1] != self.dim + 1:
            raise ValueError(
                f"cells of shape {self.cells.shape} are no simplices of dimension {self.dim}: "
                f"give (n, {self.dim + 1}) vertex numbers"
            )
        edges = self.points[self.cells[:, 1:]] - self.points[self.cells[:, :1]]
        determinant = np.linalg.det(edges)
        flat = np.flatnonzero(np.abs(determinant) <= 1e-14 * np.ptp(self.points, axis=0).max() ** self.dim)
        if len(flat):
            c = flat[0]
            raise ValueError(
                f"cell {c} has no volume (corners {self.points[self.cells[c]].tolist()}): "
                "remove it or mesh again with gmsh's optimiser"
            )
        self.volumes = np.abs(determinant) / [1, 1, 2, 6][self.dim]
        self.inverse = np.ascontiguousarray(np.linalg.inv(edges).transpose(0, 2, 1))
        self.neighbours, self.exterior_facets = facet_neighbours(self.cells)
        self.adjacency_start, self.adjacency = vertex_adjacency(self.cells, nv)
        self.boundaries.setdefault("boundary", self.exterior_facets)

    @property
    def dim(self):
        """Space dimension d (1, 2 or 3)."""
        return self.points.shape[1]

    def barycentric(self, x, cell):
        """(n, d + 1) barycentric coordinates of points x (n, d) in the cells (n,) given."""
        inner = np.einsum("nij,nj->ni", self.inverse[cell], x - self.points[self.cells[cell, 0]])
        return np.concatenate([1 - inner.sum(axis=1, keepdims=True), inner], axis=1)

    def quality(self, cell):
        """Shape quality of one cell: d-th root of volume over rms edge length, 1 for the regular one."""
        corners = self.points[self.cells[cell]]
        pairs = np.triu_indices(self.dim + 1, 1)
        rms = np.sqrt(np.mean(np.sum((corners[pairs[0]] - corners[pairs[1]]) ** 2, axis=1)))
        regular = [1.0, 1.0, np.sqrt(3) / 4, 1 / np.sqrt(72)][self.dim]
        return (self.volumes[cell] / regular) ** (1 / self.dim) / rms

    def facets(self, name):
        """(nf, d) int32 vertices of the facets of a named boundary; KeyError names those there are."""
        if name not in self.boundaries:
            raise KeyError(f"unknown boundary tag {name!r}: this mesh has {sorted(self.boundaries)}")
        return self.boundaries[name]

    def exterior_places(self, facets):
        """Numbers of facets (nf, d) among `exterior_facets`, which follow the cells, -1 for others."""
        facets = np.asarray(facets).reshape(-1, self.dim)
        keys = np.sort(np.concatenate([self.exterior_facets, facets]), axis=1)
        group = np.unique(keys, axis=0, return_inverse=True)[1].ravel()
        place, outer = np.full(len(keys), -1), len(self.exterior_facets)
        place[group[:outer]] = np.arange(outer)
        return place[group[outer:]]

    def other_facets(self, facets):
        """(m, d) int32 vertices of the exterior facets that are not among those given, (nf, d)."""
        place, other = self.exterior_places(facets), np.ones(len(self.exterior_facets), bool)
        other[place[place >= 0]] = False
        return self.exterior_facets[other]


def facet_neighbours(cells):
    """Cell neighbours across facets.

    Returns
    -------
    neighbours : (nc, d + 1) int32, -1 outside
    exterior : (nf, d) int32 vertices of the facets that belong to one cell only
    """
    nc, corners = cells.shape
    facets = np.stack([np.delete(cells, q, axis=1) for q in range(corners)], axis=1)
    facets = facets.reshape(nc * corners, corners - 1)
    keys = np.sort(facets, axis=1)
    order = np.lexsort(keys.T[::-1])
    same = np.all(keys[order[1:]] == keys[order[:-1]], axis=1)
    first, second = order[:-1][same], order[1:][same]
    neighbours = np.full(nc * corners, -1, np.int32)
    neighbours[first], neighbours[second] = second // corners, first // corners
    return neighbours.reshape(nc, corners), facets[neighbours == -1]


def vertex_adjacency(cells, num_vertices):
    """CSR lists (start, adjacent) of the vertices that share an edge with each vertex, sorted."""
    a, b = np.triu_indices(cells.shape[1], 1)
    pairs = np.concatenate([cells[:, a].ravel(), cells[:, b].ravel()]).astype(np.int64)
    other = np.concatenate([cells[:, b].ravel(), cells[:, a].ravel()])
    unique = np.unique(pairs * num_vertices + other)
    start = np.searchsorted(unique, np.arange(num_vertices + 1, dtype=np.int64) * num_vertices)
    empty = np.flatnonzero(np.diff(start) == 0)
    if len(empty):
        raise ValueError(f"vertex {empty[0]} belongs to no cell: remove unused points from the mesh")
    return start, (unique % num_vertices).astype(np.int32)


def mean_edge_length(points, start, adjacent):
    """(nv,) mean distance of each vertex to its neighbours in the CSR lists."""
    count = np.diff(start)
    length = np.linalg.norm(points[adjacent] - np.repeat(points[: len(count)], count, axis=0), axis=1)
    return np.add.reduceat(length, start[:-1]) / count


def interval_mesh(x):
    """Mesh of the intervals between increasing coordinates x (n,), with boundaries "left" and "right"."""
    x = np.asarray(x, float)
    if np.any(np.diff(x) <= 0):
        raise ValueError("the coordinates of an interval mesh must increase")
    ends = {"left": np.array([[0]], np.int32), "right": np.array([[len(x) - 1]], np.int32)}
    cells = np.stack([np.arange(len(x) - 1), np.arange(1, len(x))], axis=1)
    return SimplexMesh(x[:, None], cells, boundaries=ends)


def from_dolfinx(mesh, facet_tags=None, names=None, boundaries=None, cell_tags=None, region_names=None):
    """Wrap a DOLFINx simplex mesh.

    Parameters
    ----------
    mesh : dolfinx.mesh.Mesh of intervals, triangles or tetrahedra, first-order geometry
    facet_tags : dolfinx MeshTags of facets, optional
    names : dict name -> tag value; unnamed values are called "1", "2", ...
    boundaries : dict name -> function of coordinates (d, n) -> (n,) bool; an exterior facet belongs to
        the boundary if the function holds at all of its vertices
    cell_tags, region_names : the same as facet_tags and names for `SimplexMesh.regions`

    Raises
    ------
    ValueError
        for other cell types, curved geometry, or a boundary that no facet belongs to
    """
    from . import compat

    kind = compat.cell_kind(mesh)
    if kind not in SIMPLICES:
        raise ValueError(f"mesh of {kind} cells: only simplex meshes ({', '.join(SIMPLICES)}) are supported")
    if compat.geometry_degree(mesh) != 1:
        raise ValueError(
            f"mesh geometry of degree {compat.geometry_degree(mesh)}: only straight-sided cells (degree 1)"
        )
    tdim, gdim = mesh.topology.dim, mesh.geometry.dim
    if tdim != gdim:
        raise ValueError(
            f"{kind} mesh embedded in {gdim}D space: give a mesh with as many coordinates as {tdim}"
        )
    if mesh.comm.size > 1:
        wrapped = gathered(mesh, facet_tags, names, cell_tags, region_names)
    else:
        wrapped = SimplexMesh(compat.vertex_points(mesh), compat.cell_vertices(mesh))
        for name, facets in tagged_entities(mesh, facet_tags, names):
            wrapped.boundaries[name] = compat.facet_vertices(mesh, facets)
        wrapped.regions.update(tagged_entities(mesh, cell_tags, region_names))
    for name, predicate in (boundaries or {}).items():
        mark_boundary(wrapped, name, predicate)
    return wrapped


def gathered(mesh, facet_tags, names, cell_tags, region_names):
    """The whole of a mesh that is spread over ranks, as one rank would have it. Collective.

    The first rank makes it again from the points and cells in the order in which they were given, so
    that vertices and cells have the same numbers on any number of ranks.
    """
    from mpi4py import MPI

    from . import compat

    tdim, comm = mesh.topology.dim, mesh.comm
    index = compat.input_vertex_index(mesh)
    owned = mesh.topology.index_map(tdim).size_local
    cells = compat.cell_vertices(mesh)
    pieces = [
        (index, compat.vertex_points(mesh)),
        (np.asarray(mesh.topology.original_cell_index)[:owned], index[cells[:owned]]),
    ]
    for dim, tags in ((tdim, cell_tags), (tdim - 1, facet_tags)):
        if tags is None:
            pieces.append(None)
            continue
        mine = tags.indices < compat.index_map_arrays(mesh, dim)[0]
        indices = tags.indices[mine]
        corners = cells[indices] if dim == tdim else compat.facet_vertices(mesh, indices)
        pieces.append((index[corners], tags.values[mine]))
    gathered = comm.gather(pieces)
    made = error = None
    if comm.rank == 0:
        numbered, listed, *tags = (
            p and [np.concatenate(a) for a in zip(*(g[i] for g in gathered), strict=True)]
            for i, p in enumerate(pieces)
        )
        number, first = np.unique(numbered[0], return_index=True)  # a point may be on several ranks
        corners = np.searchsorted(number, listed[1][np.argsort(listed[0])])
        try:
            alone = compat.create_simplex_mesh(MPI.COMM_SELF, numbered[1][first], corners)
            tags = [
                t and compat.distribute_tags(alone, dim, np.searchsorted(number, t[0]), t[1])
                for dim, t in zip((tdim, tdim - 1), tags, strict=True)
            ]
            made = from_dolfinx(alone, tags[1], names, None, tags[0], region_names)
        except ValueError as problem:
            error = problem
    compat.raise_everywhere(comm, error)
    return comm.bcast(made)


def tagged_entities(mesh, tags, names):
    """Pairs (name, entities) of the DOLFINx MeshTags of a mesh on one rank."""
    if tags is None:
        return []
    called = {value: name for name, value in (names or {}).items()}
    values = np.unique(tags.values).tolist()
    return [(called.get(v, str(v)), tags.indices[tags.values == v]) for v in values]


def mark_boundary(mesh, name, predicate):
    """Name the exterior facets at whose vertices `predicate(x)` holds, x of shape (d, n)."""
    holds = np.asarray(predicate(mesh.points.T), bool)
    facets = mesh.exterior_facets[holds[mesh.exterior_facets].all(axis=1)]
    if len(facets) == 0:
        raise ValueError(f"boundary {name!r}: its predicate holds on no exterior facet")
    mesh.boundaries[name] = facets
    return mesh


def read_mesh(path, boundaries=None, **parameters):
    """Read a gmsh .geo or .msh file, or an XDMF file.

    Parameters
    ----------
    path : file; a .geo file is meshed by gmsh (package `gmsh`), with the options set in it
    boundaries : as in `from_dolfinx`; physical groups and mesh tags are named as in the file
    parameters : numbers that override variables of a .geo file, such as its mesh size: h=0.1 where the
        file has `DefineConstant[h = ...];`

    Raises
    ------
    FileNotFoundError, ValueError
        for a missing file, an unknown ending or a file that is no mesh
    ImportError
        for gmsh files where the package gmsh is not installed
    """
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"mesh file {path} does not exist")
    if parameters and path.suffix != ".geo":
        raise ValueError(f"{path}: parameters ({', '.join(parameters)}) can only be set in a .geo file")
    return Ranks().broadcast(lambda: read_alone(path, boundaries, parameters))


def read_alone(path, boundaries, parameters):
    """`read_mesh` on one rank."""
    from . import compat, gmsh_reader  # before MPI: see there

    # isort: split
    from mpi4py import MPI

    if path.suffix == ".xdmf":
        mesh, cell_tags, facet_tags = compat.read_xdmf_mesh(MPI.COMM_SELF, path)
        names = region_names = None
    elif path.suffix in (".geo", ".msh"):
        mesh, cell_tags, facet_tags, found = gmsh_reader.read_gmsh(MPI.COMM_SELF, path, parameters)
        region_names, names = (
            {name: tag for (dim, name), tag in found.items() if dim == mesh.topology.dim - codim}
            for codim in (0, 1)
        )
    else:
        raise ValueError(f"{path}: unknown mesh format {path.suffix!r}, give .geo, .msh or .xdmf")
    return from_dolfinx(mesh, facet_tags, names, boundaries, cell_tags, region_names)
