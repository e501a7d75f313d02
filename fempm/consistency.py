"""Variationally consistent gradients: one vector phi per vertex that makes `int g_hat_k dx = 0`.

With `K_kl = int w_k w_l - delta_kl w_k + w_l g_k . (x_l - x) dx` the consistent gradient of
`../shared/design/variational-consistency.md` integrates to `r + K phi`, r = int g, for each component
of phi. The condition is imposed on every vertex whose support lies inside the meshed region; next to
walls on the folded test functions, that is on `int g_k + sum over mirrors C^T int g_mirror`, projected
onto the free directions of wall vertices. There are more unknowns than conditions: LSQR from zero
gives the smallest phi.

K is small on smooth fields (its least singular values fall like (h / L)^4), so LSQR removes the
mesh-scale part of r, which ruins convergence, in a few dozen iterations and would need thousands for the
smooth rest, which is of second order anyway. Hence the cap on iterations.
"""

import numpy as np
from numba import njit

from .cell_shapes import equal_cells
from .lane_memory import add_totals, borrow, entry, load, scratch, store, take, take_matrix, zeros
from .lanes import WIDTH, dot, formula
from .simplex import quadrature
from .weights import (
    ENTRY,
    FIRST,
    MAX_RING,
    TABLE_SIZE,
    D,
    R,
    W,
    options,
    ring_of,
    weights,
)

ROWS_SIZE = MAX_RING * 4 * WIDTH
FEW = 0.1  # shapes over cells below which it costs next to nothing to look at the integrals first


def correct(kernel, mesh, layer, tolerance=1e-11, max_iterations=300):
    """Solve for phi and store it in the kernel; skipped where the plain integrals vanish already.

    Parameters
    ----------
    kernel : Kernel, changed in place
    mesh, layer : the SimplexMesh and WallLayer that it was built from
    tolerance : relative residual at which LSQR stops
    max_iterations : its iterations otherwise; the bar's error is the same with 30, 100, 300 and 1000

    Returns
    -------
    dict
        largest plain integral `before`, largest corrected one `after` (both relative to the volume
        of the support over its size), `iterations`, and `solved`, False where nothing was to do
    """
    shapes, conditions = equal_cells(kernel), Conditions(kernel, mesh, layer)
    look_first = len(shapes[1]) < FEW * len(kernel.cells)
    found = assemble(kernel, shapes, matrix_too=not look_first)
    target, before = conditions.largest(kernel, *found[-2:])
    if before < 1e-10:
        return {"before": before, "after": before, "iterations": 0, "solved": False}
    if look_first:
        found = assemble(kernel, shapes)
    row_start, column, matrix, integral, volume = found
    phi, iterations = least_squares(
        conditions,
        row_start,
        column,
        matrix,
        target,
        volume,
        kernel.inverse_support,
        tolerance,
        max_iterations,
    )
    _, after = conditions.largest(kernel, integral + multiply(row_start, column, matrix, phi), volume)
    kernel.phi = phi
    return {"before": before, "after": after, "iterations": iterations, "solved": True}


class Conditions:
    """The vertices that a condition is imposed on, and the folding of their mirrors into them."""

    def __init__(self, kernel, mesh, layer):
        self.num_vertices = len(mesh.points)
        self.unknowns = self.num_vertices + layer.num_free
        self.layer = layer
        self.rows = np.zeros((len(kernel.points), 1))
        self.rows[: self.num_vertices] = 1.0
        near_open = np.zeros(self.num_vertices, bool)
        near_open[layer.open_facets.ravel()] = near_open[layer.contact_facets.ravel()] = True
        source = np.repeat(np.arange(self.num_vertices), np.diff(mesh.adjacency_start))
        for _ in range(2):  # the rings of all cells in the support lie within two edges
            near_open[source[near_open[mesh.adjacency]]] = True
        self.rows[np.flatnonzero(near_open)] = 0.0
        self.rows[layer.incomplete] = 0.0

    def fold(self, integrals):
        """Add C^T times the mirrors' integrals (nv, d) to their owners', project at walls."""
        layer = self.layer
        out = integrals.copy()
        folded = np.einsum("gba,gb->ga", layer.fold, integrals[self.unknowns :])
        np.add.at(out, layer.source, folded)
        out[layer.vertices] = np.einsum("wab,wb->wa", layer.project, out[layer.vertices])
        return out

    def largest(self, kernel, integrals, volume):
        """What is left of integrals (nv, d) where there is a condition, and the largest of it to scale."""
        left, scale = self.fold(integrals) * self.rows, volume * kernel.inverse_support
        return left, np.abs(left[scale > 0] / scale[scale > 0, None]).max(initial=0.0)

    def unfold(self, values):
        """Transpose of `fold`."""
        layer = self.layer
        out = values.copy()
        out[layer.vertices] = np.einsum("wba,wb->wa", layer.project, out[layer.vertices])
        out[self.unknowns :] += np.einsum("gba,ga->gb", layer.fold, out[layer.source])
        return out


