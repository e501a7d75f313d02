"""Meshes whose vertices all look alike, which the gas of `parvi` rests on more exactly than on others."""

from itertools import permutations

import numpy as np

from .mesh import SimplexMesh


def lattice_mesh(lower, upper, size):
    """Mesh of a box of cubes that are all cut into simplices in the same way (Kuhn).

    As every vertex sees the same ring, int g_i (x - x_i) is the same for all, and exact: the stationary
    residual falls with the square of the mesh size. With mirrored diagonals (`box_mesh`) it stays at 0.2.

    Parameters
    ----------
    lower, upper : (d,) corners
    size : wanted edge length of the cubes, a number or (d,); the nearest that divides the box is taken

    Raises
    ------
    ValueError
        for a box without volume or a size that is not positive
    """
    lower, upper = np.atleast_1d(lower).astype(float), np.atleast_1d(upper).astype(float)
    d = len(lower)
    size = np.broadcast_to(np.asarray(size, float), d)
    if upper.shape != lower.shape or not np.all(upper > lower) or not np.all(size > 0):
        raise ValueError(f"box from {lower} to {upper} with edges {size}: all must be positive")
    count = np.maximum(1, np.round((upper - lower) / size).astype(int))
    axes = [np.linspace(a, b, n + 1) for a, b, n in zip(lower, upper, count)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, d)
    cube = np.stack(np.meshgrid(*map(np.arange, count), indexing="ij"), axis=-1).reshape(-1, d)
    stride = np.append(np.cumprod((count + 1)[::-1])[::-1][1:], 1)
    first = cube @ stride
    cells = [
        np.stack([first + sum(stride[list(order[:k])]) for k in range(d + 1)], axis=1)
        for order in permutations(range(d))  # one simplex for each way to walk from corner to corner
    ]
    return SimplexMesh(points, np.concatenate(cells).astype(np.int32))
