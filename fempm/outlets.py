"""Outlets: boundaries through which particles leave the simulation."""

import numpy as np

from . import locate


def outlet_facets(mesh, names):
    """(nc, d + 1) bool: facets on the named boundaries, by the vertex opposite."""
    if isinstance(names, str):
        raise TypeError(f"outlets {names!r}: give a list of names of boundaries")
    return locate.mark_facets(mesh, np.concatenate([mesh.facets(name) for name in names]))


def remove_escaped(simulation):
    """Remove the particles that were lost across an outlet; returns how many others are lost. Collective.

    A lost particle has the last cell of its way and stepped out where its barycentric coordinate is least.
    """
    s, p, mesh = simulation, simulation.particles, simulation.mesh
    lost = np.flatnonzero(s.status[: len(p)] == locate.LOST)
    cell = p.cell[lost]
    out = s.outlet[cell, np.argmin(mesh.barycentric(p.position[lost], cell), axis=1)]
    stuck = int(np.sum(~out))
    if stuck:  # the run ends with an error: leave the others where they are
        s.status[lost[out]] = locate.FOUND
        lost, out = lost[:0], out[:0]
    gone = s.ranks.sum(len(lost))
    if gone:
        s.escaped_mass += float(p.mass[lost].sum())
        s.num_particles -= gone
        p.replace(lost, {}, np.empty(0, int))
    return stuck
