"""Weights and gradients of the UMLS kernel at particles, in one formulation for 1D, 2D and 3D.

One particle, or four of them at a time (see `lanes`), runs along the ring of its cell; what belongs to
particle and ring vertex, D, w and r, goes to a small table `t`. The dimension is the length of the tuple
`axes`, which compilers know.

The kernel of a particle at x with offsets r_k = x_k - x and D_k = eta_k d_k is, in closed form,

    m0 = sum D,  m = sum D r / m0,  K = (sum D r (x) r - m0 m (x) m)^-1
    w_k = D_k (1/m0 - m . K (r_k - m))                      MLS weight            (thesis 2.22)
    g_k = D_k K (r_k - m)                                   MLS gradient
    g_hat_k = D_k Q (r_k - m) + w_k (phi_bar - phi_k)       consistent gradient   (design note)

with phi_bar = sum w phi, T = -sum w phi (x) r and Q = (I - T) K; the plain gradient is phi = 0. Symmetric
matrices are tuples of their upper triangle, row by row.
"""

from typing import NamedTuple

import numpy as np
from numba import njit

from .lane_memory import entry, load, store, take, take_matrix
from .lanes import FAST, WIDTH, dot, formula, positive, sqrt, zero

MAX_RING = 176
# the table: eta for every adjacency mask, then from FIRST on, for every ring vertex, D, w and r
D, W, R, ENTRY, FIRST = 0, 1, 2, 5, 16
TABLE_SIZE = (FIRST + MAX_RING * ENTRY) * WIDTH

options = {"fastmath": set(FAST), "error_model": "numpy", "nogil": True, "cache": True}


class Rings(NamedTuple):
    """What compiled code reads of a mesh; the fields are those of `kernel.Kernel`.

    The functions below take it borrowed (see `lane_memory.borrow`), and phi too.
    """

    cells: np.ndarray
    inverse: np.ndarray
    points: np.ndarray
    inverse_support: np.ndarray
    start: np.ndarray
    vertex: np.ndarray
    mask: np.ndarray


def optional(array):
    """The array, or None if it is empty: compiled code then leaves out what would use it."""
    return array if len(array) else None


@njit(forceinline=True, **options)
def ring_of(axes, cell, rings):
    """Range of the ring of a cell in `rings.vertex`, and the cell's corner and inverse."""
    first, end = entry(rings.start, cell), entry(rings.start, cell + 1)
    return first, end - first, cell_frame(axes, cell, rings.cells, rings.points, rings.inverse)


@njit(**options)
def cell_frame(axes, cell, cells, points, inverse):
    """First corner of a cell and the inverse of its edge matrix, as tuples."""
    dim = len(axes)
    corner = take(points, entry(cells, cell * (dim + 1)) * dim, axes)
    return corner, take_matrix(inverse, cell * dim * dim, axes)


@formula
def barycentric_coordinates(x, frame):
    """Barycentric coordinates in a cell of given `cell_frame`."""
    corner, inverse = frame
    offset = [p - q for p, q in zip(x, corner)]
    b = [dot(row, offset) for row in inverse]
    return (1.0 - sum(b), *b)


@njit(**options)
def barycentric(axes, b, x, cell, cells, points, inverse):
    """Barycentric coordinates of x in `cell`, written to b."""
    frame = cell_frame(axes, cell, cells, points, inverse)
    store(b, 0, barycentric_coordinates(take(x, 0, axes), frame))


@formula
def etas(b):
    """eta = sum of the barycentric coordinates of adjacent corners (thesis eq. 2.29), for every mask."""
    out = [zero(b[0])]
    for mask in range(1, 2 ** len(b)):
        q = mask.bit_length() - 1
        out.append(b[q] if mask == 1 << q else out[mask - (1 << q)] + b[q])
    return tuple(out)


def upper(d):
    """Pairs of indices of the upper triangle."""
    return [(a, b) for a in range(d) for b in range(a, d)]


@formula
def no_moments(x):
    """Sums of nothing, for `add_moments`."""
    o = zero(x[0])
    return o, (o,) * len(x), (o,) * len(upper(len(x)))


@formula
def distance(x, point, inverse_support):
    """Offset r of a ring vertex and its length over the support."""
    r = tuple(p - q for p, q in zip(point, x))
    return r, sqrt(dot(r, r)) * inverse_support


@formula
def add_moments(sums, q, r, eta):
    """D of a ring vertex; the sums of D, D r and D r (x) r with its terms added."""
    m0, m, c = sums
    outer, inner = positive(1.5 - q), positive(0.5 - q)
    d = eta * (outer * outer - 3.0 * inner * inner)  # twice the B-spline: its scale cancels
    dr = [d * r_a for r_a in r]
    m = tuple(s + t for s, t in zip(m, dr))
    return d, (m0 + d, m, add_outer(c, dr, r))


def add_outer(sums, a, b):
    """Upper triangle of a (x) b, added."""
    return tuple(s + a[i] * b[j] for s, (i, j) in zip(sums, upper(len(a))))


