"""F-bar against volumetric locking: a rigid strip footing on undrained clay, N_c = 2 + pi (Prandtl)."""

import numpy as np
import pytest
from mesh_factory import cube, rectangle

import fempm
from fempm.f_bar import average_jacobian

STRENGTH, WIDTH, SETTLEMENT = 1.0, 1.0, 0.02


def footing(n, f_bar):
    """Pressure over strength under half a rough footing of half width 0.5, h = 1 / n, once it has settled.

    Von Mises in plane strain yields at the shear stress STRENGTH = yield stress / sqrt(3). The load is the
    momentum that the prescribed velocity of the footing's vertices takes, averaged over the last tenth.
    """
    h, depth = WIDTH / n, 1.2 * WIDTH
    ny = round(depth / h)
    clay = fempm.VonMises(1.0, 1000 * STRENGTH, 0.499, np.sqrt(3) * STRENGTH)
    shear_speed = np.sqrt(1000 * STRENGTH / (2 * 1.499))
    mesh = rectangle(2 * n, ny + 1, 2.0, (ny + 1) * h, jitter=0.0)
    surface = ny * h
    fempm.mark_boundary(mesh, "floor", lambda x: x[1] < 1e-9)
    fempm.mark_boundary(mesh, "sides", lambda x: (x[0] < 1e-9) | (x[0] > 2 - 1e-9))
    position, volume = fempm.fill_box((0, 0), (2, surface), h / 2)
    until = 12 * depth / shear_speed
    load = []

    def push(points, velocity, time):
        under = (points[:, 0] < WIDTH / 2 + 1e-9) & (points[:, 1] > surface - 1e-9)
        vertices = scene.vertices[: scene.num_vertices]
        mass = scene.grids[0, vertices[vertices < len(mesh.points)], 0]
        out = velocity.copy()
        out[under] = [0.0, -SETTLEMENT / until * min(1.0, time / (0.1 * until))]
        load.append(mass[under] @ (velocity[under, 1] - out[under, 1]) / scene.dt)
        return out

    scene = fempm.Simulation(
        mesh,
        [fempm.Body(position, volume, clay, f_bar=f_bar)],
        [fempm.Wall("floor"), fempm.Wall("sides", "slip")],
        body_force=lambda x, t: -0.5 * shear_speed / depth * scene.particles.velocity,
        condition=push,
        transfer="flip",
        cfl=0.5,
    )
    while scene.time < until:
        scene.dt = scene.stable_step()
        scene.step(scene.dt)
    return np.mean(load[-len(load) // 10 :]) / (WIDTH / 2) / STRENGTH


@pytest.mark.slow
def test_strip_footing():
    """Within 5 % of 5.14 as asked; without F-bar the nearly incompressible clay locks at 7 or more."""
    assert footing(12, True) == pytest.approx(2 + np.pi, rel=0.05)
    assert footing(12, False) >= 7.0


@pytest.mark.parametrize("build, d", [(lambda: rectangle(8, 8), 2), (lambda: cube(4), 3)])
def test_average(build, d):
    """Against dense sums of the kernel's weights; uniform changes stay, and so do other bodies."""
    mesh = build()
    rng = np.random.default_rng(1)
    solid = fempm.NeoHookean(1.0, 10.0, 0.3)
    boxes = [fempm.fill_box(np.full(d, a), np.full(d, b), 0.07) for a, b in ((0.1, 0.5), (0.6, 0.9))]
    stretches = [np.eye(d) * rng.uniform(0.9, 1.1, (len(v), 1, 1)) for _, v in boxes]
    bodies = [
        fempm.Body(*box, solid, deformation_gradient=f, f_bar=flag)
        for box, f, flag in zip(boxes, stretches, (True, False), strict=True)
    ]
    scene = fempm.Simulation(mesh, bodies)
    p, first = scene.particles, scene.particles.ranges[0]
    before = p.deformation_gradient.copy()
    weights = np.zeros((len(p), len(mesh.points)))
    for i in range(first.stop):
        ring, w, _ = fempm.kernel.evaluate(scene.kernel, p.position[i], p.cell[i])
        weights[i, ring] = w
    jacobian = np.linalg.det(before)
    total = p.volume @ weights
    vertex = np.divide((p.volume * jacobian) @ weights, total, where=total > 0, out=np.ones(len(total)))
    average_jacobian(scene, scene.f_bar)
    np.testing.assert_allclose(
        np.linalg.det(p.deformation_gradient)[first], (weights @ vertex)[first], rtol=1e-12
    )
    np.testing.assert_array_equal(p.deformation_gradient[first.stop :], before[first.stop :])
    p.deformation_gradient[:] = 1.1 * np.eye(d)
    average_jacobian(scene, scene.f_bar)
    np.testing.assert_allclose(
        p.deformation_gradient, np.tile(1.1 * np.eye(d), (len(p), 1, 1)), rtol=1e-13, atol=1e-15
    )
