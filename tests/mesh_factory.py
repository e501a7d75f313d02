"""Meshes that tests share: graded intervals, jittered Delaunay rectangles, gmsh domains."""

from pathlib import Path

import numpy as np
from matplotlib.tri import Triangulation

import fempm

MESHES = Path(__file__).parent.parent / "meshes"


def graded_interval(h, length):
    """Cells h (1, 1.3, 1.69, 1.3, 1, ...) / 1.3225 from 0 to at least `length`."""
    cycle = np.tile([1, 1.3, 1.69, 1.3], int(np.ceil(length / h / 4)))
    return fempm.interval_mesh(np.append(0, np.cumsum(cycle) * h / 1.3225))


def rectangle(nx, ny, lx=1.0, ly=1.0, jitter=0.2, seed=0):
    """Triangles on a lattice (jitter = 0) or the Delaunay mesh of its randomly moved vertices."""
    x, y = np.meshgrid(np.arange(nx + 1), np.arange(ny + 1), indexing="ij")
    points = np.stack([x.ravel(), y.ravel()], axis=1).astype(float)
    move = jitter * np.random.default_rng(seed).uniform(-1, 1, points.shape)
    move[(points == 0) | (points == [nx, ny])] = 0
    points = (points + move) * [lx / nx, ly / ny]
    if jitter:
        cells = Triangulation(*points.T).triangles
        corners = points[cells]
        area = np.linalg.det(corners[:, 1:] - corners[:, :1])
        cells = cells[np.abs(area) > 1e-9 * lx * ly]
    else:
        i = (np.arange(nx)[:, None] * (ny + 1) + np.arange(ny)).ravel()
        lower, upper = [i, i + ny + 1, i + ny + 2], [i, i + ny + 2, i + 1]
        cells = np.concatenate([np.stack(lower, axis=1), np.stack(upper, axis=1)])
    return fempm.SimplexMesh(points, cells)


def cube(n):
    """Unit cube of n^3 x 6 tetrahedra."""
    from fempm import compat  # noqa: F401, the wheels of 0.11 need it before DOLFINx and MPI

    # isort: split
    from dolfinx.mesh import create_box
    from mpi4py import MPI

    return fempm.from_dolfinx(create_box(MPI.COMM_WORLD, [[0.0] * 3, [1.0] * 3], [n] * 3))


def gmsh_cube(h):
    """Unit cube meshed by gmsh: irregular tetrahedra."""
    return fempm.read_mesh(MESHES / "cube.geo", h=h)


def random_points(mesh, n, seed=0):
    """n uniform random points in random cells: positions (n, d) and cells (n,)."""
    rng = np.random.default_rng(seed)
    cell = rng.integers(0, len(mesh.cells), n).astype(np.int32)
    b = rng.dirichlet(np.ones(mesh.dim + 1), n)
    return np.einsum("pq,pqd->pd", b, mesh.points[mesh.cells[cell]]), cell
