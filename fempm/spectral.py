"""Principal logarithmic strains of deformation gradients, and functions of them, in compiled code.

For F (d, d) the logarithmic (Hencky) strain is ln(F F^T) / 2 = sum e_i n_i n_i^T. It is taken from the
deviator of F F^T and from det F, each formed without cancellation near F = I: the error of the strain is
a few 1e-16 of its own size for any small strain, repeated principal values included, and grows with
the ratio of the principal stretches squared for large ones (in 3D; not in 1D and 2D).

All functions take whole arrays and a particle's index, as a view f[p] would count references.
"""

import numpy as np
from numba import njit

kernel_options = {"cache": True, "nogil": True, "error_model": "numpy"}
inlined = {**kernel_options, "forceinline": True}  # a call that passes arrays costs 20 ns


@njit(**inlined)
def determinant(f, p):
    """det f[p] of (d, d) matrices, d <= 3."""
    if f.shape[1] == 1:
        return f[p, 0, 0]
    if f.shape[1] == 2:
        return f[p, 0, 0] * f[p, 1, 1] - f[p, 0, 1] * f[p, 1, 0]
    return (
        f[p, 0, 0] * (f[p, 1, 1] * f[p, 2, 2] - f[p, 1, 2] * f[p, 2, 1])
        - f[p, 0, 1] * (f[p, 1, 0] * f[p, 2, 2] - f[p, 1, 2] * f[p, 2, 0])
        + f[p, 0, 2] * (f[p, 1, 0] * f[p, 2, 1] - f[p, 1, 1] * f[p, 2, 0])
    )


@njit(**kernel_options)
def determinants(f, out):
    """det f (n, d, d), d <= 3, into `out` (n,)."""
    for p in range(len(f)):
        out[p] = determinant(f, p)
    return out


@njit(**inlined)
def log_determinant(f, p):
    """ln det f[p]; nan where det f[p] is not in (0, inf)."""
    j = determinant(f, p)
    if not 0 < j < np.inf:
        return np.nan
    if not 0.5 < j < 2:
        return np.log(j)
    x = f[p, 0, 0] - 1  # det(I + H) - 1 by the invariants of H, which small H leaves small
    if f.shape[1] == 1:
        return np.log1p(x)
    y = f[p, 1, 1] - 1
    if f.shape[1] == 2:
        return np.log1p(x + y + (x * y - f[p, 0, 1] * f[p, 1, 0]))
    z = f[p, 2, 2] - 1
    xy = x * y - f[p, 0, 1] * f[p, 1, 0]
    yz = y * z - f[p, 1, 2] * f[p, 2, 1]
    zx = z * x - f[p, 2, 0] * f[p, 0, 2]
    third = (
        x * yz
        - f[p, 0, 1] * (f[p, 1, 0] * z - f[p, 1, 2] * f[p, 2, 0])
        + f[p, 0, 2] * (f[p, 1, 0] * f[p, 2, 1] - y * f[p, 2, 0])
    )
    return np.log1p(x + y + z + (xy + yz + zx + third))


@njit(**inlined)
def principal_strains(f, p, lateral, logs, axes):
    """Three principal logarithmic strains `logs` (3,) and their directions, columns of `axes` (3, 3).

    Those of directions without coordinate are `lateral`. Returns their sum, ln det F in three
    dimensions; nan, with nothing written, where det f[p] is not in (0, inf).
    """
    d = f.shape[1]
    volume = log_determinant(f, p)
    if np.isnan(volume):
        return volume
    if d == 1:
        logs[0], logs[1], logs[2] = volume, lateral, lateral
        axes[0, 0] = 1.0
        return volume + 2 * lateral
    if d == 2:
        _principal_2d(f, p, volume, logs, axes)
        logs[2] = lateral
        return volume + lateral
    _principal_3d(f, p, volume, logs, axes)
    return volume


