"""Cells of a mesh that are translated copies of each other, with all that the kernel sees there."""

import numpy as np
from numba import njit

from .weights import MAX_RING


def equal_cells(kernel):
    """Cells (nc,) by shape, CSR offsets of each shape, and places of ring vertices that all its cells share.

    On a lattice nearly all cells with their rings are translated copies of a few, integrated once each.
    """
    size = np.abs(1.0 / np.linalg.det(kernel.inverse)).mean() ** (1 / kernel.dim)
    place = np.empty(len(kernel.ring_vertex), np.int16)
    rings = kernel.points, kernel.cells, kernel.ring_start, kernel.ring_vertex, kernel.ring_mask
    keys = ring_keys(*rings, kernel.inverse_support, 1e-9 * size, place)
    _, first, shape = np.unique(keys, return_index=True, return_inverse=True)
    shape = np.argsort(np.argsort(first, kind="stable"), kind="stable")[shape]  # in the order of the cells
    start = np.concatenate([[0], np.cumsum(np.bincount(shape))])
    return np.argsort(shape, kind="stable"), start, place


@njit(cache=True)
def mix(key, value):
    """A hash of both (the finalizer of splitmix64)."""
    z = (key ^ np.uint64(value)) + np.uint64(0x9E3779B97F4A7C15)
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return z ^ (z >> np.uint64(31))


@njit(cache=True)
def ring_keys(points, cells, start, vertex, mask, inverse_support, unit, place):
    """Hashes (nc,) of cells with their rings, lengths rounded to a unit, and places in their order."""
    out, keys = np.empty(len(cells), np.uint64), np.empty(MAX_RING, np.uint64)
    for c in range(len(cells)):
        first, n, origin = start[c], start[c + 1] - start[c], points[cells[c, 0]]
        for k in range(n):
            v = vertex[first + k]
            key = mix(np.uint64(mask[first + k]), np.int64(np.rint(1.0 / (inverse_support[v] * unit))))
            for a in range(points.shape[1]):
                key = mix(key, np.int64(np.rint((points[v, a] - origin[a]) / unit)))
            keys[k] = key
        order, total = np.argsort(keys[:n]), np.uint64(n)
        for k in range(n):
            total = mix(total, keys[order[k]])
            place[first + order[k]] = k
        for v in cells[c, 1:]:
            for a in range(points.shape[1]):
                total = mix(total, np.int64(np.rint((points[v, a] - origin[a]) / unit)))
        out[c] = total
    return out
