"""Clusters of a graph and the node in each from which bi-stride pooling counts its depths (thesis 4.2.2).

Graphs are CSR lists (start, adjacent) of the neighbours of each node, see `adjacency`. A cluster is a
connected component; clusters are numbered by their lowest nodes.
"""

import numpy as np
from numba import njit

WORD = 64  # searches that run at once, as the bits of a word
BYTES = np.uint64(0x0101010101010101)


@njit(cache=True)
def adjacency(edges, n):
    """CSR lists (start, adjacent) of the neighbours of n nodes, ascending, from sorted edges (ne, 2)."""
    start = np.zeros(n + 1, np.int64)
    for e in range(len(edges)):
        start[edges[e, 0] + 1] += 1
        start[edges[e, 1] + 1] += 1
    start = np.cumsum(start)
    adjacent, end = np.empty(2 * len(edges), np.int32), start[:-1].copy()
    for i, j in ((1, 0), (0, 1)):  # the lower neighbours first
        for e in range(len(edges)):
            adjacent[end[edges[e, i]]] = edges[e, j]
            end[edges[e, i]] += 1
    return start, adjacent


@njit(cache=True)
def find_clusters(start, adjacent):
    """(n,) int32 number of each node's cluster (thesis algorithm 4), and how many there are."""
    n = len(start) - 1
    cluster, queue, count = np.full(n, -1, np.int32), np.empty(n, np.int32), 0
    for first in range(n):
        if cluster[first] >= 0:
            continue
        cluster[first], queue[0] = count, first
        head, tail = 0, 1
        while head < tail:
            for e in range(start[queue[head]], start[queue[head] + 1]):
                j = adjacent[e]
                if cluster[j] < 0:
                    cluster[j], queue[tail] = count, j
                    tail += 1
            head += 1
        count += 1
    return cluster, count


def close_center(cluster, count, points):
    """(count,) node of each cluster closest to the mean of its points (n, d) (thesis algorithm 2)."""
    sizes = np.bincount(cluster, minlength=count)
    centres = np.stack([np.bincount(cluster, x) for x in points.T], axis=1) / sizes[:, None]
    return first_least(((points - centres[cluster]) ** 2).sum(axis=1), cluster, count)


@njit(cache=True)
def first_least(values, cluster, count):
    """(count,) lowest node of each cluster among those with the least value (n,)."""
    seeds = np.full(count, -1, np.int32)
    for i in range(len(values)):
        s = seeds[cluster[i]]
        if s < 0 or values[i] < values[s]:
            seeds[cluster[i]] = i
    return seeds


def random_seeds(cluster, count, rng):
    """(count,) one random node of each cluster."""
    sizes = np.bincount(cluster, minlength=count)
    nodes = np.argsort(cluster, kind="stable").astype(np.int32)
    return nodes[np.cumsum(sizes) - sizes + rng.integers(sizes)]


@njit(cache=True)
def min_average(cluster, count, start, adjacent):
    """(count,) node of each cluster with the least sum of geodesic distances to its others (algorithm 3).

    Exact, the lowest of equals. Each cluster is cut into patches of up to 64 close nodes. One step changes
    the sum by at most the number of nodes, so the sum of the first node of a patch bounds the others, and
    only patches that can hold the least one are searched in full. Memory O(n + edges).
    """
    order, patches, radius = cut_into_patches(start, adjacent)
    start, adjacent = renumbered(order, start, adjacent)
    firsts = np.empty(count + 1, np.int64)  # of the patches of each cluster
    firsts[count] = len(radius)
    for p in range(len(radius) - 1, -1, -1):
        firsts[cluster[order[patches[p]]]] = p
    seeds, words = np.empty(count, np.int32), np.zeros((3, len(order)), np.uint64)
    lists = np.empty((2, len(order) + 1), np.uint32)
    for c in range(count):
        nodes = slice(patches[firsts[c]], patches[firsts[c + 1]])
        some = patches[firsts[c] : firsts[c + 1]]
        sums = distance_sums(some, nodes, start, adjacent, words, lists)
        best, seeds[c] = sums.min(), order[some[np.argmin(sums)]]
        bounds = sums - (nodes.stop - nodes.start) * radius[firsts[c] : firsts[c + 1]]
        for k in np.argsort(bounds):
            if bounds[k] > best:
                break
            patch = np.arange(some[k], patches[firsts[c] + k + 1])
            sums = distance_sums(patch, nodes, start, adjacent, words, lists)
            seed = order[patch[sums == sums.min()]].min()
            if sums.min() < best or (sums.min() == best and seed < seeds[c]):
                best, seeds[c] = sums.min(), seed
    return seeds


