"""The unstructured moving-least-squares (UMLS) kernel on a mesh: rings, supports, eta, weights.

The particle in cell c sees the ring N1(c): the vertices of c and all their edge neighbours, mirror
vertices included (thesis section 2.1.3). `eta` is stored as one bit per corner of the cell: bit q of
a ring vertex is set where it is a neighbour of corner q or that corner itself (thesis eq. 2.29).
"""

from dataclasses import dataclass

import numpy as np
from numba import njit

from .lane_memory import (
    borrow,
    entry,
    load,
    scratch,
    store,
    take,
)
from .mesh import mean_edge_length
from .walls import attached_adjacency
from .weights import (
    ENTRY,
    FIRST,
    MAX_RING,
    TABLE_SIZE,
    D,
    R,
    Rings,
    W,
    gradient,
    optional,
    ring_of,
    weights,
)

# smaller is more accurate, larger has fewer negative weights (README, "Where the numbers come from")
SUPPORT = {1: 1.0, 2: 1.1, 3: 1.1}


@dataclass
class Kernel:
    """Everything the transfers read about a mesh.

    Attributes
    ----------
    points : (nv, d) vertices of the mesh, then mirror vertices
    cells, inverse : see `SimplexMesh`
    ring_start : (nc + 1,) int64, ring_vertex : int32, ring_mask : uint8 -- rings as CSR
    inverse_support : (nv,) 1 / h_k of the B-spline of each vertex
    phi : (nv, d) correction of the consistent gradient, or (0, d) for the plain MLS gradient
    """

    points: np.ndarray
    cells: np.ndarray
    inverse: np.ndarray
    ring_start: np.ndarray
    ring_vertex: np.ndarray
    ring_mask: np.ndarray
    inverse_support: np.ndarray
    phi: np.ndarray

    @property
    def dim(self):
        """Space dimension d."""
        return self.points.shape[1]

    @property
    def axes(self):
        """The tuple (0, ..., d - 1): its length is the dimension that kernels are compiled for."""
        return tuple(range(self.dim))

    @property
    def rings(self):
        """The arrays that compiled code reads, as one argument."""
        return Rings(
            self.cells,
            self.inverse,
            self.points,
            self.inverse_support,
            self.ring_start,
            self.ring_vertex,
            self.ring_mask,
        )


def build_kernel(mesh, layer, support=None, diminishing=True):
    """UMLS kernel with the plain MLS gradient; `consistency.correct` makes it consistent.

    Parameters
    ----------
    mesh : SimplexMesh
    layer : WallLayer
    support : h_k over the mean length of the edges at vertex k, `SUPPORT` when not given; the B-spline
        reaches 1.5 h_k
    diminishing : False switches eta off (thesis figures 2.5b and 2.8a)

    Raises
    ------
    ValueError
        for a ring of more than MAX_RING vertices (a vertex with a hundred cells)
    """
    support = SUPPORT[mesh.dim] if support is None else support
    if not support > 0:
        raise ValueError(f"support {support}: it must be positive")
    points = np.concatenate([mesh.points, layer.points])
    start, adjacent = attached_adjacency(mesh, layer)
    owner = np.concatenate([np.arange(len(mesh.points)), layer.owner])
    size = mean_edge_length(points, start, adjacent)
    is_open = np.zeros(len(size), bool)
    is_open[layer.open_facets.ravel()] = True
    size = np.where(is_open, inner_size(mesh, size, is_open), size)[owner]
    ring_start = count_rings(mesh.cells, start, adjacent, len(points))
    longest = np.diff(ring_start).max()
    if longest > MAX_RING:
        cell = int(np.diff(ring_start).argmax())
        raise ValueError(
            f"cell {cell} at {mesh.points[mesh.cells[cell]].mean(axis=0)} has {longest} ring vertices, "
            f"at most {MAX_RING} are supported: mesh again without such stars of thin cells"
        )
    ring_vertex, ring_mask = fill_rings(mesh.cells, start, adjacent, ring_start, len(points))
    if not diminishing:
        ring_mask[:] = 2 ** (mesh.dim + 1) - 1
    return Kernel(
        points,
        mesh.cells,
        mesh.inverse,
        ring_start,
        ring_vertex,
        ring_mask,
        1.0 / (support * size),
        np.zeros((0, mesh.dim)),
    )


def inner_size(mesh, size, is_open):
    """(nv,) mean size of the neighbours that are not on an open boundary, where there are any.

    Vertices on an open boundary have lost edges; with their inner neighbours' size a uniform mesh
    stays uniform up to there.
    """
    start = mesh.adjacency_start[:-1]
    inner = ~is_open[mesh.adjacency]
    total = np.add.reduceat(np.where(inner, size[mesh.adjacency], 0.0), start)
    count = np.add.reduceat(inner.astype(int), start)
    return np.where(count > 0, total / np.maximum(count, 1), size)


@njit(cache=True)
def count_rings(cells, start, adjacent, num_points):
    """Ring offsets: cumulative numbers of vertices in the rings of the cells."""
    seen = np.full(num_points, -1, np.int64)
    out = np.zeros(len(cells) + 1, np.int64)
    for c in range(len(cells)):
        n = 0
        for q in range(cells.shape[1]):
            v = cells[c, q]
            if seen[v] != c:
                seen[v] = c
                n += 1
            for j in range(start[v], start[v + 1]):
                if seen[adjacent[j]] != c:
                    seen[adjacent[j]] = c
                    n += 1
        out[c + 1] = out[c] + n
    return out


