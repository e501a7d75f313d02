"""Bi-stride hierarchy of a mesh: which nodes each level keeps, its edges, and the way between levels.

Thesis 4.2 and 4.3.2. It depends on the mesh only: build it once, see `cached_hierarchy`.
"""

import hashlib
import os
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numba import njit
from scipy import sparse

from .seeding import adjacency, close_center, find_clusters, min_average, random_seeds

SEEDINGS = "min_average", "close_center", "random"
FORMAT = 1  # of cached files and what is in them: raise it when hierarchies change


@dataclass(frozen=True)
class Level:
    """One level of a hierarchy.

    Attributes
    ----------
    num_nodes : int
    edges : (ne, 2) int32, the lower node first, sorted
    kept : (m,) int32 nodes that the next level has, ascending; None on the coarsest
    transfer : (num_nodes, m) CSR contribution table C, v' = C.T v downwards and v = C v' upwards; its
        columns sum to one; None on the coarsest
    """

    num_nodes: int
    edges: np.ndarray
    kept: np.ndarray | None = None
    transfer: sparse.csr_matrix | None = None


@dataclass(frozen=True)
class Hierarchy:
    """Levels of a mesh, the mesh itself first."""

    levels: tuple

    @cached_property
    def reached(self):
        """(A + I)[:, kept] of each level but the last: which kept nodes are a node or beside it."""
        out = []
        for level in self.levels[:-1]:
            m = len(level.kept)
            itself = sparse.csr_matrix((np.ones(m), (level.kept, np.arange(m))), (level.num_nodes, m))
            out.append((level.transfer + itself).astype(bool).astype(np.float32))
        return out


def build_hierarchy(edges, points, depth, seeding="min_average", top_up=True, rng=None):
    """Pool a mesh up to `depth` times, each time to about half of its nodes.

    A cluster (connected component) that would shrink to one node is handed on as it is; the hierarchy
    ends early when that holds for all of them.

    Parameters
    ----------
    edges : (ne, 2) undirected edges, the lower node first, sorted, each once
    points : (n, d) positions of the nodes
    depth : number of poolings at most
    seeding : "min_average", "close_center" or "random"
    top_up : keep n // 2 nodes of each cluster. Without, as in the thesis' text, every other depth alone:
        on coarse levels, where depths are few, far less than half may be left
    rng : numpy Generator, for random seeds

    Raises
    ------
    ValueError : edges that are not as above, points that are not finite, an unknown seeding, no rng for
        random seeds
    """
    edges, points = check_input(edges, points, depth, seeding, rng)
    levels, weight = [], np.ones(len(points))
    while len(levels) < depth:
        n = len(points)
        start, adjacent = adjacency(edges, n)
        cluster, count = find_clusters(start, adjacent)
        if seeding == "min_average":
            seeds = min_average(cluster, count, start, adjacent)
        elif seeding == "close_center":
            seeds = close_center(cluster, count, points)
        else:
            seeds = random_seeds(cluster, count, rng)
        stays, whole = bi_stride(start, adjacent, seeds, top_up)
        if stays.all():
            break
        kept = np.flatnonzero(stays).astype(np.int32)
        values, columns, rows, weight = contribution_table(start, adjacent, kept, whole, weight)
        transfer = sparse.csr_matrix((values, columns, rows), (n, len(kept)))
        levels.append(Level(n, edges, kept, transfer))
        edges, points = pooled_edges(start, adjacent, kept, rows, columns), points[kept]
    return Hierarchy((*levels, Level(len(points), edges)))


def check_input(edges, points, depth, seeding, rng):
    """Edges (ne, 2) int32 and points (n, d) float64, or a ValueError."""
    edges, points = np.asarray(edges), np.asarray(points, float)
    if points.ndim != 2 or not len(points) or not np.isfinite(points).all():
        raise ValueError(f"points of shape {points.shape}: give finite coordinates (n, d), one row or more")
    if edges.ndim != 2 or edges.shape[1] != 2 or edges.dtype.kind not in "iu":
        raise ValueError(f"edges of shape {edges.shape} and type {edges.dtype}: give integers (ne, 2)")
    a, b = edges.T.astype(np.int64)
    if len(edges) and (edges.min() < 0 or edges.max() >= len(points)):
        raise ValueError(f"edges name nodes {edges.min()} to {edges.max()}, there are {len(points)}")
    if (a >= b).any() or (np.diff(a * len(points) + b) <= 0).any():
        raise ValueError("edges must have their lower node first, be sorted and occur once: see np.unique")
    if depth < 0:
        raise ValueError(f"depth {depth}: give the number of poolings, 0 or more")
    if seeding not in SEEDINGS:
        raise ValueError(f"seeding {seeding!r}: give one of {', '.join(SEEDINGS)}")
    if seeding == "random" and rng is None:
        raise ValueError("random seeding needs rng: give np.random.default_rng(number)")
    return edges.astype(np.int32), points


