"""What the hierarchy of a mesh costs, beside the code of the thesis' authors."""

import multiprocessing
import time
from concurrent.futures import ProcessPoolExecutor

import numpy as np
from scipy.spatial import Delaunay

from gnn.hierarchy import build_hierarchy

from .memory import peak_memory

# Seconds of the authors' code and of plain scipy, by nodes of the mesh, measured on the same machine.
AUTHORS = {
    1881: {"close_center": 0.036, "min_average": 3.0},
    5229: {"close_center": 0.16, "min_average": 29.0},
    13152: {"close_center": 0.31, "min_average": 228.0},
    46946: {"close_center": 1.27, "min_average": None},  # 17.6 GB
}
SCIPY = {
    1881: {"close_center": 0.011, "min_average": 0.35},
    5229: {"close_center": 0.028, "min_average": 2.7},
    13152: {"close_center": 0.069, "min_average": 20.7},
    46946: {"close_center": 0.27, "min_average": None},
}
SPACINGS = {1881: 0.0191, 5229: 0.011236, 13152: 0.00713, 46946: 0.00374}
COARSEST = 30  # nodes that the last level has fewer of


def channel(spacing, seed=0):
    """Points (n, 2) and edges (ne, 2) of a jittered Delaunay channel, 1.6 by 0.41, around a round hole."""
    rng, centre, r = np.random.default_rng(seed), np.array([0.33, 0.2]), 0.05
    nx, ny = round(1.6 / spacing), round(0.41 / spacing)
    i, j = np.meshgrid(np.arange(nx + 1), np.arange(ny + 1), indexing="ij")
    x = np.stack([i.ravel() * (1.6 / nx), j.ravel() * (0.41 / ny)], axis=1)
    inside = ((i > 0) & (i < nx) & (j > 0) & (j < ny)).ravel()
    x[inside] += rng.uniform(-0.3, 0.3, (inside.sum(), 2)) * spacing
    turn = 2 * np.pi * np.arange(k := round(2 * np.pi * r / spacing)) / k
    far = np.linalg.norm(x - centre, axis=1) > r + 0.5 * spacing
    x = np.concatenate([x[far], centre + r * np.stack([np.cos(turn), np.sin(turn)], axis=1)])
    cells = Delaunay(x).simplices
    cells = cells[np.linalg.norm(x[cells].mean(axis=1) - centre, axis=1) > r]
    pairs = np.sort(np.concatenate([cells[:, [0, 1]], cells[:, [1, 2]], cells[:, [0, 2]]]), axis=1)
    return x, np.unique(pairs, axis=0).astype(np.int32)


def measure(spacing, seeding, repeats):
    """Nodes, edges, levels, CPU seconds (least of some repeats) of all levels and peak MB of this process."""
    points, edges = channel(spacing)
    depth = int(np.ceil(np.log2(len(points) / COARSEST))) + 1
    build_hierarchy(*channel(0.1)[::-1], 2, seeding)  # compile
    seconds = []
    for _ in range(repeats):
        begin = time.process_time()
        hierarchy = build_hierarchy(edges, points, depth, seeding)
        seconds.append(time.process_time() - begin)
    return {
        "nodes": len(points),
        "edges": len(edges),
        "seeding": seeding,
        "levels": len(hierarchy.levels),
        "coarsest": hierarchy.levels[-1].num_nodes,
        "cpu_s": min(seconds),
        "peak_MB": peak_memory() / 2**20,
    }


def hierarchy_table(quick=False):
    """Rows: mesh, seeding, levels, CPU seconds on one thread, the authors' and scipy's, peak memory in MB.

    Each in a process of its own: the peak holds the interpreter, the libraries and the mesh as well.
    """
    rows = []
    for nodes in list(AUTHORS)[: 1 if quick else None]:
        for seeding in ("close_center", "min_average"):
            with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as process:
                row = process.submit(measure, SPACINGS[nodes], seeding, 1 if quick else 3).result()
            authors = AUTHORS[nodes][seeding]
            row |= {"authors_s": authors, "scipy_s": SCIPY[nodes][seeding]}
            rows.append(row | {"times_faster": authors and authors / row["cpu_s"]})
    return rows
