"""Gas in vertices that a solid nearly fills, closes or opens: it shares the state of an open neighbour.

Nothing is extrapolated and nothing is lost: nodes give their gas to the node at the end of a chain of ever
more open neighbours, and all that end at the same one share its state by volume, as cut-cell codes do.
"""

import numpy as np
from numba import njit

SMALL = 0.5  # open share of a dual cell below which it shares the state of a neighbour
POCKET = 0.02  # open share of a node that holds gas with no way out


def adjacency(edges, n):
    """CSR lists (start, nodes) of the other ends of each node's edges (ne, 2)."""
    ends = np.concatenate([edges[:, 0], edges[:, 1]])
    others = np.concatenate([edges[:, 1], edges[:, 0]])
    start = np.concatenate([[0], np.cumsum(np.bincount(ends, minlength=n))])
    return start, others[np.argsort(ends, kind="stable")].astype(np.int32)


@njit(cache=True)
def settle(nodes, held, theta, start, adjacent, root):
    """Decide which nodes stay open, and where the small ones share the state.

    Parameters
    ----------
    nodes : (k,) those that the solid touches, or did in the last step
    held : (n,) whether a node was open in the last step
    theta : (n,) open shares, changed: a node opens only beside one that was open, and one that holds gas
        and has no open neighbour at all does not close
    start, adjacent : see `adjacency`
    root : (n,) int32 node whose group each of `nodes` belongs to, -1 for closed nodes without gas
    """
    for i in nodes:
        root[i] = i
        if theta[i] > 0.0 and not held[i]:
            beside = False
            for k in range(start[i], start[i + 1]):
                beside |= held[adjacent[k]] and theta[adjacent[k]] > 0.0
            if not beside:
                theta[i] = 0.0
    for i in nodes:
        if theta[i] == 0.0 and not held[i]:
            root[i] = -1
        elif theta[i] == 0.0:
            root[i] = most_open(i, -1, held, theta, start, adjacent)
            if root[i] < 0:
                root[i], theta[i] = i, POCKET
    for i in nodes:
        if theta[i] > 0.0 and not held[i]:
            root[i] = most_open(i, -1, held, theta, start, adjacent)
        elif 0.0 < theta[i] < SMALL:
            root[i] = most_open(i, i, held, theta, start, adjacent)
    for i in nodes:
        r = root[i]
        while r >= 0 and root[r] != r:
            r = root[r]
        root[i] = r


@njit(cache=True)
def add_open_neighbours(nodes, theta, start, adjacent, U, number, sums):
    """Add for closed nodes U (n, m) of each open neighbour to `sums` (n, m); 1 to `number` (n,) of both."""
    for i in nodes:
        for e in range(start[i], start[i + 1]):
            j = adjacent[e]
            if theta[j] > 0.0:
                number[i] += 1.0
                number[j] += 1.0
                for k in range(U.shape[1]):
                    sums[i, k] += U[j, k]


@njit(cache=True)
def most_open(i, best, held, theta, start, adjacent):
    """The most open of node `best`, -1 for none, and i's neighbours that were open; the first of equals."""
    for k in range(start[i], start[i + 1]):
        j = adjacent[k]
        if not held[j] or theta[j] == 0.0:
            continue
        if best < 0 or theta[j] > theta[best] or (theta[j] == theta[best] and j < best):
            best = j
    return best


def means(group, volumes, totals):
    """(k, m) sums of `totals` (k, m) over all nodes of a group over their volume (k,), for each node."""
    volume = np.bincount(group, volumes)
    sums = np.stack([np.bincount(group, column) for column in totals.T], axis=1)
    return (sums / volume[:, None])[group]


@njit(cache=True)
def add_weighted(dofs, weights, values, out):
    """Add to `out` (nq, 2) particles' weights (np, k) at some dofs (np, k), and those times values (np,)."""
    for p in range(len(dofs)):
        for k in range(dofs.shape[1]):
            out[dofs[p, k], 0] += weights[p, k]
            out[dofs[p, k], 1] += weights[p, k] * values[p]


@njit(cache=True)
def divide(dofs, sums, others, out):
    """Means in `out` (nq,) at some dofs: of sums (nq, 2), without weight of columns 1, 2 of others."""
    for q in dofs:
        if sums[q, 0] > 0.0:
            out[q] = sums[q, 1] / sums[q, 0]
        elif others[q, 1] > 0.0:
            out[q] = others[q, 2] / others[q, 1]