def least_squares(
    conditions,
    row_start,
    column,
    matrix,
    target,
    volume,
    inverse_support,
    tolerance,
    max_iterations,
):
    """Smallest phi with fold(K phi) = -target, by PETSc's LSQR; rows and columns scaled to size one."""
    from . import compat  # noqa: F401, before PETSc: see there

    # isort: split
    from petsc4py import PETSc

    shape = target.shape
    left = np.where(volume > 0, 1.0 / (np.maximum(volume, 1e-300) * inverse_support), 0.0)[:, None]
    left = left * conditions.rows
    right = inverse_support[:, None]
    transposed = transpose(row_start, column, matrix, shape[0])

    class Operator:
        def mult(self, _, x, y):
            phi = right * x.array_r.reshape(shape)
            y.array_w[:] = (left * conditions.fold(multiply(row_start, column, matrix, phi))).ravel()

        def multTranspose(self, _, x, y):
            rows = conditions.unfold(left * x.array_r.reshape(shape))
            y.array_w[:] = (right * multiply(*transposed, rows)).ravel()

    n = target.size
    operator = PETSc.Mat().createPython([n, n], Operator(), comm=PETSc.COMM_SELF)
    operator.setUp()
    solver = PETSc.KSP().create(PETSc.COMM_SELF)
    solver.setOperators(operator)
    solver.setType("lsqr")
    solver.getPC().setType("none")
    solver.setTolerances(rtol=tolerance, atol=0.0, max_it=max_iterations)
    rhs = PETSc.Vec().createWithArray((-left * target).ravel(), comm=PETSc.COMM_SELF)
    solution = rhs.duplicate()
    solver.solve(rhs, solution)
    return right * solution.array_r.reshape(shape), solver.its


def assemble(kernel, shapes, matrix_too=True):
    """K as CSR (row_start, column, values) or three times None, integrals r (nv, d) and int w (nv,)."""
    nv, lists = len(kernel.points), None
    points, w = quadrature(kernel.dim)
    idle = -len(w) % WIDTH  # points of zero weight fill the last lanes
    rule = np.column_stack([np.append(points, points[:idle], axis=0), np.append(w, np.zeros(idle))])
    rule = np.ascontiguousarray(rule.reshape(-1, WIDTH, kernel.dim + 2).swapaxes(1, 2))
    volumes = np.abs(1.0 / np.linalg.det(kernel.inverse)) / [1, 1, 2, 6][kernel.dim]
    if matrix_too:
        ring = (kernel.ring_start, kernel.ring_vertex)
        cell_start, cell_of = ring_cells(*ring, nv)
        row_start = matrix_rows(*ring, cell_start, cell_of, nv)
        column = matrix_columns(*ring, cell_start, cell_of, row_start, nv)
        lists = row_start, column, np.zeros(len(column))
    integral = np.zeros((nv, 1 + kernel.dim))
    integrate(kernel.axes, kernel.rings, volumes, rule, shapes, lists, integral)
    return *(lists or (None,) * 3), integral[:, 1:], integral[:, 0]


