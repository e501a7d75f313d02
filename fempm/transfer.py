"""Particle-to-grid and grid-to-particle transfers (thesis Algorithm 1, lines 2-5 and 7-8).

Both walk over the cells that hold particles: the ring of a cell is gathered once, every particle runs
loops along it (see `weights`), sums are kept per cell and scattered once.
"""

import numpy as np
from numba import njit

from .weights import (
    DU,
    PHI,
    ROW,
    SIZE,
    D,
    R,
    U,
    W,
    barycentric,
    gather_ring,
    inverse_inertia,
    options,
    weights,
)


@njit(**options)
def particle_to_grid(
    axes,
    first,
    last,
    active,
    start,
    order,
    position,
    velocity,
    affine,
    mass,
    volume,
    stress,
    force,
    rings,
    phi,
    grid,
):
    """Add mass, momentum and force of the particles in active cells first..last-1 to the vertices.

    Lines 2-5 of Algorithm 1: m_i = sum w m, p_i = sum w m (v + B D^-1 r_i) (B only with APIC, eq. 2.35),
    f_i = -sum V tau g_hat + sum w f. Optional arrays (`affine` B, `force` f, `phi`) are None where
    the scene does not need them: their branches are then not even compiled.

    Parameters
    ----------
    active, start, order : active cells, and their ranges start[i]:start[i + 1] of particles in `order`
    volume, stress : initial volume V0 and Kirchhoff stress, so that V0 tau = V sigma
    grid : (nv, 1 + 2 d) mass, momentum and force, added to
    """
    dim = len(axes)
    s = np.empty(SIZE)
    mass_sum = np.empty(ROW)  # sums of one cell
    momentum_sum = np.empty((3, ROW))
    force_sum = np.empty((3, ROW))
    b = np.empty(4)
    x = np.empty(3)
    for i in range(first, last):
        cell = active[i]
        n = gather_ring(axes, s, cell, rings, phi)
        mass_sum[:n] = 0.0
        momentum_sum[:, :n] = 0.0
        force_sum[:, :n] = 0.0
        for j in range(start[i], start[i + 1]):
            p = order[j]
            for a in range(dim):  # a copy, as a view position[p] would count references
                x[a] = position[p, a]
            barycentric(axes, b, x, cell, rings.cells, rings.points, rings.inverse)
            m, q, phi_bar = weights(axes, s, n, x, b, phi)
            i00 = i01 = i02 = i11 = i12 = i22 = 0.0
            if affine is not None:
                i00, i01, i02, i11, i12, i22 = inverse_inertia(axes, s, n)
            mp = mass[p]
            for k in range(n):
                mass_sum[k] += mp * s[W + k]
            for a in range(dim):
                v = mp * velocity[p, a]
                t0 = -volume[p] * stress[p, a, 0]
                t1 = -volume[p] * stress[p, a, 1] if dim > 1 else 0.0
                t2 = -volume[p] * stress[p, a, 2] if dim > 2 else 0.0
                g0 = t0 * q[0] + t1 * q[3] + t2 * q[6]
                g1 = t0 * q[1] + t1 * q[4] + t2 * q[7]
                g2 = t0 * q[2] + t1 * q[5] + t2 * q[8]
                gm = g0 * m[0] + g1 * m[1] + g2 * m[2]
                h = t0 * phi_bar[0] + t1 * phi_bar[1] + t2 * phi_bar[2]
                if force is not None:
                    h += force[p, a]
                c0 = c1 = c2 = 0.0
                if affine is not None:
                    b0 = mp * affine[p, a, 0]
                    b1 = mp * affine[p, a, 1] if dim > 1 else 0.0
                    b2 = mp * affine[p, a, 2] if dim > 2 else 0.0
                    c0 = b0 * i00 + b1 * i01 + b2 * i02
                    c1 = b0 * i01 + b1 * i11 + b2 * i12
                    c2 = b0 * i02 + b1 * i12 + b2 * i22
                for k in range(n):
                    r0 = s[R + k]
                    u = v
                    f = g0 * r0 - gm
                    e = h
                    if affine is not None:
                        u += c0 * r0
                    if phi is not None:
                        e -= t0 * s[PHI + k]
                    if dim > 1:
                        r1 = s[R + ROW + k]
                        f += g1 * r1
                        if affine is not None:
                            u += c1 * r1
                        if phi is not None:
                            e -= t1 * s[PHI + ROW + k]
                    if dim > 2:
                        r2 = s[R + 2 * ROW + k]
                        f += g2 * r2
                        if affine is not None:
                            u += c2 * r2
                        if phi is not None:
                            e -= t2 * s[PHI + 2 * ROW + k]
                    momentum_sum[a, k] += s[W + k] * u
                    force_sum[a, k] += s[D + k] * f + s[W + k] * e
        base = rings.start[cell]
        for k in range(rings.start[cell + 1] - base):
            vertex = rings.vertex[base + k]
            grid[vertex, 0] += mass_sum[k]
            for a in range(dim):
                grid[vertex, 1 + a] += momentum_sum[a, k]
                grid[vertex, 1 + dim + a] += force_sum[a, k]