@njit(cache=True)
def cut_into_patches(start, adjacent):
    """Patches of up to 64 nodes, grown breadth-first around a first node beside the patches before.

    Returns
    -------
    order : (n,) int32 nodes patch by patch, those of a cluster contiguous
    patches : (np + 1,) int64 where each begins in `order`, and the end
    radius : (np,) int64 at least the geodesic distance from its first node to any other of the patch
    """
    n = len(start) - 1
    order, waiting = np.empty(n, np.int32), np.empty(n, np.int32)
    depth = np.full(n, -1, np.int64)  # -1 for nodes not met yet, -2 for those waiting
    patches, radius = np.empty(n + 1, np.int64), np.zeros(n, np.int64)
    tail = np_ = 0
    for lowest in range(n):
        if depth[lowest] >= 0:
            continue
        waiting[0] = lowest
        w, ws = 0, 1
        while w < ws:
            first = waiting[w]
            w += 1
            if depth[first] >= 0:
                continue
            head = patches[np_] = tail
            depth[first], order[tail] = 0, first
            tail += 1
            while head < tail:
                i = order[head]
                head += 1
                for e in range(start[i], start[i + 1]):
                    j = adjacent[e]
                    if depth[j] < 0 and tail < patches[np_] + WORD:
                        depth[j], order[tail] = depth[i] + 1, j
                        tail += 1
                    elif depth[j] == -1:
                        depth[j], waiting[ws] = -2, j
                        ws += 1
            radius[np_] = depth[order[tail - 1]]
            np_ += 1
    patches[np_] = n
    return order, patches[: np_ + 1], radius[:np_]


@njit(cache=True)
def renumbered(order, start, adjacent):
    """The graph (start, adjacent) with node order[i] as node i."""
    place = np.empty(len(order), np.int32)
    place[order] = np.arange(len(order))
    # unsigned: no check of negative indices
    new_start, new_adjacent = np.zeros_like(start), np.empty(len(adjacent), np.uint32)
    k = 0
    for i in range(len(order)):
        for e in range(start[order[i]], start[order[i] + 1]):
            new_adjacent[k] = place[adjacent[e]]
            k += 1
        new_start[i + 1] = k
    return new_start, new_adjacent


@njit(cache=True)
def distance_sums(sources, nodes, start, adjacent, words, lists):
    """(k,) int64 sums of the geodesic distances from sources (k,) to all of `nodes`, their cluster (a slice).

    Bit s of a word belongs to source s. `words` (3, n): for each node the searches that have seen it and
    those that arrive, zero on entry and on return, and for each node of the front those that advance from
    it. Sources close together arrive together, so each step over an edge serves many of them. `lists`
    (2, n + 1): the front, and what it reaches.
    """
    sums = np.zeros((len(sources) + WORD - 1) // WORD * WORD, np.int64)
    seen, coming, bits = words[0], words[1], words[2]
    front, reached = lists[0], lists[1]
    for batch in range(0, len(sources), WORD):
        size, depth = min(WORD, len(sources) - batch), 0
        for s in range(size):
            front[s], bits[s] = sources[batch + s], np.uint64(1) << np.uint64(s)
            seen[front[s]] = bits[s]
        while size > 0:
            size = advance(size, front, reached, start, adjacent, seen, coming, bits)
            depth += 1
            add_bits(bits[:size], depth, sums[batch : batch + WORD])
        seen[nodes] = 0
    return sums[: len(sources)]


@njit(cache=True)
def advance(size, front, reached, start, adjacent, seen, coming, bits):
    """Move a front of `size` nodes one step on, to neighbours that have not seen its bits; its new size."""
    count = 0
    for k in range(size):
        i = front[k]
        for e in range(start[i], start[i + 1]):  # without branches, which would cost more than they save
            j = adjacent[e]
            reached[count] = j
            count += coming[j] == 0
            coming[j] |= bits[k]
    size = 0
    for k in range(count):
        j = reached[k]
        new = coming[j] & ~seen[j]
        coming[j] = 0
        seen[j] |= new
        front[size], bits[size] = j, new
        size += new != 0
    return size


@njit(cache=True)
def add_bits(bits, depth, sums):
    """Add `depth` to sums (64,) for every bit of some words, 255 words at a time in the bytes of a word."""
    for first in range(0, len(bits), 255):
        some = bits[first : first + 255]
        for j in range(8):
            total = np.uint64(0)
            for k in range(len(some)):
                total += (some[k] >> np.uint64(j)) & BYTES
            for b in range(8):
                sums[8 * b + j] += depth * np.int64((total >> np.uint64(8 * b)) & np.uint64(255))
