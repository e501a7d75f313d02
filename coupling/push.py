"""Kernels of what passes between gas and solid at the nodes that both reach: forces, velocities, volume."""

import numpy as np
from numba import njit

from .advection import options


@njit(**options)
def add_push(size, nodes, share, inverse, place, walls, dt, force, out):
    """Add to `out` (n, d) what a force (n, d), of which the solid feels a share, does to it at some nodes.

    `place` (n,) is the number of a node's projection in `walls`, -1 where it is free.
    """
    for i in nodes:
        for a in range(len(size)):
            push = force[i, a]
            if place[i] >= 0:
                push = 0.0
                for b in range(len(size)):
                    push += walls[place[i], a, b] * force[i, b]
            out[i, a] += dt * inverse[i] * share[i] * push


@njit(**options)
def mix(size, nodes, theta, alpha, gas, solid, out):
    """Make `out` (n, d), the velocity of the gas, that of both phases at some nodes."""
    for i in nodes:
        for a in range(len(size)):
            out[i, a] = theta[i] * gas[i, a] + alpha[i] * solid[i, a]


@njit(**options)
def mix_mobility(nodes, theta, alpha, solid, out):
    """The same of 1 / mass: `out` (n,) is that of the gas in the whole cell, `solid` (n,) the solid's."""
    for i in nodes:
        out[i] = max(theta[i] * out[i] + alpha[i] ** 2 * solid[i], 1e-300)


@njit(**options)
def find_acceleration(size, nodes, start, now, width, dt, out):
    """Make `out` (n, d) (now - start) / dt at some nodes; returns the largest rate at which they cross cells.

    That is 1 / t with v t + a t^2 = width, for the velocity v = `now` and the acceleration a.
    """
    rate = 0.0
    for i in nodes:
        v = a = 0.0
        for k in range(len(size)):
            out[i, k] = (now[i, k] - start[i, k]) / dt
            v += now[i, k] ** 2
            a += out[i, k] ** 2
        rate = max(rate, 0.5 * (np.sqrt(v) + np.sqrt(v + 4.0 * np.sqrt(a) * width[i])) / width[i])
    return rate


@njit(**options)
def add_force(size, vertices, acceleration, grid):
    """Add to the sums (nv, 1 + 2 d) of mass, momentum and force at some vertices mass times (nv, d)."""
    d = len(size)
    for i in vertices:
        for a in range(d):
            grid[i, 1 + d + a] += grid[i, 0] * acceleration[i, a]


@njit(**options)
def add_expansion(shape, cells, nodes, dofs, coefficients, share, old, new, out):
    """Add to `out` (nq,) int chi div(share (new - old)) over some cells; share (n,), velocities (n, d)."""
    per_cell, corners, size = shape
    for c in cells:
        for q in range(len(per_cell)):
            total = 0.0
            for b in range(len(corners)):
                i, own = nodes[c, b], 0.0
                for a in range(len(size)):
                    own += coefficients[c, q, b, a] * (new[i, a] - old[i, a])
                total += share[i] * own
            out[dofs[c, q]] += total


@njit(**options)
def clear(rows, out):
    """Make some rows of `out` (n, k) zero."""
    for i in rows:
        for k in range(out.shape[1]):
            out[i, k] = 0.0
