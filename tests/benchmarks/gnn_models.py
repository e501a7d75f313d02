"""What a training step of the graph networks costs, beside the published BSMS-GNN on the same machine."""

import json
import os
import subprocess
import sys
import time

import numpy as np
import torch
from scipy.spatial import Delaunay

from gnn.batch import join, single
from gnn.graph import NUM_TYPES, from_cells
from gnn.hierarchy import build_hierarchy
from gnn.models import make_model
from gnn.train import keep_memory

from .memory import peak_memory

# Nodes, poolings, and of the authors' code: CPU seconds of a step on one thread, peak GB, and the ratio of
# these seconds to those of their flat network with 15 message passings (torch 2.13, float32, batch of one).
AUTHORS = (
    (1881, 6, 0.79, 0.80, 0.48),
    (5229, 8, 2.40, 1.6, 0.56),
    (13152, 9, 6.37, 3.5, 0.41),
    (46946, 10, 34.0, 8.3, np.nan),
)
FLAT_UP_TO = 20_000  # nodes; beyond, the flat network takes more memory than most machines have


def channel(nodes, seed=0):
    """Jittered Delaunay mesh of a channel 1.6 x 0.41 with a round hole, of about that many nodes."""
    radius, middle, size = 0.05, np.array([0.33, 0.2]), np.array([1.6, 0.41])
    # what is left of the sides of the grid, h / 2 wide around the channel, counts as well
    area, border = size.prod() - np.pi * radius**2, size.sum()
    h = (border + np.sqrt(border**2 + 4 * nodes * area)) / (2 * nodes)
    x, y = np.meshgrid(*(np.linspace(0, a, round(a / h) + 1) for a in size))
    points = np.stack([x.ravel(), y.ravel()], axis=1)
    points += np.random.default_rng(seed).uniform(-0.25, 0.25, points.shape) * h
    points = points[np.linalg.norm(points - middle, axis=1) > radius]
    cells = Delaunay(points).simplices
    cells = cells[np.linalg.norm(points[cells].mean(axis=1) - middle, axis=1) > radius]
    used, cells = np.unique(cells, return_inverse=True)
    return from_cells(points[used], cells.reshape(-1, 3))


def step(name, nodes, depth, batch, repeats):
    """Of a forward and backward pass: CPU seconds, the least of some, and peak GB over what imports take."""
    torch.set_num_threads(1)
    keep_memory()
    before = peak_memory()
    graph = channel(nodes)
    one = single(graph, build_hierarchy(graph.edges, graph.points, depth, seeding="close_center"))
    whole = join([one] * batch)
    torch.manual_seed(0)
    model = make_model(name, num_inputs=2 + NUM_TYPES, num_outputs=2, dim=2, depth=depth)
    features, seconds = torch.randn(len(whole.node_type), 2 + NUM_TYPES), []
    for _ in range(repeats):
        begin = time.process_time()
        model(whole, features).square().mean().backward()
        seconds.append(time.process_time() - begin)
    peak = peak_memory() - before
    edges = [len(level.senders) for level in whole.levels]
    found = {"nodes": len(whole.node_type), "edges": edges[0] // 2, "all_edges": sum(edges) // 2}
    return found | {"coarsest": whole.levels[-1].num_nodes, "s": min(seconds), "GB": peak / 1e9}


def own_process(module, *args):
    """What a module, run with `args` in a process of its own and on one thread, prints last, as JSON."""
    paths = os.pathsep.join(p for p in sys.path if p)
    one = dict.fromkeys(("OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1")
    command = [sys.executable, "-m", module, json.dumps(args)]
    done = subprocess.run(
        command, env=os.environ | one | {"PYTHONPATH": paths}, check=True, stdout=subprocess.PIPE, text=True
    )
    return json.loads(done.stdout.splitlines()[-1])


def measure(*args):
    """`step` in a process of its own, whose peak memory is that of this step."""
    return own_process(__name__, *args)


def training_step_table(quick):
    """Rows: size, CPU seconds and peak GB of a step, over the authors', and beside our own flat network."""
    rows = []
    for nodes, depth, seconds, memory, to_flat in AUTHORS[: 1 if quick else None]:
        own = measure("bsms", nodes, depth, 1, 3 if quick or nodes > FLAT_UP_TO else 8)
        flat = {"s": np.nan, "GB": np.nan}
        if nodes < FLAT_UP_TO:
            flat = measure("meshgraphnets", nodes, depth, 1, 2 if quick else 3)
        rows.append(
            own
            | {"authors_s": seconds, "s / authors": own["s"] / seconds}
            | {"authors_GB": memory, "GB / authors": own["GB"] / memory}
            | {"flat_s": flat["s"], "flat_GB": flat["GB"], "s / flat": own["s"] / flat["s"]}
            | {"authors_s / flat": to_flat}
        )
    return rows


def batch_memory_table(quick):
    """Rows: meshes in a batch, peak GB of a training step of each network at about 1,900 nodes."""
    rows = []
    for batch in (2, 4) if quick else (2, 4, 8, 16):
        row = {"batch": batch}
        for name in ("bsms", "meshgraphnets", "ms_gnn_grid"):
            # the flat network would need more than many machines have for the largest one
            fits = name == "bsms" or batch <= 8
            row[f"{name}_GB"] = measure(name, 1881, 6, batch, 1)["GB"] if fits else np.nan
        rows.append(row)
    return rows


if __name__ == "__main__":
    print(json.dumps(step(*json.loads(sys.argv[1]))))
