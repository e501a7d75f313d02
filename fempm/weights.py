"""Weights and gradients of the UMLS kernel at a particle, in one formulation for 1D, 2D and 3D.

A cell's ring (coordinates, inverse supports, adjacency masks, phi) is gathered once into a small
scratch table ``s``, one row per quantity and one column per ring vertex; every particle then runs
branch-free loops along those rows. The dimension is the length of the tuple `axes`, which compilers
know, so that the `if dim` guards cost nothing.

The kernel of a particle at x with offsets r_k = x_k - x and D_k = eta_k d_k is, in closed form,

    m0 = sum D,  m = sum D r / m0,  K = (sum D r (x) r - m0 m (x) m)^-1
    w_k = D_k (1/m0 - m . K (r_k - m))                      MLS weight            (thesis 2.22)
    g_k = D_k K (r_k - m)                                   MLS gradient
    g_hat_k = D_k Q (r_k - m) + w_k (phi_bar - phi_k)       consistent gradient   (design note)

with phi_bar = sum w phi, T = -sum w phi (x) r and Q = (I - T) K; the plain gradient is phi = 0.
"""

from typing import NamedTuple

import numpy as np
from numba import njit

# Rows of the scratch table `s`, a flat array, as offsets: s[W + k] is the weight of ring vertex k, and
# s[X + k], s[X + ROW + k], ... are its coordinates. Constant offsets let compilers see that rows do not
# overlap, so that loops along them become vector code; 23 cache lines a row, so that rows do not share
# cache sets.
ROW = 184
X, IH, ETA, PHI, U, DU, D, W, R, SIZE = (row * ROW for row in (0, 3, 4, 8, 11, 14, 17, 18, 19, 22))
MAX_RING = ROW - 8

# no `nnan`/`ninf`: a run that goes wrong must still be seen as such
FAST = {"reassoc", "contract", "arcp", "nsz", "afn"}
options = {"fastmath": FAST, "error_model": "numpy", "nogil": True, "cache": True}


class Rings(NamedTuple):
    """What compiled code reads of a mesh; the fields are those of `kernel.Kernel`."""

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


@njit(**options)
def gather_ring(axes, s, cell, rings, phi):
    """Copy the ring of `cell` into the scratch table; return its padded length."""
    first = rings.start[cell]
    n = rings.start[cell + 1] - first
    padded = (n + 7) // 8 * 8
    points, inverse_support = rings.points, rings.inverse_support
    ring_vertex, ring_mask = rings.vertex, rings.mask
    for k in range(n):
        v = ring_vertex[first + k]
        s[IH + k] = inverse_support[v]
        mask = ring_mask[first + k]
        for a in range(len(axes)):
            s[X + a * ROW + k] = points[v, a]
        for q in range(len(axes) + 1):
            s[ETA + q * ROW + k] = (mask >> q) & 1
        if phi is not None:
            for a in range(len(axes)):
                s[PHI + a * ROW + k] = phi[v, a]
    for k in range(n, padded):  # columns of zero weight, so that no loop has a scalar remainder
        for row in range(0, SIZE, ROW):
            s[row + k] = 0.0
    return padded


@njit(**options)
def inverse_symmetric(dim, c00, c01, c02, c11, c12, c22):
    """Inverse of the leading dim x dim block of a symmetric matrix, zero elsewhere."""
    if dim == 1:
        return 1.0 / c00, 0.0, 0.0, 0.0, 0.0, 0.0
    if dim == 2:
        det = 1.0 / (c00 * c11 - c01 * c01)
        return c11 * det, -c01 * det, 0.0, c00 * det, 0.0, 0.0
    k00 = c11 * c22 - c12 * c12
    k01 = c02 * c12 - c01 * c22
    k02 = c01 * c12 - c02 * c11
    det = 1.0 / (c00 * k00 + c01 * k01 + c02 * k02)
    k11 = (c00 * c22 - c02 * c02) * det
    k12 = (c01 * c02 - c00 * c12) * det
    k22 = (c00 * c11 - c01 * c01) * det
    return k00 * det, k01 * det, k02 * det, k11, k12, k22


@njit(**options)
def inverse_inertia(axes, s, n):
    """Inverse of the APIC matrix D_p = sum w r (x) r (thesis eq. 2.35), six entries."""
    dim = len(axes)
    c00 = c01 = c02 = c11 = c12 = c22 = 0.0
    for k in range(n):
        r0 = s[R + k]
        w0 = s[W + k] * r0
        c00 += w0 * r0
        if dim > 1:
            r1 = s[R + ROW + k]
            c01 += w0 * r1
            c11 += s[W + k] * r1 * r1
        if dim > 2:
            r2 = s[R + 2 * ROW + k]
            c02 += w0 * r2
            c12 += s[W + k] * r1 * r2
            c22 += s[W + k] * r2 * r2
    return inverse_symmetric(dim, c00, c01, c02, c11, c12, c22)


