"""Velocity and pressure spaces on a simplex mesh: median dual of the nodes, edges, discrete gradient.

| pair  | velocity and conserved variables          | pressure           |
| ----- | ----------------------------------------- | ------------------ |
| B1-B0 | vertices, linear                          | cells, constant    |
| B2-B1 | vertices and edges, Bernstein of degree 2 | vertices, linear   |

Bernstein polynomials are the B-splines of a simplex: they are not negative, so the lumped volume
`m_i = int phi_i` of every node is positive. A scheme on edges needs no more than m_i and
`c_ij = int phi_i grad phi_j`: nodes i and j exchange fluxes through the area `n_ij = c_ij - c_ji`.
On a uniform mesh B1-B0 is the grid of the thesis (section 3.2.6) with its dual.
"""

from dataclasses import dataclass
from itertools import combinations
from math import factorial

import numpy as np

from fempm.walls import facet_normals

PAIRS = ("B1-B0", "B2-B1")


@dataclass
class Space:
    """Nodes of the conserved variables with their median dual, and the dofs of the pressure.

    Attributes
    ----------
    points : (n, d) nodes; of a periodic pair of nodes, the first
    volumes : (n,) m_i = int phi_i
    edges : (ne, 2) int32 nodes that share a cell
    vectors : (ne, d) from the first node of each edge to the second
    forward, backward : (ne, d) c_ij and c_ji
    cell_nodes : (nc, nb) int32 nodes of each cell
    cell_pressures : (nc, np) int32 pressure dofs of each cell
    pressure_volumes : (nq,) int chi_q
    coefficients : (nc, np, nb, d) int chi_q grad phi_b over each cell
    weights : (np, nb) mean of chi_q phi_b over a cell over that of chi_q: rows that sum to one
    cell_volumes : (nc,)
    node_of_vertex : (nv,) int32 node at each vertex of the mesh
    """

    points: np.ndarray
    volumes: np.ndarray
    edges: np.ndarray
    vectors: np.ndarray
    forward: np.ndarray
    backward: np.ndarray
    cell_nodes: np.ndarray
    cell_pressures: np.ndarray
    pressure_volumes: np.ndarray
    coefficients: np.ndarray
    weights: np.ndarray
    cell_volumes: np.ndarray
    node_of_vertex: np.ndarray

    @property
    def dim(self):
        """Space dimension d."""
        return self.points.shape[1]


def build_space(mesh, pair="B1-B0", periodic=()):
    """Space of a velocity and pressure pair on a mesh.

    Parameters
    ----------
    mesh : fempm.SimplexMesh
    pair : "B1-B0" or "B2-B1"
    periodic : pairs of boundary names whose facets are the same up to a translation

    Raises
    ------
    ValueError
        for another pair, or boundaries that do not match
    """
    if pair not in PAIRS:
        raise ValueError(f"pair {pair!r}: give {' or '.join(map(repr, PAIRS))}")
    degree = int(pair[1])
    gradients = barycentric_gradients(mesh)
    cells = mesh.cells if degree == 1 else quadratic_cells(mesh)
    basis, linear = bernstein(mesh.dim, degree), bernstein(mesh.dim, degree - 1)
    corners = mesh.points[mesh.cells]
    offset = np.array([list(a) for a in basis_places(mesh.dim, degree)])
    places = np.einsum("ba,cad->cbd", offset, corners)
    points = np.empty((cells.max() + 1, mesh.dim))
    points[cells] = places
    slopes = np.einsum("ija,cad->cijd", table([basis, basis], last=True), gradients)
    slopes *= mesh.volumes[:, None, None, None]

    merged = merge_periodic(mesh, points, cells, periodic)
    nodes = merged[cells]
    points = points[np.unique(merged, return_index=True)[1]]
    edges, vectors, forward, backward = edge_arrays(nodes, places, slopes)
    pressures = np.arange(len(cells))[:, None] if degree == 1 else merged[mesh.cells]
    coefficients = np.einsum("qba,cad->cqbd", table([linear, basis], last=True), gradients)
    weight = mesh.volumes / pressures.shape[1]
    return Space(
        points,
        np.bincount(nodes.ravel(), np.repeat(mesh.volumes / nodes.shape[1], nodes.shape[1])),
        edges,
        vectors,
        forward,
        backward,
        nodes.astype(np.int32),
        pressures.astype(np.int32),
        np.bincount(pressures.ravel(), np.repeat(weight, pressures.shape[1])),
        np.ascontiguousarray(coefficients * mesh.volumes[:, None, None, None]),
        table([linear, basis]) * len(linear),
        mesh.volumes,
        merged[: len(mesh.points)].astype(np.int32),
    )


def barycentric_gradients(mesh):
    """(nc, d + 1, d) gradients of the barycentric coordinates of each cell."""
    return np.concatenate([-mesh.inverse.sum(axis=1, keepdims=True), mesh.inverse], axis=1)


def bernstein(dim, degree):
    """Bernstein polynomials of a degree: list of (coefficient, exponents of the d + 1 coordinates)."""
    unit = np.eye(dim + 1, dtype=int)
    if degree == 0:
        return [(1, tuple(0 * unit[0]))]
    if degree == 1:
        return [(1, tuple(e)) for e in unit]
    squares = [(1, tuple(2 * e)) for e in unit]
    return squares + [(2, tuple(unit[a] + unit[b])) for a, b in combinations(range(dim + 1), 2)]


