"""Two sticks and a gap that heat cannot cross: levels by distance leak, bi-stride's do not (thesis 4.6).

A stick with a given temperature at one end and a given heat flux at the other has a linear temperature. Both
networks learn it from single sticks, of either direction, and then see two sticks in a row."""

import argparse

import numpy as np
import torch

from gnn.batch import join, single
from gnn.graph import INFLOW, NORMAL, WALL, from_cells
from gnn.hierarchy import build_hierarchy
from gnn.models import make_model

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


def learn(model, steps, rng):
    """Train on single sticks anywhere along the axis, of both directions."""
    optimizer = torch.optim.Adam(model.parameters(), lr=1e-3)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, steps)
    for _ in range(steps):
        batch, inputs, heat = joined([scene([stick(NODES * rng.random(), k % 2)]) for k in range(8)])
        loss = torch.mean((model(batch, inputs) - heat) ** 2)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        schedule.step()
    return float(loss.detach()) ** 0.5


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


def main(argv=None):
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=1500, help="of the training")
    parser.add_argument(
        "--output", default="results/gnn_heat_sticks", help="picture to write, without ending"
    )
    args = parser.parse_args(argv)
    sizes = {"num_inputs": 11, "num_outputs": 1, "dim": 1, "depth": DEPTH, "latent": 32}
    found = {}
    for name, own in (("bsms", {}), ("ms_gnn_grid", {})):
        torch.manual_seed(0)
        model, rng = make_model(name, **sizes, **own), np.random.default_rng(0)
        left = learn(model, args.steps, rng)
        found[name] = errors(model, rng)
        print(f"{name}: error of a single stick {left:.2g}; at the gap, by the direction of the sticks:")
        print("  " + ", ".join(f"{pair}: {e:.2g}" for pair, e in found[name].items()))
    ratio = max(found["ms_gnn_grid"].values()) / max(found["bsms"].values())
    print(f"levels by distance are {ratio:.0f} times as wrong at the gap as those by bi-stride")
    return {"errors": found, "ratio": ratio}


if __name__ == "__main__":
    main()