def inverse_symmetric(c):
    """Inverse of a symmetric matrix."""
    if len(c) == 1:
        return (1.0 / c[0],)
    if len(c) == 3:
        det = 1.0 / (c[0] * c[2] - c[1] * c[1])
        return c[2] * det, -c[1] * det, c[0] * det
    c00, c01, c02, c11, c12, c22 = c
    k00 = c11 * c22 - c12 * c12
    k01 = c02 * c12 - c01 * c22
    k02 = c01 * c12 - c02 * c11
    det = 1.0 / (c00 * k00 + c01 * k01 + c02 * k02)
    k11, k12, k22 = c00 * c22 - c02 * c02, c01 * c02 - c00 * c12, c00 * c11 - c01 * c01
    return k00 * det, k01 * det, k02 * det, k11 * det, k12 * det, k22 * det


def full(c):
    """Rows of a symmetric matrix."""
    d = {1: 1, 3: 2, 6: 3}[len(c)]
    at = upper(d)
    return tuple(tuple(c[at.index((min(a, b), max(a, b)))] for b in range(d)) for a in range(d))


@formula
def close_moments(sums):
    """Mean offset m, matrix K, and a0, b of the weights w = D (a0 - b . r)."""
    m0, m, c = sums
    i0 = 1.0 / m0
    m = tuple(m_a * i0 for m_a in m)
    c = tuple(c_ab - m0 * m[a] * m[b] for c_ab, (a, b) in zip(c, upper(len(m))))
    k = full(inverse_symmetric(c))
    b = tuple(dot(row, m) for row in k)
    return m, k, i0 + dot(m, b), b


@formula
def no_inertia(x, wanted):
    """Sums of nothing, for `add_weight`."""
    return None if wanted is None else (zero(x[0]),) * len(upper(len(x)))


@formula
def add_weight(sums, d, r, a0, b):
    """w of a ring vertex; the sums of w r (x) r with its term added, where they are wanted."""
    w = d * (a0 - dot(b, r))
    return w, None if sums is None else add_outer(sums, [w * r_a for r_a in r], r)


@formula
def no_phi_sums(x, phi):
    """Sums of nothing, for `add_phi`."""
    o, d = zero(x[0]), len(x)
    return None if phi is None else ((o,) * d, ((o,) * d,) * d)


@formula
def add_phi(sums, w, r, phi):
    """The sums of w phi and w phi (x) r with a ring vertex added."""
    wphi = [w * p for p in phi]
    mean = tuple(s + t for s, t in zip(sums[0], wphi))
    return mean, tuple(tuple(s + t * r_b for s, r_b in zip(row, r)) for row, t in zip(sums[1], wphi))


@formula
def consistent(k, sums):
    """Q = (I - T) K and phi_bar."""
    if sums is None:
        return k, None
    mean, t = sums
    t = [[t_ab + 1.0 if a == b else t_ab for b, t_ab in enumerate(row)] for a, row in enumerate(t)]
    return tuple(tuple(dot(row, column) for column in k) for row in t), mean


@njit(forceinline=True, **options)
def weights(axes, t, ring, x, rings, phi, affine):
    """Fill the table `t` for particles at x in the cell with the given `ring_of`.

    Returns the mean offset m, the matrix Q, phi_bar (None for plain gradients) of the module's formulas, a0
    and b of w = D (a0 - b . r), and sum w r (x) r unless `affine` is None. Several short loops, as
    processors look ahead only so far and have few registers.
    """
    first, n, frame = ring
    dim = len(axes)
    store(t, 0, etas(barycentric_coordinates(x, frame)))
    for k in range(n):
        v = entry(rings.vertex, first + k)
        r, q = distance(x, take(rings.points, v * dim, axes), entry(rings.inverse_support, v))
        store(t, FIRST + k * ENTRY + D, q)
        store(t, FIRST + k * ENTRY + R, r)
    sums = no_moments(x)
    for k in range(n):
        at = FIRST + k * ENTRY
        eta = load(t, entry(rings.mask, first + k), x[0])
        d, sums = add_moments(sums, load(t, at + D, eta), load(t, at + R, x), eta)
        store(t, at + D, d)
    m, k_inverse, a0, b = close_moments(sums)
    inertia = no_inertia(x, affine)
    for k in range(n):
        at = FIRST + k * ENTRY
        w, inertia = add_weight(inertia, load(t, at + D, a0), load(t, at + R, x), a0, b)
        store(t, at + W, w)
    phi_sums = no_phi_sums(x, phi)
    if phi is not None:
        for k in range(n):
            at = FIRST + k * ENTRY
            w, r = load(t, at + W, a0), load(t, at + R, x)
            phi_sums = add_phi(phi_sums, w, r, take(phi, entry(rings.vertex, first + k) * dim, axes))
    q, phi_bar = consistent(k_inverse, phi_sums)
    return m, q, phi_bar, a0, b, inertia


@formula
def gradient(d, w, r, m, q, phi_bar, phi):
    """g_hat of a ring vertex."""
    offset = [r_a - m_a for r_a, m_a in zip(r, m)]
    g = [d * dot(row, offset) for row in q]
    if phi is None:
        return tuple(g)
    return tuple(g_a + w * (mean - p) for g_a, mean, p in zip(g, phi_bar, phi))
