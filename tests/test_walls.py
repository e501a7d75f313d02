"""Walls: mirror vertices, folding, moving walls, and modes of bodies that fill a disk or a ball."""

import numpy as np
import pytest
from mesh_factory import MESHES, rectangle

import fempm
from fempm.kernel import evaluate_many
from fempm.walls import Wall, wall_layer

# first zeros of J1 and of the spherical j1 (no displacement at r = 1), of J2 (no shear at r = 1)
ROOT = {(2, "sticky"): 3.8317059702, (3, "sticky"): 4.4934094579, (2, "slip"): 5.1356223018}


def test_mirrors_of_a_flat_wall_are_exact_images():
    """Reflection in x = 0 of all neighbours of wall vertices; the same with a second wall in the corner."""
    mesh = rectangle(6, 6)
    fempm.mark_boundary(mesh, "left", lambda x: np.isclose(x[0], 0))
    fempm.mark_boundary(mesh, "bottom", lambda x: np.isclose(x[1], 0))
    layer = wall_layer(mesh, [Wall("left", "slip")])
    assert np.allclose(layer.points, mesh.points[layer.owner] * [-1, 1], atol=1e-14)
    assert np.allclose(layer.fold, np.diag([-1, 1]))

    mesh = rectangle(6, 6, jitter=0)  # its corner at the origin has an inner neighbour
    fempm.mark_boundary(mesh, "left", lambda x: np.isclose(x[0], 0))
    fempm.mark_boundary(mesh, "bottom", lambda x: np.isclose(x[1], 0))
    layer = wall_layer(mesh, [Wall("left", "slip"), Wall("bottom", "sticky")])
    signs = layer.points / np.where(mesh.points[layer.owner] == 0, 1, mesh.points[layer.owner])
    assert np.allclose(np.abs(signs[mesh.points[layer.owner] != 0]), 1)
    both = np.all(layer.points < -1e-12, axis=1)
    assert both.any() and np.allclose(layer.fold[both], np.diag([1, -1]))


def test_mirrors_of_a_curved_wall_lie_outside():
    """On a disk of radius 1: every image at distance 2 - r of the centre, to the sagitta h^2 / 8."""
    mesh = fempm.read_mesh(MESHES / "disk.msh")
    layer = wall_layer(mesh, [Wall("wall")])
    inside = np.linalg.norm(mesh.points[layer.owner], axis=1)
    outside = np.linalg.norm(layer.points, axis=1)
    assert len(layer.incomplete) == 0
    assert np.abs(inside + outside - 2).max() < 0.05**2
    aligned = np.einsum("ga,ga->g", layer.points, mesh.points[layer.owner]) / inside / outside
    assert aligned.min() > 1 - 1e-4


def test_no_images_beyond_a_notch():
    """At the re-entrant corner of an L the vertices across the corner have no image in the fluid."""
    mesh = rectangle(8, 8)
    centres = mesh.points[mesh.cells].mean(axis=1)
    cells = mesh.cells[~np.all(centres > 0.5, axis=1)]
    used, cells = np.unique(cells, return_inverse=True)
    corner = fempm.SimplexMesh(mesh.points[used], cells.reshape(-1, 3))
    layer = wall_layer(corner, [Wall("boundary", "slip")])
    outside = np.any((layer.points < 0) | (layer.points > 1), axis=1) | np.all(layer.points > 0.4, axis=1)
    assert outside.all()


@pytest.mark.parametrize("kind", ["sticky", "slip"])
def test_velocity_on_a_flat_wall(kind):
    """The interpolated velocity on the wall is the wall's: all of it, or its normal part, to round-off."""
    mesh = rectangle(8, 8)
    speed = np.array([0.3, -0.2])
    body = fempm.Body(*fempm.fill_cells(mesh, 4), fempm.NeoHookean(1.0, 10.0, 0.3), velocity=[1.0, 2.0])
    scene = fempm.Simulation(mesh, [body], [Wall("boundary", kind, velocity=speed)])
    scene.step(1e-3)
    y = np.linspace(0.13, 0.87, 50)
    x = np.column_stack([np.zeros(50), y])
    cell = fempm.locate.find_cells(mesh, x)
    w, _ = evaluate_many(scene.kernel, x, cell)
    for p in range(len(x)):
        ring = slice(scene.kernel.ring_start[cell[p]], scene.kernel.ring_start[cell[p] + 1])
        vertices = scene.kernel.ring_vertex[ring]
        off = w[p, : len(vertices)] @ scene.velocity[vertices] - speed
        assert np.abs(off if kind == "sticky" else off[:1]).max() < 1e-12


