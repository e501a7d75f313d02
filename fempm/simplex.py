"""Points in a simplex, in barycentric coordinates: quadrature rules and even fillings."""

import numpy as np

DEGREE = {1: 9, 2: 8, 3: 6}  # of the quadrature rule on each part of a cell


def quadrature(dim):
    """Barycentric points (n, d + 1) and weights (n,), summing to one, of the rule on each cell."""
    import basix

    kind = [None, basix.CellType.interval, basix.CellType.triangle, basix.CellType.tetrahedron][dim]
    x, w = basix.make_quadrature(kind, DEGREE[dim])
    points, w = refine(np.column_stack([1 - x.sum(axis=1), x]), w / w.sum())
    return points, w


def refine(points, w):
    """The same rule on the 2^d equal parts that edge midpoints cut a simplex into."""
    corners = points.shape[1]
    middle = 0.5 * (np.eye(corners)[:, None] + np.eye(corners)[None])
    parts = {
        2: [[(0, 0), (0, 1)], [(0, 1), (1, 1)]],
        3: [
            [(0, 0), (0, 1), (0, 2)],
            [(0, 1), (1, 1), (1, 2)],
            [(0, 2), (1, 2), (2, 2)],
            [(0, 1), (1, 2), (0, 2)],
        ],
        4: [[(q, r) for r in range(4)] for q in range(4)]
        + [
            [(0, 2), (1, 3), *other]
            for other in ([(0, 1), (0, 3)], [(0, 1), (1, 2)], [(2, 3), (0, 3)], [(2, 3), (1, 2)])
        ],
    }[corners]
    maps = np.array([[middle[a, b] for a, b in part] for part in parts])
    refined = np.einsum("nc,pcb->pnb", points, maps).reshape(-1, corners)
    return refined, np.tile(w, len(parts)) / len(parts)


def simplex_points(dim, count):
    """(count, dim + 1) barycentric coordinates of points spread evenly over a simplex."""
    if count < 1 or count != int(count):
        raise ValueError(f"{count} particles per cell: give a positive whole number")
    if dim == 1:
        x = (np.arange(count) + 0.5) / count
        return np.stack([1 - x, x], axis=1)
    levels = np.log2(count) / dim
    if levels == int(levels):
        points, w = np.full((1, dim + 1), 1 / (dim + 1)), np.ones(1)
        for _ in range(int(levels)):
            points, w = refine(points, w)
        return points
    # Kronecker sequence of the root of g^(dim+1) = g + 1, sorted coordinates map the cube to the simplex
    golden = {2: 1.32471795724474602596, 3: 1.22074408460575947536}[dim]
    cube = (0.5 + np.arange(1, count + 1)[:, None] * golden ** -np.arange(1.0, dim + 1)) % 1.0
    cube = np.sort(cube, axis=1)
    return np.diff(np.column_stack([np.zeros(count), cube, np.ones(count)]), axis=1)
