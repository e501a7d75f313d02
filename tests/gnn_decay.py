"""Trajectories of fields that decay by a factor in every step, and small networks to learn it."""

import numpy as np
from scipy.spatial import Delaunay

from gnn.config import Config
from gnn.graph import NORMAL, WALL, from_cells
from gnn.trajectory import write_trajectory

SMALL = {"latent": 16, "depth": 2, "batch": 2, "noise": (0.01,), "held_out": 1, "look_every": 1000}
DECAY = 0.8  # of the field in a step


def square(rng, n=60):
    """Graph of random points in a square, walls on its hull."""
    points = np.concatenate([rng.random((n, 2)), [[0, 0], [1, 0], [0, 1], [1, 1]]])
    mesh = Delaunay(points)
    types = np.full(len(points), NORMAL)
    types[np.unique(mesh.convex_hull)] = WALL
    return from_cells(points, mesh.simplices, types)


def decaying(folder, count=3, frames=8):
    """Trajectories of fields that decay by the factor DECAY in every step."""
    rng = np.random.default_rng(0)
    for i in range(count):
        graph = square(rng)
        start = rng.standard_normal((len(graph.points), 2))
        values = start * DECAY ** np.arange(frames)[:, None, None]
        write_trajectory(folder / f"t_{i}.xdmf", graph, 0.1 * np.arange(frames), {"velocity": values})
    return folder


def config(folder, **changes):
    """Config of a small network, with changes."""
    return Config(**({"data": str(folder), **SMALL} | changes))


def exact(predictor):
    """Make a predictor's step the closed form."""
    predictor.step = lambda batch, state, motion=None: (DECAY * state, state[:, :0])
    return predictor
