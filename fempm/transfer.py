"""Particle-to-grid and grid-to-particle transfers (thesis Algorithm 1, lines 2-5 and 7-8).

Both walk over the cells that hold particles, which run along the ring of their cell four at a time (see
`weights` and `lanes`). P2G keeps sums of every ring vertex in four lanes, which are added up once per cell.
"""

from numba import njit

from .lane_memory import (
    add_totals,
    borrow,
    entry,
    gather,
    gather_row,
    load,
    occupied,
    scatter,
    scatter_row,
    scratch,
    store,
    take,
    zeros,
)
from .lanes import WIDTH, dot, formula, where, zero
from .weights import (
    ENTRY,
    FIRST,
    MAX_RING,
    TABLE_SIZE,
    D,
    R,
    W,
    full,
    inverse_symmetric,
    options,
    ring_of,
    weights,
)

SUMS_SIZE = MAX_RING * 7 * WIDTH


@njit(forceinline=True, **options)
def batch(order, j, end):
    """The particles j, j + 1, ... of `order`, the last of the cell in all lanes that are left over."""
    last = end - 1
    return (
        entry(order, j),
        entry(order, min(j + 1, last)),
        entry(order, min(j + 2, last)),
        entry(order, min(j + 3, last)),
    )


@formula
def momentum_of(mass, velocity, affine, inertia):
    """Mass and momentum of particles as functions m and p + c . r of the offset: m, p and c."""
    p = tuple(mass * v for v in velocity)
    if affine is None:
        return mass, p, None
    inverse = full(inverse_symmetric(inertia))
    return mass, p, tuple(tuple(mass * dot(row, column) for column in inverse) for row in affine)


@formula
def force_of(volume, stress, force, used, m, q, phi_bar, a0, b):
    """Force of particles as a function D (g . r + g0) - w t . phi: g, g0 and t."""
    t = tuple(tuple(-volume * s for s in row) for row in stress)
    g = [[dot(row, column) for column in zip(*q)] for row in t]
    g0 = [-dot(row, m) for row in g]
    h = [zero(a0)] * len(m) if phi_bar is None else [dot(row, phi_bar) for row in t]
    if force is not None:
        h = [h_a + used * f for h_a, f in zip(h, force)]
    # w h = D (a0 - b . r) h joins the first part
    g = tuple(tuple(g_ac - h_a * b_c for g_ac, b_c in zip(row, b)) for row, h_a in zip(g, h))
    return g, tuple(g_a + h_a * a0 for g_a, h_a in zip(g0, h)), t


@formula
def no_sums(x):
    """Mass, momentum and force of nothing."""
    return (zero(x[0]),) * (1 + 2 * len(x))


@formula
def add_vertex(sums, d, w, r, phi, momentum, force):
    """Mass, momentum and force of a vertex with the particles' shares added."""
    mass, p, c = momentum
    g, g0, t = force
    axes = range(len(r))
    u = [p[a] if c is None else p[a] + dot(c[a], r) for a in axes]
    f = [sums[1 + len(r) + a] + d * (g0[a] + dot(g[a], r)) for a in axes]
    if phi is not None:
        f = [f[a] - w * dot(t[a], phi) for a in axes]
    return (sums[0] + w * mass, *(sums[1 + a] + w * u[a] for a in axes), *f)


@formula
def times(x, y):
    """Product."""
    return x * y


