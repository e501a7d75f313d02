"""Regular meshes of intervals, rectangles and boxes."""

from itertools import permutations

import numpy as np

from .mesh import SimplexMesh, mark_boundary

SIDES = (("left", "right"), ("bottom", "top"), ("back", "front"))


def lattice_mesh(lower, upper, h, mirrored=False):
    """Mesh of a box of cubes that are cut into simplices along their diagonals (Kuhn), without named sides.

    Parameters
    ----------
    lower, upper : (d,) corners, d = 1, 2 or 3
    h : wanted edge length of the cubes, a number or (d,); the nearest that divides the box is taken
    mirrored : the diagonals of neighbouring cubes mirror each other, so that no direction is preferred; else
        all cubes are alike, so that every vertex sees the same ring and int g_i (x - x_i) is exact: what the
        gas of `parvi` needs, whose stationary residual then falls with h^2 (mirrored it stays at 0.2)

    Raises
    ------
    ValueError
        for a box without volume or an h that is not positive
    """
    lower, upper = np.atleast_1d(lower).astype(float), np.atleast_1d(upper).astype(float)
    d = len(lower)
    h = np.broadcast_to(np.asarray(h, float), d)
    if upper.shape != lower.shape or not np.all(upper > lower) or not np.all(h > 0):
        raise ValueError(f"box from {lower} to {upper} with edges {h}: all must be positive")
    count = np.maximum(1, np.round((upper - lower) / h).astype(int))
    axes = [np.linspace(a, b, n + 1) for a, b, n in zip(lower, upper, count, strict=True)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, d)
    cube = np.stack(np.meshgrid(*(np.arange(n) for n in count), indexing="ij"), axis=-1).reshape(-1, d)
    stride = np.append(np.cumprod((count + 1)[::-1])[::-1][1:], 1)
    odd = cube % 2 if mirrored else np.zeros_like(cube)
    cells = []
    for order in permutations(range(d)):  # one simplex for each way to walk from corner to corner
        corner = np.zeros_like(cube)
        walk = [corner]
        for axis in order:
            corner = corner.copy()
            corner[:, axis] = 1
            walk.append(corner)
        cells.append(np.stack([(cube + np.where(odd, 1 - c, c)) @ stride for c in walk], axis=1))
    return SimplexMesh(points, np.concatenate(cells).astype(np.int32))


def box_mesh(lower, upper, h):
    """Mesh of a box in 1D, 2D or 3D, cut into cubes and these into simplices along mirrored diagonals.

    Parameters
    ----------
    lower, upper, h : see `lattice_mesh`, whose errors are raised

    Returns
    -------
    SimplexMesh
        with boundaries "left", "right" (x), "bottom", "top" (y), "back", "front" (z)
    """
    mesh = lattice_mesh(lower, upper, h, mirrored=True)
    lower, upper = mesh.points.min(axis=0), mesh.points.max(axis=0)
    for axis, names in enumerate(SIDES[: mesh.dim]):
        for name, value in zip(names, (lower[axis], upper[axis]), strict=True):
            near = 1e-9 * (upper - lower)[axis]
            mark_boundary(mesh, name, lambda x, a=axis, v=value, e=near: abs(x[a] - v) < e)
    return mesh
