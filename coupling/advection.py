"""Advection along the edges of the dual mesh, without pressure (thesis equations 3.10-3.12).

Density, momentum and energy are carried by the velocity alone: the local Lax-Friedrichs flux of an edge
has the dissipation |u . n|. States at the middle of an edge come from limited slopes, the difference behind
each node from its gradient. Where neither end of an edge moves, nothing is computed.
"""

import numpy as np
from numba import njit

from .limiters import contact_share, slope

options = {"cache": True, "nogil": True, "error_model": "numpy", "fastmath": {"contract", "nsz", "arcp"}}


@njit(**options)
def primitive(U, W):
    """Fill W (n, d + 2) with density, velocity, internal energy per volume; returns the worst node.

    That is one where density or internal energy is least, or not a number.
    """
    worst, least, d = 0, np.inf, U.shape[1] - 2
    for i in range(len(U)):
        W[i, 0] = U[i, 0]
        inner = U[i, d + 1]
        for k in range(1, d + 1):
            W[i, k] = U[i, k] / U[i, 0]
            inner -= 0.5 * U[i, k] * W[i, k]
        W[i, d + 1] = inner
        lower = min(U[i, 0], inner)
        if not lower >= least:
            worst, least = i, lower
            if not lower > -np.inf:
                break
    return worst


@njit(**options)
def limited_sum(U, change, out):
    """Fill `out` with U + change, the change at a node halved until three quarters of density and of internal
    energy are not used up; returns at how many nodes."""
    cut, last = 0, U.shape[1] - 1
    for i in range(len(U)):
        kinetic = 0.0
        for k in range(1, last):
            kinetic += U[i, k] * U[i, k]
        inner = U[i, last] - 0.5 * kinetic / U[i, 0]
        share = 1.0
        for halving in range(60):
            kinetic = 0.0
            for k in range(last + 1):
                out[i, k] = U[i, k] + share * change[i, k]
                if 0 < k < last:
                    kinetic += out[i, k] * out[i, k]
            if out[i, 0] > 0.25 * U[i, 0] and out[i, last] - 0.5 * kinetic / out[i, 0] > 0.25 * inner:
                break
            share *= 0.5
            cut += halving == 0
    return cut


@njit(**options)
def active_edges(edges, W, threshold, active, needed):
    """List the edges with a moving end in `active`; mark their ends in `needed`; returns their number."""
    d = W.shape[1] - 2
    count = 0
    for i in range(len(needed)):
        needed[i] = 0
    for e in range(len(edges)):
        i, j = edges[e, 0], edges[e, 1]
        moves = False
        for k in range(1, d + 1):
            moves |= abs(W[i, k]) > threshold[i] or abs(W[j, k]) > threshold[j]
        if moves:
            active[count] = e
            count += 1
            needed[i] = needed[j] = 1
    return count


@njit(**options)
def gradients(size, edges, forward, backward, volumes, W, needed, out):
    """Gradients (n, d + 2, d) of W at the nodes marked: int phi_i grad W / m_i; `size` is (d,) ones."""
    for i in range(len(out)):
        if needed[i]:
            for k in range(len(size) + 2):
                for a in range(len(size)):
                    out[i, k, a] = 0.0
    for e in range(len(edges)):
        i, j = edges[e, 0], edges[e, 1]
        if needed[i] or needed[j]:
            for k in range(len(size) + 2):
                d = W[j, k] - W[i, k]
                if needed[i]:
                    for a in range(len(size)):
                        out[i, k, a] += forward[e, a] * d
                if needed[j]:
                    for a in range(len(size)):
                        out[j, k, a] -= backward[e, a] * d
    for i in range(len(out)):
        if needed[i]:
            for k in range(len(size) + 2):
                for a in range(len(size)):
                    out[i, k, a] /= volumes[i]


