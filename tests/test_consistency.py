"""Consistent gradients: the integrals vanish, with the assembly's quadrature and with a finer one."""

import numpy as np
import pytest
from mesh_factory import MESHES, cube, gmsh_cube, graded_interval, rectangle

import fempm
from fempm.cell_shapes import equal_cells
from fempm.consistency import Conditions, assemble, correct
from fempm.kernel import build_kernel, evaluate_many
from fempm.simplex import quadrature, refine
from fempm.walls import Wall, wall_layer

SCENES = {
    "graded 1D": (lambda: graded_interval(0.1, 1.5), []),
    "graded 1D, wall": (lambda: graded_interval(0.1, 1.5), [Wall()]),
    "jittered 2D": (lambda: rectangle(9, 9), []),
    "jittered 2D, slip": (lambda: rectangle(8, 8), [Wall("boundary", "slip")]),
    "disk, sticky": (lambda: fempm.read_mesh(MESHES / "disk.geo", h=0.25), [Wall("wall")]),
    "gmsh 3D, sticky": (lambda: gmsh_cube(0.25), [Wall()]),
    "gmsh 3D, slip": (lambda: gmsh_cube(0.34), [Wall("boundary", "slip")]),
}


def integrals(kernel, mesh, points, weights):
    """int g_k dx over the mesh with a given rule, (nv, d)."""
    total = np.zeros_like(kernel.points)
    corners = mesh.points[mesh.cells]
    for b, weight in zip(points, weights, strict=True):
        _, g = evaluate_many(kernel, np.einsum("q,cqd->cd", b, corners), np.arange(len(mesh.cells)))
        for c in range(len(mesh.cells)):
            first, last = kernel.ring_start[c], kernel.ring_start[c + 1]
            total[kernel.ring_vertex[first:last]] += weight * mesh.volumes[c] * g[c, : last - first]
    return total


@pytest.mark.parametrize("name", SCENES)
def test_integrals_vanish(name):
    """1e-10 of the plain integral with the assembly's rule, 1e-2 of it with the rule refined once."""
    build, walls = SCENES[name]
    mesh = build()
    layer = wall_layer(mesh, walls)
    kernel = build_kernel(mesh, layer)
    conditions = Conditions(kernel, mesh, layer)
    rows = conditions.rows[:, 0] > 0
    assert rows.sum() > 5
    rule = quadrature(mesh.dim)
    plain = np.abs(conditions.fold(integrals(kernel, mesh, *rule))[rows]).max()
    assert correct(kernel, mesh, layer, tolerance=1e-13, max_iterations=20_000)["solved"]
    assert np.abs(conditions.fold(integrals(kernel, mesh, *rule))[rows]).max() < 1e-10 * plain
    finer = refine(*rule)
    assert np.abs(conditions.fold(integrals(kernel, mesh, *finer))[rows]).max() < 1e-2 * plain


UNIFORM = [lambda: fempm.interval_mesh(np.arange(21.0)), lambda: rectangle(12, 12, jitter=0), lambda: cube(6)]


@pytest.mark.parametrize("build", UNIFORM)
def test_uniform_meshes_need_no_solve(build):
    """By symmetry int g = 0 there, to round-off; the correction is skipped and costs nothing."""
    mesh = build()
    layer = wall_layer(mesh, [])
    kernel = build_kernel(mesh, layer)
    info = correct(kernel, mesh, layer)
    assert not info["solved"] and info["before"] < 1e-10 and len(kernel.phi) == 0


def test_matrix_rows_annihilate_constants():
    """K 1 = 0: a constant phi changes nothing (sum w = 1, sum w (x_k - x) = 0)."""
    mesh = rectangle(8, 8)
    kernel = build_kernel(mesh, wall_layer(mesh, [Wall()]))
    row_start, _, values, _, volume = assemble(kernel, equal_cells(kernel))
    sums = np.add.reduceat(values, row_start[:-1])
    assert np.abs(sums).max() < 1e-13 * volume.max()


def test_volumes_add_up():
    """sum_k int w_k = volume of the mesh."""
    mesh = gmsh_cube(0.3)
    kernel = build_kernel(mesh, wall_layer(mesh, [Wall()]))
    volume = assemble(kernel, equal_cells(kernel))[-1]
    assert volume.sum() == pytest.approx(1.0, rel=1e-12)


@pytest.mark.parametrize("lower, upper", [((0, 0), (1, 0.6)), ((0, 0, 0), (1, 0.6, 0.4))])
def test_copies_of_cells(lower, upper):
    """Integrals over few cells of a box are those over all, to round-off; irregular cells all differ."""
    mesh = fempm.box_mesh(lower, upper, 0.08)
    kernel = build_kernel(mesh, wall_layer(mesh, [Wall("bottom", "slip"), Wall("left")]))
    cells, start, place = equal_cells(kernel)
    assert len(start) < 0.6 * len(mesh.cells)
    ring = np.concatenate([np.arange(n) for n in np.diff(kernel.ring_start)]).astype(np.int16)
    each = np.arange(len(mesh.cells)), np.arange(len(mesh.cells) + 1), ring
    for few, all_cells in zip(assemble(kernel, (cells, start, place)), assemble(kernel, each)):
        assert np.abs(few - all_cells).max() <= 1e-13 * np.abs(all_cells).max()
    mesh = rectangle(5, 5)
    assert len(equal_cells(build_kernel(mesh, wall_layer(mesh, [])))[1]) == len(mesh.cells) + 1