@njit(**options)
def grid_to_particle(
    axes,
    first,
    last,
    active,
    start,
    order,
    position,
    velocity,
    affine,
    deformation_gradient,
    rings,
    phi,
    grid_velocity,
    grid_increment,
    flip,
    dt,
):
    """Update the particles in active cells first..last-1 from the vertices.

    Lines 7-8 of Algorithm 1: x += dt sum w v, F += dt (sum v (x) g_hat) F, and
    v = flip (v + sum w dv) + (1 - flip) sum w v, where `grid_increment` dv is None for PIC and APIC
    (flip = 0); with APIC, B = sum w v (x) r (eq. 2.36).
    """
    dim = len(axes)
    s = np.empty(SIZE)
    b = np.empty(4)
    x = np.empty(3)
    gradient = np.empty((3, 3))
    updated = np.empty((3, 3))
    for i in range(first, last):
        cell = active[i]
        n = gather_ring(axes, s, cell, rings, phi)
        base = rings.start[cell]
        for k in range(rings.start[cell + 1] - base):
            vertex = rings.vertex[base + k]
            for a in range(dim):
                s[U + a * ROW + k] = grid_velocity[vertex, a]
                if grid_increment is not None:
                    s[DU + a * ROW + k] = grid_increment[vertex, a]
        for j in range(start[i], start[i + 1]):
            p = order[j]
            for a in range(dim):  # a copy, as a view position[p] would count references
                x[a] = position[p, a]
            barycentric(axes, b, x, cell, rings.cells, rings.points, rings.inverse)
            m, q, phi_bar = weights(axes, s, n, x, b, phi)
            for a in range(dim):
                v = du = d0 = d1 = d2 = f0 = f1 = f2 = c0 = c1 = c2 = 0.0
                for k in range(n):
                    u = s[U + a * ROW + k]
                    r0 = s[R + k]
                    wu = s[W + k] * u
                    d = s[D + k] * u
                    v += wu
                    du += d
                    d0 += d * r0
                    if phi is not None:
                        f0 += wu * s[PHI + k]
                    if affine is not None:
                        c0 += wu * r0
                    if dim > 1:
                        r1 = s[R + ROW + k]
                        d1 += d * r1
                        if phi is not None:
                            f1 += wu * s[PHI + ROW + k]
                        if affine is not None:
                            c1 += wu * r1
                    if dim > 2:
                        r2 = s[R + 2 * ROW + k]
                        d2 += d * r2
                        if phi is not None:
                            f2 += wu * s[PHI + 2 * ROW + k]
                        if affine is not None:
                            c2 += wu * r2
                d0 -= du * m[0]
                d1 -= du * m[1]
                d2 -= du * m[2]
                gradient[a, 0] = q[0] * d0 + q[1] * d1 + q[2] * d2 + v * phi_bar[0] - f0
                gradient[a, 1] = q[3] * d0 + q[4] * d1 + q[5] * d2 + v * phi_bar[1] - f1
                gradient[a, 2] = q[6] * d0 + q[7] * d1 + q[8] * d2 + v * phi_bar[2] - f2
                x[a] += dt * v
                if grid_increment is None:
                    velocity[p, a] = v
                else:
                    dv = 0.0
                    for k in range(n):
                        dv += s[W + k] * s[DU + a * ROW + k]
                    velocity[p, a] = flip * (velocity[p, a] + dv) + (1.0 - flip) * v
                if affine is not None:
                    affine[p, a, 0] = c0
                    if dim > 1:
                        affine[p, a, 1] = c1
                    if dim > 2:
                        affine[p, a, 2] = c2
            for a in range(dim):
                position[p, a] = x[a]
                for c in range(dim):
                    t = deformation_gradient[p, a, c]
                    for e in range(dim):
                        t += dt * gradient[a, e] * deformation_gradient[p, e, c]
                    updated[a, c] = t
            for a in range(dim):
                for c in range(dim):
                    deformation_gradient[p, a, c] = updated[a, c]
