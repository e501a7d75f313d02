"""Sticks that conduct heat at rest, with a given temperature at one end and a given flux at the other."""

import numpy as np
import torch

from gnn.batch import join, single
from gnn.graph import INFLOW, NORMAL, WALL, from_cells
from gnn.hierarchy import build_hierarchy

NODES, GAP = 24, 0.1  # of a stick; lengths in elements
SLOPE, DEPTH = 1 / NODES, 4


def stick(start, turned):
    """Points (n, 1), node types, inputs (given temperature, given flux) and temperatures of a stick."""
    x = start + np.arange(NODES)
    types, given = np.full(NODES, NORMAL), np.zeros((NODES, 2))
    warm, cold = (NODES - 1, 0) if turned else (0, NODES - 1)
    types[warm], types[cold] = INFLOW, WALL
    given[warm, 0], given[cold, 1] = 1.0, 1.0
    return x, types, given, 1.0 - SLOPE * np.abs(x - x[warm])


def scene(parts):
    """GraphBatch, inputs (n, 11) and temperatures (n, 1) of sticks in a row."""
    x, types, given, heat = (np.concatenate(a) for a in zip(*parts))
    first = np.arange(len(x) - 1)
    cells = np.stack([first, first + 1], axis=1)[(first + 1) % NODES > 0]  # none across the gap
    graph = from_cells(x[:, None], cells, types)
    batch = single(graph, build_hierarchy(graph.edges, graph.points, DEPTH))
    inputs = np.concatenate([given, np.eye(9)[types]], axis=1).astype(np.float32)
    return batch, torch.from_numpy(inputs), torch.from_numpy(heat[:, None].astype(np.float32))


def joined(scenes):
    """One scene of several."""
    batches, inputs, heats = zip(*scenes)
    return join(batches), torch.cat(inputs), torch.cat(heats)


def errors(model, rng, tests=8):
    """Largest error within three nodes of the gap, in four arrangements of two sticks."""
    out = {}
    for pair in ((0, 0), (0, 1), (1, 0), (1, 1)):
        worst = 0.0
        for start in NODES * rng.random(tests):
            parts = [stick(start, pair[0]), stick(start + NODES - 1 + GAP, pair[1])]
            batch, inputs, heat = scene(parts)
            with torch.no_grad():
                off = (model(batch, inputs) - heat).abs()[NODES - 3 : NODES + 3]
            worst = max(worst, float(off.max()))
        out[" ".join("<>"[k] for k in pair)] = worst
    return out