@njit(cache=True)
def bi_stride(start, adjacent, seeds, top_up):
    """Keep every other depth of the breadth-first search from each cluster's seed (thesis 4.2.2).

    Every node removed has a neighbour one depth nearer that is kept; a seed removed has all of depth 1.

    Returns
    -------
    stays : (n,) bool, nodes that the next level has
    whole : (n,) bool, nodes of clusters handed on as they are
    """
    n = len(start) - 1
    stays, whole = np.zeros(n, np.bool_), np.zeros(n, np.bool_)
    depth, queue = np.full(n, -1, np.int32), np.empty(n, np.int32)
    for seed in seeds:
        depth[seed], queue[0] = 0, seed
        head, tail = 0, 1
        while head < tail:
            i = queue[head]
            head += 1
            for e in range(start[i], start[i + 1]):
                if depth[adjacent[e]] < 0:
                    depth[adjacent[e]], queue[tail] = depth[i] + 1, adjacent[e]
                    tail += 1
        nodes = queue[:tail]  # by depth
        odd = depth[nodes] % 2 == 1
        if 0 < odd.sum() < tail - odd.sum():
            keep = odd
        else:
            keep = ~odd
        if top_up:
            removed = np.flatnonzero(~keep)
            extra = max(0, tail // 2 - keep.sum())
            for k in range(extra):  # evenly through the depths
                keep[removed[(2 * k + 1) * len(removed) // (2 * extra)]] = True
        if keep.sum() <= 1:
            keep[:] = True
            whole[nodes] = True
        stays[nodes] = keep
    return stays, whole


@njit(cache=True)
def numbers(kept, n):
    """(n,) int32 place of each node in `kept`, -1 for the others."""
    number = np.full(n, -1, np.int32)
    number[kept] = np.arange(len(kept))
    return number


@njit(cache=True)
def contribution_table(start, adjacent, kept, whole, weight):
    """Contribution table C[:, kept] of thesis 4.3.2, and the weights (m,) of the nodes kept.

    Node i sends w_i / deg_i to each neighbour: w'_j is what j receives and C_ij the share of i in it. A node
    does not send to itself, except that those of whole clusters send all to themselves and nothing else.

    Returns
    -------
    values, columns, rows : of the CSR matrix, columns ascending
    weight : (m,)
    """
    n = len(start) - 1
    number, received = numbers(kept, n), np.zeros(len(kept))
    rows, columns = np.zeros(n + 1, np.int32), np.empty(len(adjacent) + n, np.int32)
    values, end = np.empty(len(adjacent) + n), 0
    for i in range(n):
        if whole[i]:
            columns[end], values[end] = number[i], weight[i]
            end += 1
        else:
            for e in range(start[i], start[i + 1]):
                columns[end], values[end] = number[adjacent[e]], weight[i] / (start[i + 1] - start[i])
                end += number[adjacent[e]] >= 0
        for k in range(rows[i], end):
            received[columns[k]] += values[k]
        rows[i + 1] = end
    for k in range(end):
        values[k] /= received[columns[k]]
    return values[:end].copy(), columns[:end].copy(), rows, received


@njit(cache=True)
def pooled_edges(start, adjacent, kept, rows, columns):
    """(ne, 2) edges of the next level, offdiag((A + I)^2)[kept, kept] (4.1), from A and A[:, kept].

    Whole clusters have I instead of A[:, kept], see `contribution_table`, and keep their edges.
    """
    number, m = numbers(kept, len(start) - 1), len(kept)
    mark, counts = np.full(m, -1, np.int32), np.zeros(m + 1, np.int64)
    ends, lower = np.zeros(m + 1, np.int64), np.empty(4 * m, np.int32)
    for p in range(m):
        end = ends[p]
        if len(lower) < end + p:
            lower = np.concatenate((lower, np.empty(len(lower) + p, np.int32)))
        for e in range(start[kept[p]], start[kept[p] + 1]):
            j = adjacent[e]
            q = number[j]
            if 0 <= q < p and mark[q] != p:
                mark[q], lower[end] = p, q
                end += 1
            for k in range(rows[j], rows[j + 1]):
                q = columns[k]
                if q >= p:  # ascending: no more lower ones
                    break
                if mark[q] != p:
                    mark[q], lower[end] = p, q
                    end += 1
        ends[p + 1] = end
        for k in range(ends[p], end):
            counts[lower[k] + 1] += 1
    place, edges = np.cumsum(counts), np.empty((ends[m], 2), np.int32)
    for p in range(m):
        for q in lower[ends[p] : ends[p + 1]]:
            edges[place[q], 0], edges[place[q], 1] = q, p
            place[q] += 1
    return edges


def contact_levels(hierarchy, contact):
    """Contact edges on every level, A_C' = offdiag((A + I) A_C (A + I))[kept, kept] (4.1).

    Parameters
    ----------
    contact : (nc, 2) undirected contact edges of the mesh, see `contact_edges`

    Returns
    -------
    list of (nc_l, 2) int32, the lower node first, sorted; in whole clusters nodes pass on their own alone
    """
    contact = np.asarray(contact, np.int32).reshape(-1, 2)
    out = [contact]
    for reached in hierarchy.reached:
        m = reached.shape[1]
        product = (reached[contact[:, 0]].T @ reached[contact[:, 1]]).tocoo()
        ends = np.stack([np.minimum(product.row, product.col), np.maximum(product.row, product.col)])
        keys = np.unique((ends[0].astype(np.int64) * m + ends[1])[ends[0] < ends[1]])
        contact = np.stack(np.divmod(keys, m), axis=1).astype(np.int32)
        out.append(contact)
    return out


def cached_hierarchy(graph, depth, folder=None, **options):
    """`build_hierarchy` of a MeshGraph, from the npz file in `folder` (None: no file) of an earlier run.

    The file's name is a hash of edges, points and options. ValueError: random seeds, which have no name.
    """
    if folder is None:
        return build_hierarchy(graph.edges, graph.points, depth, **options)
    if options.get("seeding") == "random":
        raise ValueError("hierarchies of random seeds differ from run to run: give folder=None")
    options = {"seeding": "min_average", "top_up": True} | options
    name = hashlib.sha256(repr((FORMAT, depth, sorted(options.items()), graph.points.shape)).encode())
    name.update(np.ascontiguousarray(graph.edges, np.int32))
    name.update(np.ascontiguousarray(graph.points, np.float64))
    path = Path(folder) / f"hierarchy_{name.hexdigest()[:32]}.npz"
    if not path.exists():
        hierarchy = build_hierarchy(graph.edges, graph.points, depth, **options)
        path.parent.mkdir(parents=True, exist_ok=True)
        unfinished = path.with_suffix(f".{os.getpid()}.npz")  # renamed when complete: others may look for it
        np.savez(unfinished, **to_arrays(hierarchy))
        os.replace(unfinished, path)
    with np.load(path) as arrays:
        return from_arrays(arrays)


def to_arrays(hierarchy):
    """Dict of arrays that tell all of a hierarchy."""
    arrays = {"sizes": np.array([level.num_nodes for level in hierarchy.levels])}
    for l, level in enumerate(hierarchy.levels):
        arrays[f"edges{l}"] = level.edges
        if level.kept is not None:
            table = level.transfer
            arrays[f"kept{l}"] = level.kept
            arrays |= {f"values{l}": table.data, f"columns{l}": table.indices, f"rows{l}": table.indptr}
    return arrays


def from_arrays(arrays):
    """The Hierarchy of `to_arrays`."""
    sizes, levels = arrays["sizes"].tolist(), []
    for l, (n, m) in enumerate(zip(sizes[:-1], sizes[1:])):
        table = tuple(arrays[f"{name}{l}"] for name in ("values", "columns", "rows"))
        levels.append(Level(n, arrays[f"edges{l}"], arrays[f"kept{l}"], sparse.csr_matrix(table, (n, m))))
    return Hierarchy((*levels, Level(sizes[-1], arrays[f"edges{len(levels)}"])))
