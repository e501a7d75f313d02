"""The stable time step of a simulation in its present state."""

import numpy as np
from numba import njit

from .materials import extremes
from .mesh import mean_edge_length


def stable_step(simulation):
    """Time step of `Simulation.stable_step`. Collective."""
    s, p = simulation, simulation.particles
    rate, sign = 0.0, np.array([1, -1])
    bounds = np.array([extremes(p.deformation_gradient[part]) for part in p.ranges])
    bounds = sign * s.ranks.max(sign * bounds)
    for body, part, (stretch, jacobian) in zip(s.bodies, p.ranges, bounds, strict=True):
        c = body.material.wave_speed(stretch, jacobian)
        rate = max(rate, signal_rate(p.velocity[part], p.cell[part], c, s.cell_size))
    return s.ranks.min(min(s.cfl / rate if rate else np.inf, 1 / max(s.contact.rate, 1e-300)))


def cell_sizes(mesh):
    """(nc,) size that the time step is to resolve: mean edge length, in flat cells three heights."""
    size = mean_edge_length(mesh.points, mesh.adjacency_start, mesh.adjacency)
    slope = np.concatenate([mesh.inverse, -mesh.inverse.sum(axis=1, keepdims=True)], axis=1)
    height = 1 / np.linalg.norm(slope, axis=2).max(axis=1)
    return np.minimum(size[mesh.cells].min(axis=1), 3 * height)


@njit(cache=True, nogil=True, error_model="numpy")
def signal_rate(velocity, cell, wave_speed, cell_size):
    """Largest (c + |v|) / h over the particles."""
    rate = 0.0
    for p in range(len(velocity)):
        square = 0.0
        for a in range(velocity.shape[1]):
            square += velocity[p, a] ** 2
        rate = max(rate, (wave_speed + np.sqrt(square)) / cell_size[cell[p]])
    return rate
