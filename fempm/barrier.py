"""Compiled loops of `contact`: closest points on facets, barrier and friction forces, slip."""

import numpy as np
from numba import njit

LEAST = 0.05  # of d_hat: at smaller distances force and stiffness grow no more
GUARD = 0.1  # of d_hat: nearer than that, particles are held back through the vertices too, see `contact`
FLOOR = 0.02  # of d_hat: nearest to a surface that they may come
WATCH = 2.0  # of d_hat: particles nearer than that limit the time step
STIFFNESS = 4.0  # kappa d_hat / A over the modulus of the body
STICK = 0.5  # of kappa: stiffness 2 mu f_n / eps of friction that holds, which sets eps
SLIP = 0.2  # of d_hat: eps is at most this, a twentieth of the mesh size

compiled = {"cache": True, "nogil": True, "error_model": "numpy"}


@njit(**compiled)
def closest_weights(axes, x, corners, f, w):
    """Weights w (d,) at the corners of facet f of its point closest to x."""
    d = len(axes)
    w[0] = 1.0
    if d == 2:
        t = square = 0.0
        for a in range(d):
            e = corners[f, 1, a] - corners[f, 0, a]
            t += e * (x[a] - corners[f, 0, a])
            square += e * e
        w[1] = min(max(t / square, 0.0), 1.0)
        w[0] = 1.0 - w[1]
    if d == 3:
        closest_in_triangle(x, corners, f, w)


@njit(**compiled)
def closest_in_triangle(x, corners, f, w):
    """Ericson, Real-Time Collision Detection (2005), section 5.1.5."""
    d1 = d2 = d3 = d4 = d5 = d6 = 0.0
    for a in range(3):
        ab = corners[f, 1, a] - corners[f, 0, a]
        ac = corners[f, 2, a] - corners[f, 0, a]
        d1 += ab * (x[a] - corners[f, 0, a])
        d2 += ac * (x[a] - corners[f, 0, a])
        d3 += ab * (x[a] - corners[f, 1, a])
        d4 += ac * (x[a] - corners[f, 1, a])
        d5 += ab * (x[a] - corners[f, 2, a])
        d6 += ac * (x[a] - corners[f, 2, a])
    va, vb, vc = d3 * d6 - d5 * d4, d5 * d2 - d1 * d6, d1 * d4 - d3 * d2
    v = u = 0.0
    if d1 <= 0 and d2 <= 0:
        pass
    elif d3 >= 0 and d4 <= d3:
        v = 1.0
    elif d6 >= 0 and d5 <= d6:
        u = 1.0
    elif vc <= 0 and d1 >= 0 and d3 <= 0:
        v = d1 / (d1 - d3)
    elif vb <= 0 and d2 >= 0 and d6 <= 0:
        u = d2 / (d2 - d6)
    elif va <= 0 and d4 - d3 >= 0 and d5 - d6 >= 0:
        u = (d4 - d3) / ((d4 - d3) + (d5 - d6))
        v = 1.0 - u
    else:
        v = vb / (va + vb + vc)
        u = vc / (va + vb + vc)
    w[0], w[1], w[2] = 1.0 - v - u, v, u


@njit(**compiled)
def offset_from_facet(axes, x, corners, f, w, offset):
    """Write x less its closest point on facet f; returns the square of its length."""
    closest_weights(axes, x, corners, f, w)
    square = 0.0
    for a in range(len(axes)):
        offset[a] = x[a]
        for q in range(len(axes)):
            offset[a] -= w[q] * corners[f, q, a]
        square += offset[a] ** 2
    return square


@njit(**compiled)
def wall_contacts(
    axes,
    active,
    num_active,
    start,
    order,
    position,
    cell_start,
    cell_facet,
    facet_surface,
    corners,
    inward,
    reach,
    particle,
    surface,
    distance,
    normal,
    begin,
):
    """List the contacts of particles with facets; returns their number, more than there is room for if so."""
    d = len(axes)
    x, w, offset = np.empty(3), np.empty(3), np.empty(3)
    n = 0
    for i in range(num_active):
        c = active[i]
        if cell_start[c] == cell_start[c + 1]:
            continue
        for j in range(start[i], start[i + 1]):
            p = order[j]
            for a in range(d):
                x[a] = position[p, a]
            k = cell_start[c]
            while k < cell_start[c + 1]:
                s = facet_surface[cell_facet[k]]
                least, nearest = np.inf, -1
                while k < cell_start[c + 1] and facet_surface[cell_facet[k]] == s:
                    f = cell_facet[k]
                    square = offset_from_facet(axes, x, corners, f, w, offset)
                    if square < least:
                        least, nearest = square, f
                        if n < len(particle):
                            for a in range(d):
                                normal[n, a] = offset[a]
                    k += 1
                if least >= (WATCH * reach[s]) ** 2:
                    continue
                if n < len(particle):
                    particle[n], surface[n], distance[n] = p, s, np.sqrt(least)
                    for a in range(d):
                        begin[n, a] = x[a]
                        # on the surface itself there is no direction away from it but the facet's normal
                        away = distance[n] > 1e-6 * reach[s]
                        normal[n, a] = normal[n, a] / distance[n] if away else inward[nearest, a]
                n += 1
    return n