def test_body_carried_by_moving_walls():
    """A body that moves with its container stays rigid: velocity and F = I to round-off."""
    mesh = rectangle(8, 8)
    speed = np.array([0.02, 0.01])
    inner = lambda x: np.all(np.abs(x - 0.5) < 0.45, axis=1)  # noqa: E731
    body = fempm.Body(*fempm.fill_cells(mesh, 4, inner), fempm.NeoHookean(1.0, 10.0, 0.3), velocity=speed)
    scene = fempm.Simulation(mesh, [body], [Wall("boundary", velocity=lambda t: speed)], transfer="flip")
    for _ in range(20):
        scene.step(1e-3)
    assert np.abs(scene.particles.velocity - speed).max() < 1e-12
    assert np.abs(scene.particles.deformation_gradient - np.eye(2)).max() < 1e-12


def mode_error(mesh, mode, wall, per_cell):
    """RMS displacement error over a quarter period of an exact mode, relative to its amplitude."""
    material = fempm.LinearElastic(density=1.0, young=1.0, poisson=0.3)
    lam, mu = material.lame
    k = ROOT[mesh.dim, wall if mode == "torsion" else "sticky"]
    omega = k * np.sqrt(lam + 2 * mu if mode == "radial" else mu)
    x, volume = fempm.fill_cells(mesh, per_cell)
    r = np.linalg.norm(x, axis=1)
    if mesh.dim == 3:
        radial = (np.sin(k * r) - k * r * np.cos(k * r)) / (k * r) ** 2
    else:  # J1 by its integral
        s = (np.arange(400) + 0.5) * np.pi / 400
        radial = np.cos(s - k * r[:, None] * np.sin(s)).mean(axis=1)
    turn = np.column_stack([-x[:, 1], x[:, 0], *np.zeros((mesh.dim - 2, len(x)))])
    shape = (x if mode == "radial" else turn) * (radial / r)[:, None]
    size = 1e-3
    body = fempm.Body(x, volume, material, lambda x: size * omega * shape)
    scene = fempm.Simulation(mesh, [body], [Wall("wall", wall)], transfer="flip", cfl=0.2)
    steps = int(np.ceil(np.pi / 2 / omega / scene.stable_step()))
    for _ in range(steps):
        scene.step(np.pi / 2 / omega / steps)
    off = scene.gather("position") - x - size * shape
    assert scene.wall_hits == 0
    return np.linalg.norm(off) / np.linalg.norm(size * shape), k


@pytest.mark.parametrize(
    "mode, wall", [("radial", "sticky"), ("radial", "slip"), ("torsion", "sticky"), ("torsion", "slip")]
)
def test_modes_of_a_disk(mode, wall):
    """Exact modes with Bessel functions: second order in h although the wall is a polygon."""
    sizes = [0.2, 0.1, 0.05]
    meshes = [fempm.read_mesh(MESHES / "disk.geo", h=h) for h in sizes]
    check_convergence(sizes, [mode_error(mesh, mode, wall, 4) for mesh in meshes])


def check_convergence(sizes, results):
    """Order above 1.5 at last, and an error of 0.3 (k h)^2 pi / 2 at most.

    A lumped mass lowers frequencies by (k h)^2 / 6 to (k h)^2 / 4 on uniform meshes, which shifts the
    phase by that times pi / 2 after a quarter period; walls must not add to it noticeably.
    """
    errors, (k, *_) = zip(*results, strict=True)
    assert np.log(errors[-2] / errors[-1]) / np.log(sizes[-2] / sizes[-1]) > 1.5
    assert errors[-1] < 0.3 * (k * sizes[-1]) ** 2 * np.pi / 2


@pytest.mark.slow
@pytest.mark.parametrize("mode, wall", [("radial", "slip"), ("torsion", "sticky")])
def test_modes_of_a_ball(mode, wall):
    """The same with spherical Bessel functions."""

    def ball(h):
        mesh = fempm.read_mesh(MESHES / "sphere.geo", h=h / 2)  # of radius 0.5
        return fempm.SimplexMesh(2 * mesh.points, mesh.cells, {"wall": mesh.facets("wall")})

    sizes = [0.4, 0.2]
    check_convergence(sizes, [mode_error(ball(h), mode, wall, 8) for h in sizes])