@njit(cache=True)
def ring_cells(ring_start, ring_vertex, nv):
    """CSR lists of the cells whose ring holds each vertex."""
    start = np.zeros(nv + 1, np.int64)
    for k in ring_vertex:
        start[k + 1] += 1
    start = np.cumsum(start)
    fill = start[:-1].copy()
    out = np.empty(len(ring_vertex), np.int32)
    for c in range(len(ring_start) - 1):
        for i in range(ring_start[c], ring_start[c + 1]):
            out[fill[ring_vertex[i]]] = c
            fill[ring_vertex[i]] += 1
    return start, out


@njit(cache=True)
def matrix_rows(ring_start, ring_vertex, cell_start, cell_of, nv):
    """Row offsets of K: vertices are coupled where a ring holds both."""
    seen = np.full(nv, -1, np.int64)
    out = np.zeros(nv + 1, np.int64)
    for k in range(nv):
        n = 0
        for j in range(cell_start[k], cell_start[k + 1]):
            c = cell_of[j]
            for i in range(ring_start[c], ring_start[c + 1]):
                if seen[ring_vertex[i]] != k:
                    seen[ring_vertex[i]] = k
                    n += 1
        out[k + 1] = out[k] + n
    return out


@njit(cache=True)
def matrix_columns(ring_start, ring_vertex, cell_start, cell_of, row_start, nv):
    """Sorted columns of each row of K."""
    seen = np.full(nv, -1, np.int64)
    column = np.empty(row_start[-1], np.int32)
    for k in range(nv):
        at = row_start[k]
        for j in range(cell_start[k], cell_start[k + 1]):
            c = cell_of[j]
            for i in range(ring_start[c], ring_start[c + 1]):
                if seen[ring_vertex[i]] != k:
                    seen[ring_vertex[i]] = k
                    column[at] = ring_vertex[i]
                    at += 1
        column[row_start[k] : at].sort()
    return column


@formula
def factors(b, volume, frame, others):
    """Quadrature points, of barycentric coordinates b[:-1] in a cell, and weights b[-1] times its volume."""
    corner, _ = frame
    x = (x_a + sum(b_q * (y[a] - x_a) for b_q, y in zip(b[1:], others)) for a, x_a in enumerate(corner))
    return tuple(x), b[-1] * volume


@formula
def row_and_column(dv, d, w, r, m, k_inverse):
    """Row (w, g) dv and column (w, w r) of a ring vertex: K_kl + delta_kl w_k sums row_k . column_l."""
    g = [d * dot(row, [r_a - m_a for r_a, m_a in zip(r, m)]) for row in k_inverse]
    return tuple(dv * q for q in (w, *g)), (w, *(w * r_a for r_a in r))


@formula
def add_dot(sum, a, b):
    """sum + a . b"""
    return sum + dot(a, b)


@formula
def add(a, b):
    """Sum of two tuples."""
    return tuple(p + q for p, q in zip(a, b))


@formula
def subtract(a, b):
    """First number less the first of a tuple."""
    return a - b[0]


@njit(**options)
def edge_corners(axes, cell, rings, table):
    """The corners of a cell but the first."""
    for q in range(len(axes)):
        v = entry(rings.cells, cell * (len(axes) + 1) + q + 1)
        store(table, q * len(axes), take(rings.points, v * len(axes), axes))
    return take_matrix(table, 0, axes)


