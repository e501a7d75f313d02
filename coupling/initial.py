"""The initial state on the nodes: values at their points, means over their dual cells where it jumps."""

from itertools import product

import numpy as np

from .gas import check_state, conserved
from .spaces import bernstein

JUMP = 0.1  # relative difference within a cell from which it is sampled
SAMPLES = (0, 32, 9, 5)  # points along the edge of a sampled cell, by dimension


def initial_state(mesh, space, eos, initial):
    """Density, velocity and pressure (n, d + 2) at the nodes of a space.

    A jump is where it is, not at the nearest node: cells that it crosses are sampled, and what lies
    nearest to a node (its median dual; weighted with its function for nodes on edges) is averaged.

    Parameters
    ----------
    mesh, space : mesh and the space on it
    eos : equation of state
    initial : function of points (n, d) returning density, velocity and pressure

    Raises
    ------
    ValueError
        where density or pressure is not positive
    """
    at_nodes = evaluate(eos, space.points, initial)
    U = to_conserved(eos, at_nodes)
    cells = crossed_cells(space, eos, at_nodes)
    if len(cells) == 0:
        return at_nodes
    coordinates = lattice(space.dim)
    share = shares(coordinates, space.cell_nodes.shape[1])
    share /= len(coordinates)
    weight = np.repeat(space.cell_volumes, space.cell_nodes.shape[1]) / space.cell_nodes.shape[1]
    weight.reshape(space.cell_nodes.shape)[cells] = 0
    total = np.bincount(space.cell_nodes.ravel(), weight, len(U))
    U *= total[:, None]
    for some in np.array_split(cells, 1 + len(cells) // 10000):
        x = np.einsum("sa,cad->csd", coordinates, mesh.points[mesh.cells[some]])
        there = to_conserved(eos, evaluate(eos, x.reshape(-1, space.dim), initial)).reshape(*x.shape[:2], -1)
        volumes = space.cell_volumes[some]
        np.add.at(U, space.cell_nodes[some], np.einsum("c,sb,csk->cbk", volumes, share, there))
        np.add.at(total, space.cell_nodes[some], volumes[:, None] * share.sum(axis=0))
    U /= total[:, None]
    velocity = U[:, 1:-1] / U[:, :1]
    inner = U[:, -1] - 0.5 * np.sum(U[:, 1:-1] * velocity, axis=1)
    out = np.concatenate([U[:, :1], velocity, eos.pressure(U[:, 0], inner)[:, None]], axis=1)
    touched = np.unique(space.cell_nodes[cells])
    at_nodes[touched] = out[touched]
    return at_nodes


def evaluate(eos, points, initial):
    """(n, d + 2) density, velocity and pressure at points."""
    state = np.empty((len(points), points.shape[1] + 2))
    state[:, 0], state[:, 1:-1], state[:, -1] = initial(points)
    check_state(eos, state[:, 0], state[:, -1])
    return state


def to_conserved(eos, state):
    """Conserved variables of density, velocity and pressure (n, d + 2)."""
    return conserved(eos, state[:, 0], state[:, 1:-1], state[:, -1])


def crossed_cells(space, eos, state):
    """Cells at whose nodes the state differs by more than JUMP, velocities relative to that of sound."""
    sound = np.sqrt(eos.bulk_modulus(state[:, 0], state[:, -1]) / state[:, 0])
    scale = np.repeat(sound[:, None], state.shape[1], axis=1)
    scale[:, 0], scale[:, -1] = state[:, 0], state[:, -1]
    values, scale = state[space.cell_nodes], scale[space.cell_nodes]
    return np.flatnonzero(np.any(np.ptp(values, axis=1) > JUMP * scale.max(axis=1), axis=1))


def lattice(dim):
    """(m, d + 1) barycentric coordinates of points spread evenly in a simplex."""
    n = SAMPLES[dim]
    inner = np.array([a for a in product(range(n), repeat=dim) if sum(a) < n], float)
    first = (n - 1) - inner.sum(axis=1, keepdims=True)
    return (np.concatenate([first, inner], axis=1) + 1 / (dim + 1)) / n


def shares(coordinates, nodes_per_cell):
    """(m, nb) share of each node in sample points: the nearest vertex, or the values of its function."""
    dim = coordinates.shape[1] - 1
    if nodes_per_cell == dim + 1:
        nearest = coordinates >= coordinates.max(axis=1, keepdims=True) - 1e-12
        return nearest / nearest.sum(axis=1, keepdims=True)
    basis = bernstein(dim, 2)
    return np.stack([c * np.prod(coordinates ** np.array(e), axis=1) for c, e in basis], axis=1)