@njit(**options)
def moments(axes, s, n, x, b):
    """Fill the rows R and D; return sum D, sum D r (three entries) and sum D r (x) r (six)."""
    dim = len(axes)
    m0 = m1 = m2 = m3 = 0.0
    c00 = c01 = c02 = c11 = c12 = c22 = 0.0
    for k in range(n):
        r0 = s[X + k] - x[0]
        s[R + k] = r0
        square = r0 * r0
        eta = s[ETA + k] * b[0] + s[ETA + ROW + k] * b[1]
        if dim > 1:
            r1 = s[X + ROW + k] - x[1]
            s[R + ROW + k] = r1
            square += r1 * r1
            eta += s[ETA + 2 * ROW + k] * b[2]
        if dim > 2:
            r2 = s[X + 2 * ROW + k] - x[2]
            s[R + 2 * ROW + k] = r2
            square += r2 * r2
            eta += s[ETA + 3 * ROW + k] * b[3]
        q = np.sqrt(square) * s[IH + k]
        outer = max(0.0, 1.5 - q)
        inner = max(0.0, 0.5 - q)
        d = eta * (0.5 * outer * outer - 1.5 * inner * inner)  # quadratic B-spline
        s[D + k] = d
        m0 += d
        d0 = d * r0
        m1 += d0
        c00 += d0 * r0
        if dim > 1:
            d1 = d * r1
            m2 += d1
            c01 += d0 * r1
            c11 += d1 * r1
        if dim > 2:
            m3 += d * r2
            c02 += d0 * r2
            c12 += d1 * r2
            c22 += d * r2 * r2
    return m0, m1, m2, m3, c00, c01, c02, c11, c12, c22


@njit(**options)
def fill_weights(axes, s, n, a0, b0, b1, b2):
    """Fill the row W with w = D (a0 - b . r)."""
    for k in range(n):
        t = a0 - b0 * s[R + k]
        if len(axes) > 1:
            t -= b1 * s[R + ROW + k]
        if len(axes) > 2:
            t -= b2 * s[R + 2 * ROW + k]
        s[W + k] = s[D + k] * t


@njit(**options)
def fill_weights_and_phi(axes, s, n, a0, b0, b1, b2):
    """The same in one loop with phi_bar = sum w phi (three entries) and -T = sum w phi (x) r (nine)."""
    dim = len(axes)
    p0 = p1 = p2 = 0.0
    t00 = t01 = t02 = t10 = t11 = t12 = t20 = t21 = t22 = 0.0
    for k in range(n):
        r0 = s[R + k]
        t = a0 - b0 * r0
        if dim > 1:
            r1 = s[R + ROW + k]
            t -= b1 * r1
        if dim > 2:
            r2 = s[R + 2 * ROW + k]
            t -= b2 * r2
        w = s[D + k] * t
        s[W + k] = w
        f = w * s[PHI + k]
        p0 += f
        t00 += f * r0
        if dim > 1:
            t01 += f * r1
            g = w * s[PHI + ROW + k]
            p1 += g
            t10 += g * r0
            t11 += g * r1
        if dim > 2:
            t02 += f * r2
            t12 += g * r2
            h = w * s[PHI + 2 * ROW + k]
            p2 += h
            t20 += h * r0
            t21 += h * r1
            t22 += h * r2
    return (p0, p1, p2), (t00, t01, t02, t10, t11, t12, t20, t21, t22)


@njit(**options)
def weights(axes, s, n, x, b, phi):
    """Fill the rows R, D and W for a particle at x with barycentric coordinates b.

    Returns the mean offset m, the matrix Q (row-major, 3 x 3) and phi_bar of the module's formulas.
    """
    m0, m1, m2, m3, c00, c01, c02, c11, c12, c22 = moments(axes, s, n, x, b)
    i0 = 1.0 / m0
    m1 *= i0
    m2 *= i0
    m3 *= i0
    k00, k01, k02, k11, k12, k22 = inverse_symmetric(
        len(axes),
        c00 - m0 * m1 * m1,
        c01 - m0 * m1 * m2,
        c02 - m0 * m1 * m3,
        c11 - m0 * m2 * m2,
        c12 - m0 * m2 * m3,
        c22 - m0 * m3 * m3,
    )
    b0 = k00 * m1 + k01 * m2 + k02 * m3
    b1 = k01 * m1 + k11 * m2 + k12 * m3
    b2 = k02 * m1 + k12 * m2 + k22 * m3
    a0 = i0 + m1 * b0 + m2 * b1 + m3 * b2
    m = (m1, m2, m3)
    if phi is None:
        fill_weights(axes, s, n, a0, b0, b1, b2)
        return m, (k00, k01, k02, k01, k11, k12, k02, k12, k22), (0.0, 0.0, 0.0)
    phi_bar, (t00, t01, t02, t10, t11, t12, t20, t21, t22) = fill_weights_and_phi(axes, s, n, a0, b0, b1, b2)
    t00 += 1.0
    t11 += 1.0
    t22 += 1.0
    q = (
        t00 * k00 + t01 * k01 + t02 * k02,
        t00 * k01 + t01 * k11 + t02 * k12,
        t00 * k02 + t01 * k12 + t02 * k22,
        t10 * k00 + t11 * k01 + t12 * k02,
        t10 * k01 + t11 * k11 + t12 * k12,
        t10 * k02 + t11 * k12 + t12 * k22,
        t20 * k00 + t21 * k01 + t22 * k02,
        t20 * k01 + t21 * k11 + t22 * k12,
        t20 * k02 + t21 * k12 + t22 * k22,
    )
    return m, q, phi_bar


@njit(**options)
def barycentric(axes, b, x, cell, cells, points, inverse):
    """Barycentric coordinates of x in `cell`, written to b."""
    origin = cells[cell, 0]
    b[0] = 1.0
    for q in range(len(axes)):
        t = 0.0
        for a in range(len(axes)):
            t += inverse[cell, q, a] * (x[a] - points[origin, a])
        b[q + 1] = t
        b[0] -= t