@njit(**options)
def integrate(axes, rings, volumes, rule, shapes, lists, integral):
    """Add the integrals of all cells to K and to int w and r.

    Parameters
    ----------
    rule : (batches, d + 2, WIDTH) barycentric coordinates and weight of WIDTH points at a time
    shapes : see `equal_cells`
    lists : row_start, column and values of K, or None
    integral : (nv, 1 + d)
    """
    cells, start, place = shapes
    lent, t, corners = borrow(rings), scratch(TABLE_SIZE), scratch(9)
    rows, columns, sums = scratch(ROWS_SIZE), scratch(ROWS_SIZE), scratch(ROWS_SIZE)
    products = np.empty(MAX_RING * MAX_RING * WIDTH)
    found, at_place = np.empty((MAX_RING, MAX_RING)), np.empty(MAX_RING, np.int64)
    whole = np.empty((MAX_RING, 1 + len(axes)))
    nothing = zeros((0, *axes))  # a row
    size = len(nothing)
    for shape in range(len(start) - 1):
        c = cells[start[shape]]
        ring = ring_of(axes, c, lent)
        first, n, frame = ring
        others = edge_corners(axes, c, lent, corners)
        products[: n * n * WIDTH] = 0.0
        for k in range(n):
            store(sums, k * size, nothing)
        for i in range(len(rule)):
            x, dv = factors(load(rule, i * (size + 1), zeros((0, 0, *axes))), volumes[c], frame, others)
            m, k_inverse, _, _, _, _ = weights(axes, t, ring, x, lent, None, None)
            for k in range(n):
                at, diagonal = FIRST + k * ENTRY, k * n + k
                d, w, r = load(t, at + D, dv), load(t, at + W, dv), load(t, at + R, x)
                row_k, column_k = row_and_column(dv, d, w, r, m, k_inverse)
                store(rows, k * size, row_k)
                store(columns, k * size, column_k)
                store(sums, k * size, add(load(sums, k * size, row_k), row_k))
                store(products, diagonal, subtract(load(products, diagonal, dv), row_k))
            for k in range(n):
                row_k = load(rows, k * size, nothing)
                for j in range(n):
                    at, column_j = k * n + j, load(columns, j * size, nothing)
                    store(products, at, add_dot(load(products, at, dv), row_k, column_j))
        found[:n, :n], whole[:n] = 0.0, 0.0
        for k in range(n):
            at_place[place[first + k]] = k
            add_totals(whole, k * size, load(sums, k * size, nothing))
            for j in range(n):
                add_totals(found, k * MAX_RING + j, load(products, k * n + j, nothing[0]))
        copies = cells[start[shape] : start[shape + 1]]
        add_copies(copies, rings.start, rings.vertex, place, at_place, whole, found, integral, lists)


@njit(cache=True)
def add_copies(cells, ring_start, vertex, place, at_place, whole, found, integral, lists):
    """Add the integrals `whole` and `found` over one cell, found at places `at_place`, for all its copies."""
    for cell in cells:
        own = range(ring_start[cell], ring_start[cell + 1])
        for k in own:
            v, row = vertex[k], at_place[place[k]]
            for a in range(integral.shape[1]):
                integral[v, a] += whole[row, a]
            if lists is not None:
                row_start, column, matrix = lists
                at = row_start[v]
                for j in own:
                    while column[at] < vertex[j]:
                        at += 1
                    matrix[at] += found[row, at_place[place[j]]]


@njit(cache=True)
def multiply(row_start, column, values, x):
    """CSR matrix times (n, d) array."""
    n, d = len(row_start) - 1, x.shape[1]
    y, padded = np.zeros((n, d)), np.zeros((len(x), 3))
    for a in range(d):
        for i in range(len(x)):
            padded[i, a] = x[i, a]
    for i in range(n):
        s, t, u = 0.0, 0.0, 0.0
        for j in range(row_start[i], row_start[i + 1]):
            v, k = values[j], column[j]
            s += v * padded[k, 0]
            t += v * padded[k, 1]
            u += v * padded[k, 2]
        y[i, 0] = s
        if d > 1:
            y[i, 1] = t
        if d > 2:
            y[i, 2] = u
    return y


@njit(cache=True)
def transpose(row_start, column, values, n):
    """CSR transpose."""
    start = np.zeros(n + 1, np.int64)
    for j in column:
        start[j + 1] += 1
    start = np.cumsum(start)
    fill = start[:-1].copy()
    rows = np.empty(len(column), np.int32)
    out = np.empty(len(column))
    for i in range(len(row_start) - 1):
        for j in range(row_start[i], row_start[i + 1]):
            rows[fill[column[j]]] = i
            out[fill[column[j]]] = values[j]
            fill[column[j]] += 1
    return start, rows, out
