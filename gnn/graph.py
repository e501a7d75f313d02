"""Graph of a simplex mesh: nodes with types, and the edges of the cells."""

from dataclasses import dataclass

import numpy as np

from .xdmf import XdmfFile, read_items

# Node types of MeshGraphNets (Pfaff et al. 2021), whose one-hot vectors have nine entries.
NORMAL, OBSTACLE, AIRFOIL, HANDLE, INFLOW, OUTFLOW, WALL = range(7)
NUM_TYPES = 9


@dataclass
class MeshGraph:
    """A mesh as a graph.

    Attributes
    ----------
    points : (n, d) float64 positions in the undeformed mesh, in m
    cells : (nc, k) int64 nodes of the intervals, triangles or tetrahedra
    node_type : (n,) int32
    edges : (ne, 2) int32 undirected, first < second, in lexicographic order
    """

    points: np.ndarray
    cells: np.ndarray
    node_type: np.ndarray
    edges: np.ndarray


def from_cells(points, cells, node_type=None):
    """MeshGraph with the edges of all cells.

    Parameters
    ----------
    points : (n, d) positions; trailing coordinates that are zero everywhere are dropped as far as the
        cells allow, so that flat triangles have d = 2
    cells : (nc, k) integers, k = 2, 3 or 4
    node_type : (n,) integers below NUM_TYPES, NORMAL by default

    Raises
    ------
    ValueError
        If there are no cells, a node in none of them, a point that is not finite, or an index, shape or
        type that cannot be.
    """
    points, cells = np.array(points, np.float64), np.asarray(cells)
    if points.ndim != 2 or not 1 <= points.shape[1] <= 3:
        raise ValueError(f"points have shape {points.shape}, not (n, d) with d = 1, 2 or 3")
    if cells.size == 0:
        raise ValueError("the mesh has no cells")
    if cells.ndim != 2 or cells.dtype.kind not in "iu" or not 2 <= cells.shape[1] <= points.shape[1] + 1:
        raise ValueError(
            f"cells of type {cells.dtype} and shape {cells.shape} in {points.shape[1]} dimension(s): "
            "give the node numbers of intervals, triangles or tetrahedra"
        )
    _check_nodes(points, cells)
    while points.shape[1] > cells.shape[1] - 1 and not points[:, -1].any():
        points = points[:, :-1]
    types = np.zeros(len(points), np.int32) if node_type is None else _check_types(node_type, len(points))
    cells = cells.astype(np.int64)
    return MeshGraph(np.ascontiguousarray(points), cells, types, _edges(cells, len(points)))


def read_mesh_graph(path, types=None):
    """MeshGraph of the mesh in an XDMF file of fempm, DOLFINx or meshio.

    Node types are those of the file's field ``node_type``, where it has one, or come from facet tags.

    Parameters
    ----------
    path : str or Path
    types : dict of facet tag to node type; nodes of several tags get the largest type

    Raises
    ------
    FileNotFoundError
    ValueError
        If the file cannot be read, its mesh is none (see `from_cells`), or a tag is not in it.
    """
    return graph_of(XdmfFile(path), types)


def graph_of(file, types=None):
    """As `read_mesh_graph`, of an open XdmfFile."""
    grid = file.mesh
    stored = (file.frames or file.grids)[0].attributes.get("node_type")
    if types and stored is not None:
        raise ValueError(f"{file.path} has a field node_type already, types cannot come from tags as well")
    cells, points = read_items(file.path, [grid.cells, grid.points])
    node_type = None if stored is None else next(read_items(file.path, [stored.item])).ravel()
    if types:
        node_type = _types_from_tags(file, types, len(points), cells.shape[1])
    try:
        return from_cells(points, _integers(cells), node_type)
    except ValueError as error:
        raise ValueError(f"{file.path}: {error}") from error


def _types_from_tags(file, types, n, k):
    """(n,) types of the nodes of tagged facets; the tags are the first data on cells of their grid."""
    out, found = np.zeros(n, np.int32), set()
    for grid in file.grids:
        tags = next((a for a in grid.attributes.values() if a.centre == "Cell"), None)
        if grid.cells.shape[1] != k - 1 or tags is None or grid.points != file.mesh.points:
            continue
        facets, values = map(_integers, read_items(file.path, [grid.cells, tags.item]))
        found.update(values.ravel().tolist())
        for tag, node_type in types.items():
            if not 0 <= node_type < NUM_TYPES:
                raise ValueError(f"tag {tag} has node type {node_type}, types are 0 to {NUM_TYPES - 1}")
            nodes = facets[values.ravel() == tag]
            out[nodes] = np.maximum(out[nodes], node_type)
    missing = sorted(set(types) - found)
    if missing:
        raise ValueError(f"{file.path} has no facets tagged {missing}, only {sorted(found)}")
    return out


def _check_nodes(points, cells):
    n = len(points)
    bad = np.flatnonzero(~np.isfinite(points).all(axis=1))
    if len(bad):
        raise ValueError(f"point {bad[0]} of the mesh is at {points[bad[0]]}")
    if cells.min() < 0 or cells.max() >= n:
        raise ValueError(f"cells refer to nodes {cells.min()} to {cells.max()}, there are {n}")
    ordered = np.sort(cells, axis=1)
    bad = np.flatnonzero((ordered[:, 1:] == ordered[:, :-1]).any(axis=1))
    if len(bad):
        raise ValueError(f"cell {bad[0]} has a node twice: {cells[bad[0]].tolist()}")
    alone = np.flatnonzero(np.bincount(cells.ravel(), minlength=n) == 0)
    if len(alone):
        names = ", ".join(map(str, alone[:5])) + (", ..." if len(alone) > 5 else "")
        raise ValueError(f"{len(alone)} node(s) in no cell: {names}; remove them from the mesh")


def _check_types(node_type, n):
    types = _integers(np.asarray(node_type))
    if types.shape != (n,):
        raise ValueError(f"node_type has shape {types.shape}, not ({n},)")
    bad = np.flatnonzero((types < 0) | (types >= NUM_TYPES))
    if len(bad):
        raise ValueError(f"node {bad[0]} has type {types[bad[0]]}, types are 0 to {NUM_TYPES - 1}")
    return types.astype(np.int32)


def _integers(a):
    """Whole numbers as integers: XDMF with numbers in the text does not always say which they are."""
    with np.errstate(invalid="ignore"):
        out = a.astype(np.int64)
    if a.dtype.kind not in "iu" and (out != a).any():
        raise ValueError(f"integers expected, there is {a[out != a].flat[0]}")
    return out


def _edges(cells, n):
    """(ne, 2) int32 edges of the cells, each once."""
    pairs = [cells[:, [i, j]] for i in range(cells.shape[1]) for j in range(i)]
    pairs = np.sort(np.concatenate(pairs), axis=1)
    keys = np.unique(pairs[:, 0] * n + pairs[:, 1])
    return np.stack([keys // n, keys % n], axis=1).astype(np.int32)