@njit(cache=True)
def fill_rings(cells, start, adjacent, ring_start, num_points):
    """Ring vertices, sorted within each cell, and their adjacency bits."""
    bits = np.zeros(num_points, np.uint8)
    vertex = np.empty(ring_start[-1], np.int32)
    mask = np.empty(ring_start[-1], np.uint8)
    for c in range(len(cells)):
        at = ring_start[c]
        for q in range(cells.shape[1]):
            v = cells[c, q]
            for j in range(start[v] - 1, start[v + 1]):
                k = v if j < start[v] else adjacent[j]
                if bits[k] == 0:
                    vertex[at] = k
                    at += 1
                bits[k] |= 1 << q
        ring = vertex[ring_start[c] : at]
        ring.sort()
        for i in range(len(ring)):
            mask[ring_start[c] + i] = bits[ring[i]]
            bits[ring[i]] = 0
    return vertex, mask


def evaluate(kernel, x, cell):
    """Weights and gradients at one point: the slow twin of the transfers, for tests and pictures.

    Returns
    -------
    vertices : (n,) ring of the cell
    w : (n,) weights
    g : (n, d) gradients (consistent where the kernel has phi)
    """
    first, last = kernel.ring_start[cell], kernel.ring_start[cell + 1]
    w, g = evaluate_many(kernel, np.atleast_2d(x), np.array([cell]))
    return kernel.ring_vertex[first:last], w[0, : last - first], g[0, : last - first]


def evaluate_many(kernel, x, cell):
    """Weights (n, MAX_RING) and gradients (n, MAX_RING, d) at points x (n, d) of given cells (n,)."""
    w = np.zeros((len(x), MAX_RING))
    g = np.zeros((len(x), MAX_RING, kernel.dim))
    tabulate(kernel.axes, np.ascontiguousarray(x, float), cell, kernel.rings, optional(kernel.phi), w, g)
    return w, g


@njit(cache=True, error_model="numpy")
def tabulate(axes, x, cell, rings, phi, w, g):
    """Loop of `evaluate_many`."""
    t, (rings, phi) = scratch(TABLE_SIZE), borrow((rings, phi))
    for p in range(len(x)):
        ring = ring_of(axes, cell[p], rings)
        x_p = take(x, p * len(axes), axes)
        m, q, phi_bar, _, _, _ = weights(axes, t, ring, x_p, rings, phi, None)
        first, n, _ = ring
        for k in range(n):
            at = FIRST + k * ENTRY
            w[p, k] = entry(t, at + W)
            phi_k = take(phi, entry(rings.vertex, first + k) * len(axes), axes)
            g_k = gradient(entry(t, at + D), w[p, k], load(t, at + R, x_p), m, q, phi_bar, phi_k)
            store(g, (p * MAX_RING + k) * len(axes), g_k)


def check_cells(kernel, mesh):
    """Raise ValueError where the moment matrix is singular: cell, place and mesh quality there."""
    corners = kernel.points[kernel.cells]
    centre = corners.mean(axis=1)
    worst = np.zeros(len(centre))
    for x in (centre, *(0.1 * centre + 0.9 * corners[:, q] for q in range(mesh.dim + 1))):
        largest_weight(kernel.axes, x, kernel.rings, worst)
    bad = np.flatnonzero(~(worst < 100.0))
    if len(bad):
        c = bad[0]
        raise ValueError(
            f"singular moment matrix in cell {c} at {centre[c]} (weights up to {worst[c]:.1e}, cell "
            f"quality {mesh.quality(c):.3f}, {kernel.ring_start[c + 1] - kernel.ring_start[c]} ring "
            "vertices): mesh this region again, or put a wall on the boundary next to it"
        )


def negative_weights(kernel, x, cell):
    """Number of the points x (n, d) that see a negative weight (below -1e-12), and the least weight."""
    least = np.zeros(len(x))
    smallest_weight(kernel.axes, x, cell, kernel.rings, least)
    return int(np.sum(least < -1e-12)), float(least.min(initial=0.0))


@njit(cache=True, error_model="numpy")
def largest_weight(axes, x, rings, out):
    """Raise `out` to the largest |w| at one point of every cell; not a number stays."""
    t, rings = scratch(TABLE_SIZE), borrow(rings)
    for c in range(len(x)):
        ring = ring_of(axes, c, rings)
        weights(axes, t, ring, take(x, c * len(axes), axes), rings, None, None)
        for k in range(ring[1]):
            w = abs(entry(t, FIRST + k * ENTRY + W))
            if out[c] == out[c] and not w <= out[c]:
                out[c] = w


@njit(cache=True, error_model="numpy")
def smallest_weight(axes, x, cell, rings, out):
    """Least weight at every point."""
    t, rings = scratch(TABLE_SIZE), borrow(rings)
    for p in range(len(x)):
        ring = ring_of(axes, cell[p], rings)
        weights(axes, t, ring, take(x, p * len(axes), axes), rings, None, None)
        out[p] = np.inf
        for k in range(ring[1]):
            out[p] = min(out[p], entry(t, FIRST + k * ENTRY + W))