def basis_places(dim, degree):
    """Barycentric coordinates of the control points of `bernstein`: exponents over degree."""
    return [np.array(exponents) / degree for _, exponents in bernstein(dim, degree)]


def mean_of_monomial(exponents):
    """Mean of a product of powers of the barycentric coordinates over a simplex."""
    dim, total = len(exponents) - 1, sum(exponents)
    top = factorial(dim) * np.prod([factorial(e) for e in exponents])
    return float(top / factorial(dim + total))


def table(factors, last=False):
    """Means of products with one polynomial of each list; `last`: the last one's derivatives, axis a."""
    dim = len(factors[0][0][1]) - 1
    out = np.zeros((*(len(f) for f in factors), dim + 1))
    for index in np.ndindex(out.shape[:-1]):
        coefficient, exponents = 1, np.zeros(dim + 1, int)
        for f, k in zip(factors, index):
            coefficient, exponents = coefficient * f[k][0], exponents + f[k][1]
        derived = factors[-1][index[-1]][1]
        for a in range(dim + 1):
            if not last:
                out[(*index, a)] = coefficient * mean_of_monomial(exponents)
            elif derived[a]:
                lowered = exponents - np.eye(dim + 1, dtype=int)[a]
                out[(*index, a)] = coefficient * derived[a] * mean_of_monomial(lowered)
    return out if last else out[..., 0].copy()


def quadratic_cells(mesh):
    """(nc, nb) vertices, then the nodes on the edges, in the order of `bernstein`."""
    pairs = np.array(list(combinations(range(mesh.dim + 1), 2)))
    ends = np.sort(mesh.cells[:, pairs].astype(np.int64), axis=2)
    keys = ends[..., 0] * len(mesh.points) + ends[..., 1]
    number = np.unique(keys, return_inverse=True)[1].reshape(keys.shape)
    return np.concatenate([mesh.cells, len(mesh.points) + number], axis=1)


def edge_arrays(nodes, places, slopes):
    """Edges (ne, 2), their vectors, and c_ij, c_ji summed over cells."""
    a, b = np.triu_indices(nodes.shape[1], 1)
    i, j = nodes[:, a].ravel().astype(np.int64), nodes[:, b].ravel().astype(np.int64)
    d = places.shape[2]
    vector = (places[:, b] - places[:, a]).reshape(-1, d)
    there, back = slopes[:, a, b].reshape(-1, d), slopes[:, b, a].reshape(-1, d)
    turned = i > j
    i[turned], j[turned] = j[turned], i[turned]
    vector[turned] *= -1
    there[turned], back[turned] = back[turned], there[turned]
    keys, first, number = np.unique(i * (nodes.max() + 1) + j, return_index=True, return_inverse=True)
    number = number.ravel()
    forward, backward = (
        np.stack([np.bincount(number, c[:, k], len(keys)) for k in range(d)], axis=1) for c in (there, back)
    )
    return np.stack([i[first], j[first]], axis=1).astype(np.int32), vector[first], forward, backward


def boundary_areas(mesh, space, facets):
    """(n, d) int phi_i n over exterior facets (nf, d), for each node i."""
    dim, out = mesh.dim, np.zeros_like(space.points)
    if len(facets) == 0:
        return out
    areas = facet_normals(mesh, facets)
    degree = 1 if space.cell_nodes.shape[1] == dim + 1 else 2
    nodes = facet_nodes(mesh, facets, space.cell_nodes, space.node_of_vertex)
    for (coefficient, exponents), column in zip(bernstein(dim - 1, degree), nodes.T):
        np.add.at(out, column, areas * coefficient * mean_of_monomial(exponents))
    return out


def facet_nodes(mesh, facets, cell_nodes, node_of_vertex):
    """(nf, m) nodes of facets: at their vertices and, of degree two, on their edges."""
    corners, inner = mesh.dim + 1, list(combinations(range(mesh.dim), 2))
    if cell_nodes.shape[1] == corners or not inner:
        return node_of_vertex[facets]
    pairs = np.array(list(combinations(range(corners), 2)))
    keys = np.sort(mesh.cells[:, pairs].astype(np.int64), axis=2) @ [len(mesh.points), 1]
    unique, first = np.unique(keys, return_index=True)
    ends = np.sort(facets[:, np.array(inner)].astype(np.int64), axis=2) @ [len(mesh.points), 1]
    on_edges = cell_nodes[:, corners:].ravel()[first[np.searchsorted(unique, ends)]]
    return np.concatenate([node_of_vertex[facets], on_edges], axis=1)


def merge_periodic(mesh, points, cells, periodic):
    """(n,) new number of each node, the same for nodes that a periodic pair of boundaries joins."""
    same = np.arange(len(points))
    size = np.ptp(mesh.points, axis=0).max()
    for names in periodic:
        on = [np.unique(facet_nodes(mesh, mesh.facets(name), cells, same)) for name in names]
        shift = points[on[0]].mean(axis=0) - points[on[1]].mean(axis=0)
        order = [np.lexsort(np.round(x / (1e-6 * size)).T) for x in (points[on[0]], points[on[1]] + shift)]
        a, b = (nodes[k] for nodes, k in zip(on, order))
        if len(a) != len(b) or np.abs(points[a] - points[b] - shift).max() > 1e-5 * size:
            raise ValueError(f"boundaries {names[0]!r} and {names[1]!r} are not images of each other")
        for x, y in zip(same[a], same[b]):
            same[same == max(x, y)] = min(x, y)
    return np.unique(same, return_inverse=True)[1].ravel()
