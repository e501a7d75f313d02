"""The UMLS kernel: closed form, exactness, continuity, ablation of eta."""

import numpy as np
import pytest
from mesh_factory import cube, gmsh_cube, graded_interval, random_points, rectangle

import fempm
from fempm.consistency import correct
from fempm.kernel import build_kernel, check_cells, evaluate, evaluate_many, negative_weights
from fempm.walls import Wall, wall_layer

MESHES = {
    "graded 1D": (lambda: graded_interval(0.1, 2.0), "sticky"),
    "jittered 2D": (lambda: rectangle(12, 10), "slip"),
    "uniform 3D": (lambda: cube(4), "slip"),
    "gmsh 3D": (lambda: gmsh_cube(0.25), "sticky"),
}


def make(name, **options):
    build, kind = MESHES[name]
    mesh = build()
    layer = wall_layer(mesh, [Wall("boundary", kind)])
    return mesh, layer, build_kernel(mesh, layer, **options)


def closed_form(x):
    """Thesis eq. 2.33-2.34 on (0.5, 2], with the rounded coefficients restored: (f, g) of node 2."""
    if x <= 1:
        q = x**5 - 6 * x**4 + 13.5 * x**3 - 13.75 * x**2 + 6.3125 * x - 0.5625
        return 0.25 * (0.5 - x) ** 2 * x / q, -((0.5 - x) ** 2) * x * (x - 2) / q
    if x <= 1.5:
        q = -(x**5) + 4 * x**4 - 5.5 * x**3 + 3.25 * x**2 - 1.3125 * x + 1.0625
        f = -(x**6) + 5 * x**5 - 9.5 * x**4 + 8.5 * x**3 - 3.3125 * x**2 + 0.3125 * x + 0.0625
        return f / q, (-(x**5) + 5 * x**4 - 10.5 * x**3 + 11.5 * x**2 - 5.8125 * x + 1.0625) / q
    q = x**5 - 11 * x**4 + 47.5 * x**3 - 100.25 * x**2 + 103.3125 * x - 41.125
    f = x**6 - 12 * x**5 + 58.5 * x**4 - 148.25 * x**3 + 205.5625 * x**2 - 147.0625 * x + 42.25
    return f / q, (x**5 - 9 * x**4 + 33.5 * x**3 - 65.75 * x**2 + 67.3125 * x - 27.625) / q


@pytest.mark.smoke
def test_closed_form_on_unit_cells():
    """The other half, with its misprint on (2.5, 3], is the mirror image about node 2."""
    mesh = fempm.interval_mesh(np.arange(-3.0, 8.0))
    kernel = build_kernel(mesh, wall_layer(mesh, []), support=1.0)
    node = 5  # the vertex at x = 2
    for x in np.linspace(0.501, 3.499, 400):
        vertices, w, g = evaluate(kernel, [x], int(np.floor(x)) + 3)
        f, slope = closed_form(min(x, 4 - x))
        f, slope = (0.0, 0.0) if node not in vertices else (f, np.sign(2 - x) * slope if x != 2 else 0.0)
        at = np.flatnonzero(vertices == node)
        assert w[at].sum() == pytest.approx(f, abs=1e-5)
        assert g[at, 0].sum() == pytest.approx(slope, abs=1e-5)


@pytest.mark.parametrize("corrected", [False, True])
@pytest.mark.parametrize("name", MESHES)
def test_exactness(name, corrected):
    """Partition of unity, linear reproduction, sum g = 0, sum g (x) (x_k - x) = I, to round-off."""
    mesh, layer, kernel = make(name)
    if corrected:
        assert correct(kernel, mesh, layer)["solved"]
    x, cell = random_points(mesh, 2000)
    w, g = evaluate_many(kernel, x, cell)
    for p in range(len(x)):
        ring = kernel.ring_vertex[kernel.ring_start[cell[p]] : kernel.ring_start[cell[p] + 1]]
        r = kernel.points[ring] - x[p]
        wp, gp = w[p, : len(ring)], g[p, : len(ring)]
        h = mesh.volumes[cell[p]] ** (1 / mesh.dim)
        assert abs(wp.sum() - 1) < 1e-10
        assert np.abs(wp @ r).max() < 1e-10 * h
        assert np.abs(gp.sum(axis=0)).max() < 1e-10 / h
        assert np.abs(gp.T @ r - np.eye(mesh.dim)).max() < 1e-10