@njit(**options)
def add_batch(axes, t, sums, ring, p, used, fields, rings, phi, grid, fresh, last):
    """Add four particles to the sums of their cell; the last four, and the sums, to the vertices."""
    position, velocity, affine, mass, volume, stress, force = fields
    x = gather(position, p, axes)
    m, q, phi_bar, a0, b, inertia = weights(axes, t, ring, x, rings, phi, affine)
    mass_p, volume_p = times(gather(mass, p, axes), used), times(gather(volume, p, axes), used)
    momentum_p = momentum_of(mass_p, gather(velocity, p, axes), gather(affine, p, axes), inertia)
    force_p = force_of(volume_p, gather(stress, p, axes), gather(force, p, axes), used, m, q, phi_bar, a0, b)
    first, n, _ = ring
    nothing = no_sums(x)
    for k in range(n):
        v = entry(rings.vertex, first + k)
        at, to = FIRST + k * ENTRY, k * len(nothing)
        d, w, r = load(t, at + D, used), load(t, at + W, used), load(t, at + R, x)
        phi_k = take(phi, v * len(axes), axes)
        before = nothing
        if not fresh:
            before = load(sums, to, nothing)
        added = add_vertex(before, d, w, r, phi_k, momentum_p, force_p)
        if last:
            add_totals(grid, v * len(nothing), added)
        else:
            store(sums, to, added)


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
    t, sums = scratch(TABLE_SIZE), scratch(SUMS_SIZE)
    fields = borrow((position, velocity, affine, mass, volume, stress, force))
    rings, phi, grid = borrow((rings, phi, grid))
    for i in range(first, last):
        ring, end = ring_of(axes, active[i], rings), start[i + 1]
        for j in range(start[i], end, WIDTH):
            p, used = batch(order, j, end), occupied(end - j)
            add_batch(axes, t, sums, ring, p, used, fields, rings, phi, grid, j == start[i], j + WIDTH >= end)


@formula
def no_velocity(x, affine, phi, increment):
    """Sums of nothing, for `add_velocity`."""
    o = zero(x[0])
    v = (o,) * len(x)
    return (
        o,
        o,
        v,
        None if phi is None else v,
        None if affine is None else v,
        None if increment is None else o,
    )


@formula
def add_velocity(sums, d, w, r, u, phi, increment):
    """Sums of w u, D u, D u r, w u phi, w u r and w du over the ring, u a component of the velocity."""
    v, du, dur, up, ur, dv = sums
    wu, d = w * u, d * u
    return (
        v + wu,
        du + d,
        tuple(total + d * r_a for total, r_a in zip(dur, r)),
        None if phi is None else tuple(total + wu * p for total, p in zip(up, phi)),
        None if ur is None else tuple(total + wu * r_a for total, r_a in zip(ur, r)),
        None if increment is None else dv + w * increment,
    )


@formula
def close_velocity(sums, m, q, phi_bar):
    """w u, the row of its gradient, w u r and w du from those sums."""
    v, du, dur, up, ur, dv = sums
    offset = [total - du * m_a for total, m_a in zip(dur, m)]
    row = tuple(dot(q_row, offset) for q_row in q)
    if phi_bar is not None:
        row = tuple(g + v * mean - total for g, mean, total in zip(row, phi_bar, up))
    return v, row, ur, dv


@formula
def moved(x, dt, v):
    """x + dt v."""
    return x + dt * v


@formula
def new_velocity(old, v, dv, flip):
    """The velocity on the grid, blended with FLIP's where there is an increment."""
    if dv is None:
        return v
    return flip * (old + dv) + (1.0 - flip) * v


@formula
def deformed(f_row, dt, gradient, f):
    """A row of F + dt (grad v) F."""
    return tuple(o + dt * dot(gradient, column) for o, column in zip(f_row, zip(*f)))


