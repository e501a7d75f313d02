"""Meshes of boxes and random fields on them."""

import numpy as np

from fempm import compat  # before DOLFINx: it loads the right MPI

# isort: split
from dolfinx import mesh as dmesh
from mpi4py import MPI


def dolfinx_box(d):
    """DOLFINx mesh of [0, 2] x [0, 1]^(d - 1)."""
    if d == 1:
        return dmesh.create_interval(MPI.COMM_SELF, 4, [0.0, 2.0])
    if d == 2:
        return dmesh.create_rectangle(MPI.COMM_SELF, [[0.0, 0.0], [2.0, 1.0]], [4, 2])
    return dmesh.create_box(MPI.COMM_SELF, [[0.0, 0.0, 0.0], [2.0, 1.0, 1.0]], [3, 2, 2])


def box(d):
    """Points and cells of a small mesh of [0, 2] x [0, 1]^(d - 1)."""
    mesh = dolfinx_box(d)
    return compat.vertex_points(mesh), compat.cell_vertices(mesh).astype(np.int64)


def random_fields(n, d, nt, seed=0):
    rng = np.random.default_rng(seed)
    return {"p": rng.normal(size=(nt, n)), "v": rng.normal(size=(nt, n, d))}
