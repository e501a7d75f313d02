"""The transfers against sums over `evaluate_many` in NumPy, with any number of particles in a cell."""

import numpy as np
import pytest
from mesh_factory import cube, graded_interval, rectangle

from fempm import locate, transfer
from fempm.consistency import correct
from fempm.kernel import build_kernel, evaluate_many
from fempm.walls import Wall, wall_layer
from fempm.weights import optional

MESHES = {1: lambda: graded_interval(0.1, 1.0), 2: lambda: rectangle(5, 4), 3: lambda: cube(2)}
KINDS = {"pic": 0.0, "flip": 0.9, "apic": 0.0}


def scene(dim, kind="pic", gradient="plain"):
    """Kernel, random particles, 1 to 9 of them in every cell, and their order by cells."""
    rng = np.random.default_rng(dim)
    mesh = MESHES[dim]()
    layer = wall_layer(mesh, [Wall()])
    kernel = build_kernel(mesh, layer)
    if gradient == "consistent":
        correct(kernel, mesh, layer)
        kernel.phi = kernel.phi if len(kernel.phi) else 0.01 * rng.standard_normal(kernel.points.shape)
    cell = rng.permutation(np.repeat(np.arange(len(mesh.cells)), np.arange(len(mesh.cells)) % 9 + 1))
    cell = cell.astype(np.int32)
    n = len(cell)
    b = rng.dirichlet(np.ones(dim + 1), n)
    particles = {
        "position": np.einsum("pq,pqd->pd", b, mesh.points[mesh.cells[cell]]),
        "velocity": rng.standard_normal((n, dim)),
        "affine": rng.standard_normal((n if kind == "apic" else 0, dim, dim)),
        "mass": rng.uniform(0.5, 1.5, n),
        "volume": rng.uniform(0.5, 1.5, n),
        "stress": rng.standard_normal((n, dim, dim)),
        "F": rng.standard_normal((n, dim, dim)),
    }
    active, start = np.empty(len(mesh.cells), np.int32), np.empty(len(mesh.cells) + 1, np.int32)
    order = np.empty(n, np.int32)
    num_active = locate.sort_by_cell(cell, np.zeros(len(mesh.cells) + 1, np.int32), order, active, start)
    return kernel, particles, cell, (0, num_active, active, start, order), rng


def dense(kernel, x, cell):
    """Weights (n, nv), gradients (n, nv, d) and offsets (n, nv, d) of all particles and vertices."""
    w, g = evaluate_many(kernel, x, cell)
    n, nv = len(x), len(kernel.points)
    all_w, all_g = np.zeros((n, nv)), np.zeros((n, nv, kernel.dim))
    for p in range(n):
        ring = kernel.ring_vertex[kernel.ring_start[cell[p]] : kernel.ring_start[cell[p] + 1]]
        all_w[p, ring], all_g[p, ring] = w[p, : len(ring)], g[p, : len(ring)]
    return all_w, all_g, kernel.points - x[:, None]


@pytest.mark.parametrize("gradient", ["plain", "consistent"])
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("dim", MESHES)
def test_particle_to_grid(dim, kind, gradient):
    """Mass, momentum and force, with a body force in FLIP."""
    kernel, q, cell, ranges, rng = scene(dim, kind, gradient)
    force = rng.standard_normal(q["velocity"].shape) if kind == "flip" else np.zeros((0, dim))
    grid = np.ones((len(kernel.points), 1 + 2 * dim))
    fields = (q["position"], q["velocity"], optional(q["affine"]), q["mass"], q["volume"], q["stress"])
    kernel_arrays = (kernel.rings, optional(kernel.phi))
    transfer.particle_to_grid(kernel.axes, *ranges, *fields, optional(force), *kernel_arrays, grid)

    w, g, r = dense(kernel, q["position"], cell)
    velocity = np.repeat(q["velocity"][:, None], len(kernel.points), axis=1)
    if kind == "apic":
        inertia = np.einsum("pk,pka,pkb->pab", w, r, r)
        velocity += np.einsum("pab,pkb->pka", q["affine"] @ np.linalg.inv(inertia), r)
    expected = np.ones_like(grid)
    expected[:, 0] += q["mass"] @ w
    expected[:, 1 : 1 + dim] += np.einsum("p,pk,pka->ka", q["mass"], w, velocity)
    expected[:, 1 + dim :] -= np.einsum("p,pab,pkb->ka", q["volume"], q["stress"], g)
    if kind == "flip":
        expected[:, 1 + dim :] += np.einsum("pk,pa->ka", w, force)
    np.testing.assert_allclose(grid, expected, rtol=0, atol=1e-11 * np.abs(expected).max())