@njit(**options)
def update_batch(axes, t, ring, p, fields, rings, phi, on_grid, flip, dt):
    """Update four particles of a cell."""
    position, velocity, affine, deformation_gradient = fields
    grid_velocity, increment = on_grid
    x = gather(position, p, axes)
    m, q, phi_bar, _, _, _ = weights(axes, t, ring, x, rings, phi, None)
    f = gather(deformation_gradient, p, axes)
    first, n, _ = ring
    for a in range(len(axes)):
        sums = no_velocity(x, affine, phi, increment)
        for k in range(n):
            v = entry(rings.vertex, first + k) * len(axes)
            at = FIRST + k * ENTRY
            d, w, r = load(t, at + D, x[0]), load(t, at + W, x[0]), load(t, at + R, x)
            phi_k = take(phi, v, axes)
            du = entry(increment, v + a)
            sums = add_velocity(sums, d, w, r, entry(grid_velocity, v + a), phi_k, du)
        v_a, row, ur, dv = close_velocity(sums, m, q, phi_bar)
        scatter_row(velocity, p, a, new_velocity(gather_row(velocity, p, a, axes), v_a, dv, flip), axes)
        scatter_row(position, p, a, moved(gather_row(position, p, a, axes), dt, v_a), axes)
        f_row = gather_row(deformation_gradient, p, a, axes)
        scatter_row(deformation_gradient, p, a, deformed(f_row, dt, row, f), axes)
        scatter_row(affine, p, a, ur, axes)


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
    t = scratch(TABLE_SIZE)
    fields = borrow((position, velocity, affine, deformation_gradient))
    rings, phi, on_grid = borrow((rings, phi, (grid_velocity, grid_increment)))
    for i in range(first, last):
        ring, end = ring_of(axes, active[i], rings), start[i + 1]
        for j in range(start[i], end, WIDTH):
            update_batch(axes, t, ring, batch(order, j, end), fields, rings, phi, on_grid, flip, dt)


@formula
def add_average(sums, w, weight, value):
    """w weight and w weight value, added."""
    return sums[0] + w * weight, sums[1] + w * (weight * value)


@formula
def add_product(sum, w, value):
    """w value, added."""
    return sum + w * value


@formula
def chosen(condition, x, y):
    """x where the condition is not zero, y elsewhere."""
    return where(condition, x, y)


@njit(**options)
def scatter_average(axes, first, last, active, start, order, position, weight, value, rings, grid):
    """Add sum w weight and sum w weight value of the particles in active cells to grid[:, 0] and [:, 1].

    Parameters
    ----------
    first, last, active, start, order : as for `particle_to_grid`
    weight, value : (n,) numbers per particle
    grid : (nv, 2 or more) added to
    """
    columns = grid.shape[1]
    t, sums = scratch(TABLE_SIZE), scratch(SUMS_SIZE)
    position, weight, value, rings, grid = borrow((position, weight, value, rings, grid))
    nothing = zeros((0, 1))
    for i in range(first, last):
        ring, end = ring_of(axes, active[i], rings), start[i + 1]
        first, n, _ = ring
        for k in range(n):
            store(sums, 2 * k, nothing)
        for j in range(start[i], end, WIDTH):
            p = batch(order, j, end)
            weights(axes, t, ring, gather(position, p, axes), rings, None, None)
            weight_p = times(gather(weight, p, axes), occupied(end - j))
            value_p = gather(value, p, axes)
            for k in range(n):
                w = load(t, FIRST + k * ENTRY + W, weight_p)
                store(sums, 2 * k, add_average(load(sums, 2 * k, nothing), w, weight_p, value_p))
        for k in range(n):
            vertex = entry(rings.vertex, first + k)
            add_totals(grid, vertex * columns, load(sums, 2 * k, nothing))


@njit(**options)
def gather_average(axes, first, last, active, start, order, position, weight, field, rings, out):
    """out = sum w field for the particles of active cells whose weight is not zero.

    Parameters
    ----------
    first, last, active, start, order : as for `particle_to_grid`
    weight, out : (n,) numbers per particle
    field : (nv,) numbers per vertex
    """
    t = scratch(TABLE_SIZE)
    position, weight, field, rings, out = borrow((position, weight, field, rings, out))
    for i in range(first, last):
        ring, end = ring_of(axes, active[i], rings), start[i + 1]
        first, n, _ = ring
        for j in range(start[i], end, WIDTH):
            p = batch(order, j, end)
            weights(axes, t, ring, gather(position, p, axes), rings, None, None)
            average = zeros((0,))[0]
            for k in range(n):
                w = load(t, FIRST + k * ENTRY + W, average)
                average = add_product(average, w, entry(field, entry(rings.vertex, first + k)))
            old, weight_p = gather(out, p, axes), gather(weight, p, axes)
            scatter(out, p, chosen(weight_p, average, old), axes)