@pytest.mark.parametrize("diminishing", [True, False])
@pytest.mark.parametrize("name", MESHES)
def test_continuity_across_faces(name, diminishing):
    """Both sides of a face agree; without eta they do not (thesis figures 2.5b and 2.8a)."""
    mesh, layer, kernel = make(name, diminishing=diminishing, support=None if diminishing else 1.5)
    correct(kernel, mesh, layer)
    rng = np.random.default_rng(1)
    jump_w = jump_g = 0.0
    for c, q in rng.permutation(np.argwhere(mesh.neighbours >= 0))[:300]:
        b = rng.dirichlet(np.ones(mesh.dim))
        x = b @ mesh.points[np.delete(mesh.cells[c], q)]
        h = mesh.volumes[c] ** (1 / mesh.dim)
        sides = np.zeros((2, len(kernel.points), 1 + mesh.dim))
        for side, cell in enumerate((c, mesh.neighbours[c, q])):
            vertices, w, g = evaluate(kernel, x, cell)
            sides[side, vertices] = np.column_stack([w, h * g])
        jump = np.abs(sides[0] - sides[1])
        jump_w, jump_g = max(jump_w, jump[:, 0].max()), max(jump_g, jump[:, 1:].max())
    if diminishing:  # round-off, amplified by the moment matrix of the flattest tetrahedra
        assert jump_w < 1e-11 and jump_g < 1e-10
    else:
        assert jump_w > 1e-3 and jump_g > 1e-2


def test_weights_are_continuous_along_a_line():
    """Halving the distance of samples halves the largest change of weights and gradients."""
    mesh, layer, kernel = make("jittered 2D")
    correct(kernel, mesh, layer)
    changes = []
    for n in (4000, 8000):
        x = np.array([0.1, 0.2]) + np.linspace(0, 1, n)[:, None] * np.array([0.8, 0.55])
        cell = fempm.locate.find_cells(mesh, x)
        values = np.zeros((n, len(kernel.points), 3))
        w, g = evaluate_many(kernel, x, cell)
        for p in range(n):
            ring = kernel.ring_vertex[kernel.ring_start[cell[p]] : kernel.ring_start[cell[p] + 1]]
            values[p, ring] = np.column_stack([w[p, : len(ring)], g[p, : len(ring)]])
        changes.append(np.abs(np.diff(values, axis=0)).max(axis=(0, 1)))
    assert np.all(changes[0] / changes[1] > 1.8)


def test_negative_weights_are_counted():
    """At an open end the weight of the far vertex turns negative (thesis figure 2.6); a wall mends it."""
    mesh = fempm.interval_mesh(np.arange(6.0))
    x = np.array([[0.16], [2.5]])
    cell = np.array([0, 2], np.int32)
    count, least = negative_weights(build_kernel(mesh, wall_layer(mesh, []), support=1.5), x, cell)
    assert count == 1 and least < -1e-3
    walled = build_kernel(mesh, wall_layer(mesh, [Wall()]), support=1.5)
    assert negative_weights(walled, x, cell) == (0, 0.0)


def test_singular_moment_matrix_names_the_cell():
    """A support far smaller than the cells leaves too few vertices: the message says where."""
    mesh = rectangle(3, 3)
    kernel = build_kernel(mesh, wall_layer(mesh, []), support=0.3)
    with pytest.raises(ValueError, match=r"singular moment matrix in cell \d+ at .*quality"):
        check_cells(kernel, mesh)