@pytest.mark.parametrize("gradient", ["plain", "consistent"])
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("dim", MESHES)
def test_grid_to_particle(dim, kind, gradient):
    """Positions, velocities, APIC matrices and deformation gradients."""
    kernel, q, cell, ranges, rng = scene(dim, kind, gradient)
    v, dv = rng.standard_normal((2, len(kernel.points), dim))
    increment = dv if kind == "flip" else np.zeros((0, dim))
    dt, flip = 0.1, KINDS[kind]
    x, velocity, affine, f = (q[name].copy() for name in ("position", "velocity", "affine", "F"))
    kernel_arrays = (kernel.rings, optional(kernel.phi), v, optional(increment))
    transfer.grid_to_particle(
        kernel.axes, *ranges, x, velocity, optional(affine), f, *kernel_arrays, flip, dt
    )

    w, g, r = dense(kernel, q["position"], cell)
    np.testing.assert_allclose(x, q["position"] + dt * w @ v, atol=1e-12)
    expected = flip * (q["velocity"] + w @ dv) + (1 - flip) * w @ v
    np.testing.assert_allclose(velocity, expected, atol=1e-12)
    gradients = np.einsum("ka,pkb->pab", v, g)
    expected = q["F"] + dt * gradients @ q["F"]
    np.testing.assert_allclose(f, expected, atol=1e-11 * np.abs(expected).max())
    if kind == "apic":
        np.testing.assert_allclose(affine, np.einsum("pk,ka,pkb->pab", w, v, r), atol=1e-12)


@pytest.mark.parametrize("dim", MESHES)
def test_averages(dim):
    """Weighted sums of a number per particle and back; particles without weight keep what they had."""
    kernel, q, cell, ranges, rng = scene(dim)
    weight = q["mass"] * (rng.random(len(cell)) < 0.7)
    value = rng.standard_normal(len(cell))
    grid = np.zeros((len(kernel.points), 1 + 2 * dim))
    transfer.scatter_average(kernel.axes, *ranges, q["position"], weight, value, kernel.rings, grid)
    w = dense(kernel, q["position"], cell)[0]
    np.testing.assert_allclose(grid[:, 0], weight @ w, atol=1e-12)
    np.testing.assert_allclose(grid[:, 1], (weight * value) @ w, atol=1e-12)
    assert not grid[:, 2:].any()

    field, out = rng.standard_normal(len(kernel.points)), value.copy()
    transfer.gather_average(kernel.axes, *ranges, q["position"], weight, field, kernel.rings, out)
    np.testing.assert_allclose(out, np.where(weight == 0, value, w @ field), atol=1e-12)


@pytest.mark.parametrize("dim", MESHES)
def test_a_particle_that_is_not_a_number_is_seen(dim):
    """Four particles share a vector: what is wrong with one reaches the vertices of its cell, and only it."""
    kernel, q, cell, ranges, _ = scene(dim)
    bad = int(np.flatnonzero(cell == 8)[0])
    x, f = q["position"], q["F"]
    x[bad] = np.nan
    grid = np.zeros((len(kernel.points), 1 + 2 * dim))
    fields = (x, q["velocity"], None, q["mass"], q["volume"], q["stress"], None)
    transfer.particle_to_grid(kernel.axes, *ranges, *fields, kernel.rings, None, grid)
    ring = kernel.ring_vertex[kernel.ring_start[8] : kernel.ring_start[9]]
    assert np.isnan(grid[ring]).all() and np.isfinite(np.delete(grid, ring, axis=0)).all()

    v = np.ones_like(kernel.points)
    transfer.grid_to_particle(
        kernel.axes, *ranges, x, q["velocity"], None, f, kernel.rings, None, v, None, 0.0, 0.1
    )
    assert np.isnan(f[bad]).all() and np.isfinite(np.delete(f, bad, axis=0)).all()
