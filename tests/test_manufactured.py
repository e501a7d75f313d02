"""Axis-aligned manufactured solution, neo-Hookean, in slip walls on all sides (reference README).

u_i = G sin(pi X_i) sin(c pi t + phi_i) with G = 0.05, E = 1e4, nu = 0.3, rho = 1000 over one period
2 / c; 3 particles per cell and direction. Error: largest RMS displacement error over G.
"""

import numpy as np
import pytest
from mesh_factory import cube, gmsh_cube, rectangle

import fempm

AMPLITUDE, YOUNG, POISSON, DENSITY = 0.05, 1e4, 0.3, 1000.0


def error(mesh, n, gradient):
    """Largest RMS displacement error over the amplitude, on a mesh of size 1 / n."""
    material = fempm.NeoHookean(DENSITY, YOUNG, POISSON)
    lam, mu = material.lame
    c = np.sqrt(YOUNG / DENSITY)
    phase = np.array([0, np.pi, np.pi])[: mesh.dim]
    reference, volume = fempm.fill_box(np.zeros(mesh.dim), np.ones(mesh.dim), 1 / (3 * n))
    sine, cosine = np.sin(np.pi * reference), np.cos(np.pi * reference)

    def displacement(t):
        return AMPLITUDE * sine * np.sin(c * np.pi * t + phase)

    def body_force(x, t):
        stretch = 1 + np.pi * AMPLITUDE * cosine * np.sin(c * np.pi * t + phase)
        log_j = np.log(stretch.prod(axis=1))[:, None]
        bracket = lam * (1 - log_j) / stretch**2 + mu * (1 + 1 / stretch**2) - YOUNG
        return (np.pi**2 * displacement(t) / DENSITY * bracket)[scene.particles.id]

    start = c * np.pi * AMPLITUDE * sine * np.cos(phase)
    body = fempm.Body(reference, volume, material, lambda x: start)
    wall = fempm.Wall("boundary", "slip")
    scene = fempm.Simulation(
        mesh, [body], [wall], body_force=body_force, transfer="flip", gradient=gradient, cfl=0.2
    )
    steps = int(np.ceil(2 / c / scene.stable_step()))
    worst = 0.0
    for _ in range(steps):
        scene.step(2 / c / steps)
        off = scene.gather("position") - reference - displacement(scene.time)
        worst = max(worst, np.sqrt(np.mean(np.sum(off**2, axis=1))))
    return worst / AMPLITUDE


def orders(sizes, errors):
    """Order between successive meshes of 1 / h = sizes."""
    return np.log(np.divide(errors[:-1], errors[1:])) / np.log(np.divide(sizes[1:], sizes[:-1]))


@pytest.mark.slow
@pytest.mark.parametrize("jitter, wanted", [(0.0, 1.8), (0.2, 1.2)])
def test_two_dimensions(jitter, wanted):
    sizes = [8, 16, 32]
    errors = [error(rectangle(n, n, jitter=jitter), n, "consistent") for n in sizes]
    assert orders(sizes, errors).min() >= wanted
    if jitter:  # the plain gradient stalls between the two finer meshes
        plain = [error(rectangle(n, n, jitter=jitter), n, "plain") for n in sizes[1:]]
        assert orders(sizes[1:], plain)[0] < 0.8 and plain[1] > 3 * errors[2]


@pytest.mark.slow
@pytest.mark.parametrize(
    "build, sizes, wanted", [(cube, [4, 8], 1.8), (lambda n: gmsh_cube(1 / n), [4, 8, 12], 1.2)]
)
def test_three_dimensions(build, sizes, wanted):
    errors = [error(build(n), n, "consistent") for n in sizes]
    assert orders(sizes, errors).min() >= wanted
    assert error(build(sizes[-1]), sizes[-1], "plain") > errors[-1]