@njit(**inlined)
def half_angle(half, off):
    """r, cos t, sin t such that [[half, off], [off, -half]] has the vector (cos t, sin t) to +r."""
    r = np.sqrt(half * half + off * off)
    if r == 0:
        return r, 1.0, 0.0
    if half >= 0:  # the larger of the two by a square root, the other by division: no cancellation
        cosine = np.sqrt(0.5 * (1 + half / r))
        return r, cosine, off / (2 * r * cosine)
    sine = np.sqrt(0.5 * (1 - half / r))
    return r, off / (2 * r * sine), sine


@njit(**inlined)
def _principal_2d(f, p, volume, logs, axes):
    """sinh(e_0 - e_1) = r / det F, with the principal values m +- r of F F^T."""
    f00, f01, f10, f11 = f[p, 0, 0], f[p, 0, 1], f[p, 1, 0], f[p, 1, 1]
    half = 0.5 * ((f00 - f11) * (f00 + f11) + (f01 - f10) * (f01 + f10))
    r, cosine, sine = half_angle(half, f00 * f10 + f01 * f11)
    ratio = r / (f00 * f11 - f01 * f10)
    difference = np.log1p(ratio + ratio * ratio / (1 + np.sqrt(1 + ratio * ratio)))
    logs[0], logs[1] = 0.5 * (volume + difference), 0.5 * (volume - difference)
    axes[0, 0], axes[1, 0] = cosine, sine
    axes[0, 1], axes[1, 1] = -sine, cosine


@njit(**inlined)
def _principal_3d(f, p, volume, logs, axes):
    """The principal value farthest from the others in closed form, then those across its direction.

    As Scherzinger & Dohrmann, Comput. Methods Appl. Mech. Engrg. 197 (2008): the first direction is
    well conditioned, so that nothing is lost when the other two principal values are close.
    """
    mean, s00, s11, s22, s01, s02, s12 = _deviator(f, p)
    j2 = 0.5 * (s00 * s00 + s11 * s11 + s22 * s22) + s01 * s01 + s02 * s02 + s12 * s12
    if j2 < 1e-200:  # a strain below 1e-100: j2 to the third power would underflow
        for a in range(3):
            logs[a] = volume / 3
            for b in range(3):
                axes[a, b] = 1.0 if a == b else 0.0
        return
    j3 = s00 * (s11 * s22 - s12 * s12) - s01 * (s01 * s22 - s12 * s02) + s02 * (s01 * s12 - s11 * s02)
    scale = np.sqrt(j2 / 3)
    cosine = 0.5 * j3 / (scale * scale * scale)
    first = 2 * scale * np.cos(np.arccos(min(abs(cosine), 1.0)) / 3)
    if cosine < 0:
        first = -first
    x, y, z = null_vector(s00 - first, s11 - first, s22 - first, s01, s02, s12)
    ux, uy, uz = normal_to(x, y, z)
    vx, vy, vz = y * uz - z * uy, z * ux - x * uz, x * uy - y * ux
    wx, wy, wz = product(s00, s11, s22, s01, s02, s12, ux, uy, uz)
    uu, uv = ux * wx + uy * wy + uz * wz, vx * wx + vy * wy + vz * wz
    wx, wy, wz = product(s00, s11, s22, s01, s02, s12, vx, vy, vz)
    vv = vx * wx + vy * wy + vz * wz
    r, c, s = half_angle(0.5 * (uu - vv), uv)
    middle = 0.5 * (uu + vv)
    g0 = 0.5 * np.log1p(-2 * middle / mean)
    g1 = 0.5 * np.log1p((middle + r) / mean)
    g2 = 0.5 * np.log1p((middle - r) / mean)
    shift = (volume - (g0 + g1 + g2)) / 3
    logs[0], logs[1], logs[2] = g0 + shift, g1 + shift, g2 + shift
    axes[0, 0], axes[1, 0], axes[2, 0] = x, y, z
    axes[0, 1], axes[1, 1], axes[2, 1] = c * ux + s * vx, c * uy + s * vy, c * uz + s * vz
    axes[0, 2], axes[1, 2], axes[2, 2] = c * vx - s * ux, c * vy - s * uy, c * vz - s * uz


