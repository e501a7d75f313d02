"""How much of each dual cell the solid fills, from its particles (thesis 3.2.3, design note).

A particle counts as a box of its present volume, divided into 2^d points; each gives its share to the
nodes of the cell it lies in by their basis functions. As these sum to one and m_i = int phi_i, a solid
fills neither more nor less than its volume, and an interface is spread over no more than two cells.
"""

import numpy as np
from numba import njit

CLOSED = 0.15  # open share below which a vertex is closed
WHOLE = 0.4  # and from which on it is as computed
OPENNESS = ("least", "ball", "reflective")

options = {"cache": True, "nogil": True, "error_model": "numpy"}


@njit(**options)
def add_volumes(size, corners, position, cell, values, cells, points, inverse, neighbours, cell_nodes, out):
    """Add to `out` (n, k) the shares of the nodes in what particles carry, `values` (np, k), volumes first.

    `size` and `corners` are tuples as long as the dimension and the nodes of a cell.
    """
    d = len(size)
    b, x = np.empty(d + 1), np.empty(d)
    pieces = 2**d
    for p in range(len(cell)):
        quarter = 0.25 * values[p, 0] ** (1.0 / d)
        for piece in range(pieces):
            for a in range(d):
                x[a] = position[p, a] + (quarter if (piece >> a) & 1 else -quarter)
            c = cell[p]
            for _ in range(20):
                b[0] = 1.0
                for i in range(d):
                    b[i + 1] = 0.0
                    for a in range(d):
                        b[i + 1] += inverse[c, i, a] * (x[a] - points[cells[c, 0], a])
                    b[0] -= b[i + 1]
                q = 0
                for i in range(1, d + 1):
                    if b[i] < b[q]:
                        q = i
                if b[q] >= 0.0 or neighbours[c, q] < 0:
                    break
                c = neighbours[c, q]
            total = 0.0
            for i in range(d + 1):
                b[i] = max(b[i], 0.0)  # a point behind the boundary is moved onto it
                total += b[i]
            for i in range(d + 1):
                b[i] /= total
            at = d + 1
            for i in range(d + 1):
                own = b[i]
                if len(corners) > d + 1:
                    own *= b[i]
                    for j in range(i + 1, d + 1):
                        for k in range(values.shape[1]):
                            out[cell_nodes[c, at], k] += 2.0 * b[i] * b[j] * values[p, k] / pieces
                        at += 1
                for k in range(values.shape[1]):
                    out[cell_nodes[c, i], k] += own * values[p, k] / pieces


def open_share(solid, kind="least"):
    """(n,) share of each dual cell that is open to the gas, from the share that the solid fills.

    What is nearly full is full: particles leave gaps of some per cent, in which no gas belongs. With
    `kind` "reflective", what is more than half full is full.
    """
    theta = 1 - solid
    ramp = (theta - CLOSED) * (WHOLE / (WHOLE - CLOSED))
    theta = np.clip(np.where(theta < WHOLE, ramp, theta), 0, 1)
    return np.where(theta < 0.5, 0.0, theta) if kind == "reflective" else theta


def edge_openness(kind, theta, space):
    """(ne,) share of the dual faces of a space through which gas passes; `theta` (n,) is open of its nodes.

    "least" is that of the fuller end; "ball" 1 - R with the thesis's ratio R, the cross-section of a ball of
    the solid's volume over the face (in 1D the same as "least"); "reflective" none where an end is more than
    half full, see `open_share`, and else all of it.
    """
    if kind == "reflective":
        theta = np.ceil(theta)
    elif kind == "ball" and space.dim > 1:
        solid, face = (1 - theta) * space.volumes, space.volumes ** (1 - 1 / space.dim)
        disk = 2 * np.sqrt(solid / np.pi) if space.dim == 2 else np.pi * (3 * solid / (4 * np.pi)) ** (2 / 3)
        theta = np.where(theta > 0, 1 - np.minimum(disk / face, 1), 0)
    return least_of_ends(space.edges, theta)


@njit(**options)
def least_of_ends(edges, values):
    """(ne,) smaller one of the values (n,) at the two ends of each edge."""
    out = np.empty(len(edges))
    for e in range(len(edges)):
        out[e] = min(values[edges[e, 0]], values[edges[e, 1]])
    return out