# with no thought of NaN, which `primitive` rules out, the compiler limits all slopes of an edge at once
@njit(**(options | {"fastmath": True}))
def add_fluxes(size, active, edges, vectors, forward, backward, W, gradient, limiter, openness, out):
    """Subtract from `out` (n, d + 2) the fluxes that leave each node through the active edges.

    `openness` (ne,) is the share of each dual face that is open, or None.
    """
    L, R = np.empty(len(size) + 2), np.empty(len(size) + 2)
    for index in range(len(active)):
        e = active[index]
        i, j = edges[e, 0], edges[e, 1]
        last = len(size) + 1
        sharp = 0.0
        if len(limiter) == 6:
            sharp = contact_share(W[i, 0], W[j, 0], W[i, last], W[j, last])
        for k in range(len(size) + 2):
            d = W[j, k] - W[i, k]
            a = b = -d
            for c in range(len(size)):
                a += 2.0 * gradient[i, k, c] * vectors[e, c]
                b += 2.0 * gradient[j, k, c] * vectors[e, c]
            scale = abs(W[i, k]) + abs(W[j, k])
            left, right = slope(limiter, a, d, scale), slope(limiter, b, d, scale)
            if k == 0 and sharp > 0.0:
                left += sharp * (slope((1, 1, 1, 1), a, d, scale) - left)
                right += sharp * (slope((1, 1, 1, 1), b, d, scale) - right)
            L[k], R[k] = W[i, k] + 0.5 * left, W[j, k] - 0.5 * right
        if len(limiter) == 5 and not (L[0] > 0.0 and R[0] > 0.0 and L[last] > 0.0 and R[last] > 0.0):
            for k in range(len(size) + 2):  # only WENO leaves the range of the nodes
                L[k], R[k] = W[i, k], W[j, k]
        flow = left = right = kinetic_left = kinetic_right = 0.0
        for c in range(len(size)):
            n = forward[e, c] - backward[e, c]
            flow += 0.5 * (W[i, 1 + c] + W[j, 1 + c]) * n
            left += L[1 + c] * n
            right += R[1 + c] * n
            kinetic_left += L[1 + c] * L[1 + c]
            kinetic_right += R[1 + c] * R[1 + c]
        if openness is not None:
            flow *= openness[e]
            left *= openness[e]
            right *= openness[e]
        speed = max(abs(left), abs(right))
        left, right = 0.5 * (flow + speed), 0.5 * (flow - speed)
        mass = left * L[0] + right * R[0]
        out[i, 0] -= mass
        out[j, 0] += mass
        for c in range(len(size)):
            momentum = left * L[0] * L[1 + c] + right * R[0] * R[1 + c]
            out[i, 1 + c] -= momentum
            out[j, 1 + c] += momentum
        energy = left * (L[last] + 0.5 * L[0] * kinetic_left) + right * (R[last] + 0.5 * R[0] * kinetic_right)
        out[i, last] -= energy
        out[j, last] += energy


@njit(**options)
def step_rates(size, edges, forward, backward, volumes, W, pressure, rate, slopes):
    """What limits the time step: sum |u . n| / 2 m_i in `rate`, grad p in `slopes` (n, d), in place."""
    rate[:] = 0.0
    slopes[:] = 0.0
    for e in range(len(edges)):
        i, j = edges[e, 0], edges[e, 1]
        flow, d = 0.0, pressure[j] - pressure[i]
        for c in range(len(size)):
            flow += 0.5 * (W[i, 1 + c] + W[j, 1 + c]) * (forward[e, c] - backward[e, c])
            slopes[i, c] += forward[e, c] * d
            slopes[j, c] -= backward[e, c] * d
        rate[i] += abs(flow)
        rate[j] += abs(flow)
    for i in range(len(rate)):
        rate[i] /= 2.0 * volumes[i]
        for c in range(len(size)):
            slopes[i, c] /= volumes[i]


@njit(**options)
def add_outflow(size, edges, forward, backward, velocity, values, openness, out):
    """Add to `out` (n,) what central fluxes of `values` (n,), or 1 for None, carry out of each node.

    `openness` (ne,) is the share of each dual face that is open, or None.
    """
    for e in range(len(edges)):
        i, j = edges[e, 0], edges[e, 1]
        flow = 0.0
        for c in range(len(size)):
            flow += 0.5 * (velocity[i, c] + velocity[j, c]) * (forward[e, c] - backward[e, c])
        if values is not None:
            flow *= 0.5 * (values[i] + values[j])
        if openness is not None:
            flow *= openness[e]
        out[i] += flow
        out[j] -= flow