@njit(**inlined)
def _deviator(f, p):
    """Mean principal value of b = F F^T and its deviator, by differences that are exact near F = I."""
    f00, f01, f02 = f[p, 0, 0], f[p, 0, 1], f[p, 0, 2]
    f10, f11, f12 = f[p, 1, 0], f[p, 1, 1], f[p, 1, 2]
    f20, f21, f22 = f[p, 2, 0], f[p, 2, 1], f[p, 2, 2]
    b01 = (f00 - f11) * (f00 + f11) + (f01 - f10) * (f01 + f10) + (f02 - f12) * (f02 + f12)  # b_00 - b_11
    b12 = (f11 - f22) * (f11 + f22) + (f12 - f21) * (f12 + f21) + (f10 - f20) * (f10 + f20)
    s00, s22 = (2 * b01 + b12) / 3, -(b01 + 2 * b12) / 3
    mean = f00 * f00 + f01 * f01 + f02 * f02 - s00
    s01 = f00 * f10 + f01 * f11 + f02 * f12
    s02 = f00 * f20 + f01 * f21 + f02 * f22
    s12 = f10 * f20 + f11 * f21 + f12 * f22
    return mean, s00, -(s00 + s22), s22, s01, s02, s12


@njit(**inlined)
def product(a, b, c, ab, ac, bc, x, y, z):
    """Components of [[a, ab, ac], [ab, b, bc], [ac, bc, c]] (x, y, z)."""
    return a * x + ab * y + ac * z, ab * x + b * y + bc * z, ac * x + bc * y + c * z


@njit(**inlined)
def null_vector(a, b, c, ab, ac, bc):
    """Unit vector that the symmetric matrix [[a, ab, ac], [ab, b, bc], [ac, bc, c]] of rank 2 maps to 0.

    All columns of the adjugate are multiples of it; the one with the largest diagonal is taken.
    """
    aa, bb, cc = b * c - bc * bc, a * c - ac * ac, a * b - ab * ab
    x, y, z = aa, ac * bc - ab * c, ab * bc - ac * b
    if abs(bb) > abs(aa) and abs(bb) >= abs(cc):
        x, y, z = y, bb, ab * ac - bc * a
    elif abs(cc) > abs(aa):
        x, y, z = z, ab * ac - bc * a, cc
    factor = 1 / np.sqrt(x * x + y * y + z * z)
    return factor * x, factor * y, factor * z


@njit(**inlined)
def normal_to(x, y, z):
    """A unit vector normal to the unit vector (x, y, z)."""
    if abs(x) > abs(y):
        factor = 1 / np.sqrt(x * x + z * z)
        return -factor * z, 0.0, factor * x
    factor = 1 / np.sqrt(y * y + z * z)
    return 0.0, factor * z, -factor * y


@njit(**inlined)
def compose(axes, values, out, p):
    """out[p] = sum of values_i n_i n_i^T over the directions that have a coordinate."""
    d = out.shape[1]
    for a in range(d):
        for b in range(a + 1):
            t = 0.0
            for i in range(d):
                t += values[i] * axes[a, i] * axes[b, i]
            out[p, a, b] = t
            out[p, b, a] = t


@njit(**inlined)
def add_product(f, p, axes, values, scratch):
    """f[p] += (sum of values_i n_i n_i^T) f[p]; `scratch` (1, d, d) is overwritten."""
    d = f.shape[1]
    compose(axes, values, scratch, 0)
    for b in range(d):
        x = f[p, 0, b]
        y = f[p, 1, b] if d > 1 else 0.0
        z = f[p, 2, b] if d > 2 else 0.0
        for a in range(d):
            t = scratch[0, a, 0] * x
            if d > 1:
                t += scratch[0, a, 1] * y
            if d > 2:
                t += scratch[0, a, 2] * z
            f[p, a, b] += t