@njit(**compiled)
def stiffness(gap, reach, kappa):
    """Second derivative of the barrier, zero beyond its reach."""
    r = gap / reach
    return -kappa * (2.0 * np.log(r) - 1.0 / r + 1.0 + (r - 1.0) * (2.0 / r + 1.0 / r**2)) if r < 1 else 0.0


@njit(**compiled)
def approach_rate(approach, gap, reach, kappa):
    """Rate at which a particle closes half its gap, or finds a barrier of stiffness rate^2 where it gets to.

    `kappa` is that of the barrier over the mass. It depends on this particle alone, so that time steps
    are the same on any number of ranks.
    """
    if not approach > 0:
        return 0.0
    low = 2.0 * approach / gap
    high = np.sqrt(stiffness(max(0.5 * gap, LEAST * reach), reach, kappa))
    if high <= low:
        return low
    for _ in range(10):
        middle = np.sqrt(low * high)
        if stiffness(max(gap - approach / middle, LEAST * reach), reach, kappa) > middle**2:
            low = middle
        else:
            high = middle
    return high


@njit(**compiled)
def add_friction(p, i, largest, eps, normal, slip, force):
    """Add the friction of contact i, `largest` where it slides, to the force on particle p."""
    d = normal.shape[1]
    square, along = 0.0, 0.0
    for a in range(d):
        square += slip[p, a] ** 2
        along += slip[p, a] * normal[i, a]
    u = np.sqrt(max(square - along**2, 0.0))
    if u > 0 and eps > 0:
        share = (2.0 - u / eps) / eps if u < eps else 1.0 / u
        for a in range(d):
            force[p, a] -= largest * share * (slip[p, a] - along * normal[i, a])


@njit(**compiled)
def contact_forces(
    num,
    particle,
    surface,
    distance,
    normal,
    reach,
    friction,
    stops,
    modulus,
    velocity,
    motion,
    mass,
    volume,
    slip,
    slip_limit,
    force,
):
    """Write the forces of all contacts to `force` (n, d), and eps; returns the rate to resolve (1 / s).

    The rate is the largest of sqrt((B'' + friction's stiffness) / m), B'' now and after the step, and
    2 v_n / d: the time step is below half of the stability limit of the springs, and nobody comes nearer
    by more than half its distance, or half of GUARD d_hat. v_n is the velocity of the particle or of its
    last step, which differ under FLIP.
    """
    d = normal.shape[1]
    force[:] = 0.0
    rate = 0.0
    for i in range(num):
        p, s = particle[i], surface[i]
        body = 0
        while stops[body] <= p:
            body += 1
        gap = max(distance[i], LEAST * reach[s])
        approach, moved = 0.0, 0.0
        for a in range(d):
            approach -= velocity[p, a] * normal[i, a]
            moved -= motion[p, a] * normal[i, a]
        kappa = modulus[body] * volume[p] ** (1.0 - 1.0 / d) / reach[s]
        rate = max(
            rate, approach_rate(max(approach, moved), max(gap, GUARD * reach[s]), reach[s], kappa / mass[p])
        )
        slip_limit[i] = 0.0
        if gap >= reach[s]:
            continue
        r = gap / reach[s]
        f = kappa * (gap - reach[s]) * (2.0 * np.log(r) - 1.0 / r + 1.0)
        spring = stiffness(gap, reach[s], kappa)
        for a in range(d):
            force[p, a] += f * normal[i, a]
        if slip is not None and friction[s] > 0:
            eps = min(2.0 * friction[s] * f / (STICK * kappa), SLIP * reach[s])
            slip_limit[i] = eps
            spring += 2.0 * friction[s] * f / eps
            add_friction(p, i, friction[s] * f, eps, normal, slip, force)
        rate = max(rate, np.sqrt(spring / mass[p]))
    return rate


@njit(**compiled)
def motions(num, particle, start, position, dt, motion):
    """Velocities at which particles near a surface have moved."""
    for i in range(num):
        p = particle[i]
        for a in range(position.shape[1]):
            motion[p, a] = (position[p, a] - start[i, a]) / dt


@njit(**compiled)
def slips(num, particle, normal, start, slip_limit, position, force, slip, work):
    """Add the tangential motion of particles in contact to their slip, and what friction takes to `work`."""
    d = normal.shape[1]
    i = 0
    while i < num:
        p = particle[i]
        first, eps = i, 0.0
        while i < num and particle[i] == p:
            eps = max(eps, slip_limit[i])
            i += 1
        square = 0.0
        for a in range(d):
            tangential, pull = position[p, a] - start[first, a], force[p, a]
            for k in range(first, i):
                if slip_limit[k] > 0 or eps == 0.0:
                    along, pressed = 0.0, 0.0
                    for b in range(d):
                        along += (position[p, b] - start[first, b]) * normal[k, b]
                        pressed += force[p, b] * normal[k, b]
                    tangential -= along * normal[k, a]
                    pull -= pressed * normal[k, a]
            # a particle about to touch brings the direction of its last step with it
            slip[p, a] = tangential if eps == 0.0 else slip[p, a] + tangential
            square += slip[p, a] ** 2
            if eps > 0:
                work[p] -= pull * (position[p, a] - start[first, a])
        if square > eps**2 and eps > 0:
            for a in range(d):
                slip[p, a] *= eps / np.sqrt(square)
