"""What is measured in a gas: values along lines, forces on walls, and the pressure where it is stopped."""

import numpy as np

from fempm.locate import cell_bins, search
from fempm.walls import facet_normals


def probe(mesh, points, field):
    """Values of a vertex field at points, interpolated linearly.

    Parameters
    ----------
    mesh : fempm.SimplexMesh
    points : (n, d) array, for example along a line
    field : (nv, ...) array

    Returns
    -------
    (n, ...) array
        NaN at points outside the mesh.
    """
    points = np.ascontiguousarray(points, float).reshape(-1, mesh.dim)
    cell = np.zeros(len(points), np.int32)
    search(tuple(range(mesh.dim)), points, cell, mesh.cells, mesh.points, mesh.inverse, *cell_bins(mesh))
    weights = mesh.barycentric(points, cell)
    weights[cell < 0] = np.nan
    return np.einsum("ni,ni...->n...", weights, np.asarray(field, float)[mesh.cells[cell]])


def wall_force(mesh, boundary, pressure):
    """Force (d,) of a gas with pressure (nv,) at the vertices on a boundary of its mesh."""
    facets = mesh.facets(boundary)
    return pressure[facets].mean(axis=1) @ facet_normals(mesh, facets)


def stopped_pressure(mach, gamma=1.4):
    """Exact pressure of a wind that is stopped, over its own: isentropic, or behind a normal shock."""
    if mach <= 1:
        return (1 + 0.5 * (gamma - 1) * mach**2) ** (gamma / (gamma - 1))
    square, z = mach**2, gamma / (gamma - 1)
    shock = (2 * gamma * square - (gamma - 1)) / (gamma + 1)
    return shock * ((gamma + 1) ** 2 * square / (4 * gamma * square - 2 * (gamma - 1))) ** z
