"""Boundary conditions on the vertices, parts of `Simulation.update_grid`: walls, mirrors, contact, one's own.

All functions take the running simulation.
"""

import numpy as np

from . import grid


def wall_motion(simulation, dt):
    """What moving walls add to mirror and wall vertices: velocities, and their change in a step."""
    d, shapes = simulation.mesh.dim, (len(simulation.layer.source), len(simulation.layer.vertices))
    if not simulation.layer.moving and simulation.steps:
        return simulation.motion
    drift, change = [[np.zeros((n, d)) for n in shapes] for _ in range(2)]
    for wall, *matrices in simulation.layer.moving:
        before, now = (np.asarray(wall.velocity_at(simulation.time + s), float) for s in (0.0, dt))
        if now.shape != (d,):
            raise ValueError(f"wall {wall.boundary!r}: velocity of shape {now.shape}, give ({d},)")
        for i, matrix in enumerate(matrices):
            drift[i] += matrix @ now
            change[i] += matrix @ (now - before)
    simulation.motion = drift, change
    return simulation.motion


def fold(simulation, drift):
    """Add what mirrors hold to their owners."""
    layer, unknowns = simulation.layer, len(simulation.mesh.points) + simulation.layer.num_free
    active = (simulation.stamp, simulation.steps)
    grid.fold_mirrors(
        simulation.grids[0], *active, unknowns, layer.source, layer.fold, drift, simulation.gravity
    )


def apply_walls(simulation, drift, change):
    """Velocities of wall vertices and mirrors."""
    layer, active = simulation.layer, (simulation.stamp, simulation.steps)
    grid.constrain(
        *active, layer.vertices, layer.project, drift[1], change[1], simulation.velocity, simulation.increment
    )
    fill_mirrors(simulation, drift, change)


def fill_mirrors(simulation, drift, change):
    """Velocities of mirrors."""
    layer, unknowns = simulation.layer, len(simulation.mesh.points) + simulation.layer.num_free
    mirrors = (unknowns, layer.source, layer.fold, drift[0], change[0])
    grid.fill_mirrors(simulation.stamp, simulation.steps, *mirrors, simulation.velocity, simulation.increment)


def impose(simulation, unknowns):
    """Velocities by the function `condition`, which FLIP sees as a change of velocity."""
    v = simulation.vertices[: simulation.num_vertices]
    v = v[v < unknowns]
    before = simulation.velocity[v]
    now = np.asarray(simulation.condition(simulation.kernel.points[v], before, simulation.time), float)
    if now.shape != before.shape:
        raise ValueError(f"condition returns shape {now.shape} for velocities {before.shape}")
    simulation.velocity[v] = now
    if len(simulation.increment):
        simulation.increment[v] += now - before


def hold_back(simulation, dt, drift, change):
    """Keep particles that the barrier cannot stop away from surfaces, `Contact.hold_back`. Collective."""
    sums = simulation.contact.hold_back(simulation.particles, simulation.kernel, simulation.velocity, dt)
    if not simulation.ranks.max(int(sums is not None)):
        return
    simulation.held_back += 1
    sums = np.zeros((len(simulation.velocity), 1 + simulation.mesh.dim)) if sums is None else sums
    simulation.borders.add_shared(sums, simulation.stamp, simulation.steps)
    push = sums[:, 1:] / np.where(sums[:, :1] > 0, sums[:, :1], 1.0)
    simulation.velocity += push
    if len(simulation.increment):
        simulation.increment += push
    apply_walls(simulation, drift, change)
