"""The time step and the grid update: loads, walls, stability, energy."""

import numpy as np
import pytest
from mesh_factory import gmsh_cube, graded_interval, rectangle

import fempm
from fempm.diagnostics import energies

SOLID = fempm.NeoHookean(density=2.0, young=100.0, poisson=0.3)


def slip_box(material, mesh=None, **options):
    mesh = mesh or rectangle(6, 6)
    body = fempm.Body(*fempm.fill_cells(mesh, 4), material)
    return fempm.Simulation(mesh, [body], [fempm.Wall("boundary", "slip")], **options)


@pytest.mark.parametrize("kind", ["slip", "sticky"])
@pytest.mark.parametrize("transfer", ["flip", "apic"])
def test_gravity_equals_a_constant_body_force(kind, transfer):
    """The same load given at vertices or at particles: equal to round-off, mirror vertices included."""
    mesh, load, states = rectangle(6, 6), [0.5, -9.81], []
    columns = {"body_force": lambda x, t: np.asfortranarray(0 * x + load)}
    for given in (
        {"gravity": load},
        {"body_force": load},
        {"body_force": lambda x, t: 0 * x + load},
        columns,
    ):
        body = fempm.Body(*fempm.fill_cells(mesh, 4), SOLID)
        scene = fempm.Simulation(mesh, [body], [fempm.Wall("boundary", kind)], transfer=transfer, **given)
        for _ in range(50):
            scene.step(1e-3)
        states.append(scene.gather("position"))
    assert np.abs(states[0] - states[1]).max() < 1e-13
    assert np.array_equal(states[1], states[2]) and np.array_equal(states[1], states[3])


def test_column_under_its_own_weight():
    """Uniaxial strain with damping (PIC) on a graded mesh: settles at u(x) of the exact static solution.

    Linear elasticity, P = E (F - 1), P' = rho g: u = rho g (L x - x^2 / 2) / E below a free top at L = 1.
    Bound: second order, (h / L)^2 with h = 0.1, over the largest displacement. The
    transfer damps by (k h)^2 / 4 a step, e^-25 in all.
    """
    mesh = graded_interval(0.1, 1.4)
    fempm.mark_boundary(mesh, "left", lambda x: np.isclose(x[0], 0))
    x, volume = fempm.fill_box([0.0], [1.0], 0.025)
    body = fempm.Body(x, volume, fempm.LinearElastic(density=1.0, young=1000.0))
    scene = fempm.Simulation(mesh, [body], [fempm.Wall("left")], gravity=[1.0], transfer="pic")
    for _ in range(4000):
        scene.step(scene.stable_step())
    exact = (x - x**2 / 2) / 1000
    assert np.abs(scene.gather("position") - x - exact).max() < 0.1**2 * exact.max()


def test_step_follows_the_state_of_a_stiffening_fluid():
    """A liquid compressed to J = 0.36 is 21 times faster than at rest: energy must not rise by over 1 %."""
    mesh = rectangle(12, 12)
    water = fempm.WeaklyCompressibleFluid(density=1.0, bulk=1.0, gamma=7.0)
    x, volume = fempm.fill_cells(mesh, 4, lambda x: np.all(np.abs(x - 0.5) < 0.25, axis=1))
    body = fempm.Body(x, volume, water, deformation_gradient=0.6 * np.eye(2))
    scene = fempm.Simulation(mesh, [body], [fempm.Wall("boundary", "slip")], transfer="flip")
    start = sum(energies(scene).values())
    for _ in range(200):
        scene.step(scene.stable_step())
        assert sum(energies(scene).values()) < 1.01 * start


LAWS = [law(1.0, 100.0, 0.3) for law in (fempm.NeoHookean, fempm.StVenantKirchhoff, fempm.Hencky)]
LAWS += [fempm.LinearElastic(1.0, 100.0, 0.3), fempm.WeaklyCompressibleFluid(1.0, 100.0)]


@pytest.mark.parametrize("law", LAWS, ids=lambda law: type(law).__name__)
def test_wave_speed_bounds_the_exact_one(law):
    """Against stretch sqrt(psi'' / rho) by finite differences, for stretches of 0.7 to 1.3 in 3D.

    Never below it; exact at rest, and not over 1.4 times it for equal stretches of 1 to 1.2, where only
    the stretch of single axes is not known. 1e-3: truncation and round-off of the differences.
    """

    def exact(stretches, step=1e-4):
        psi = law.energy(np.array([np.diag(stretches + [s * step, 0, 0]) for s in (-1, 0, 1)]))
        return stretches[0] * np.sqrt(max(psi[0] - 2 * psi[1] + psi[2], 0) / step**2 / law.density)

    for stretches in np.random.default_rng(0).uniform(0.7, 1.3, (50, 3)):
        assert law.wave_speed(stretches.max(), stretches.prod()) >= exact(stretches) * (1 - 1e-3)
    assert law.wave_speed() == pytest.approx(exact(np.ones(3)), rel=1e-3)
    if not isinstance(law, fempm.WeaklyCompressibleFluid):  # which is taken as no softer than at rest
        assert law.wave_speed(1.2, 1.2**3) <= 1.4 * exact(np.full(3, 1.2))


def test_flip_loses_energy_only_through_the_time_step():
    """A released block (thesis 2.3.5 in 2D): the loss falls with the step, to below a fifth at a tenth."""
    losses = []
    for cfl in (0.3, 0.03):
        mesh = rectangle(12, 12)
        x, volume = fempm.fill_cells(mesh, 4, lambda x: np.all(np.abs(x - 0.5) < 0.2, axis=1))
        body = fempm.Body(x, volume, SOLID, deformation_gradient=0.9 * np.eye(2))
        scene = fempm.Simulation(mesh, [body], transfer="flip", cfl=cfl)
        log = fempm.run(scene, 0.05, frames=1, progress=False).log
        losses.append(1 - log["total"][-1] / log["total"][0])
    assert 0 < losses[1] < losses[0] / 5


@pytest.mark.parametrize("mesh", [lambda: rectangle(16, 16), lambda: gmsh_cube(0.2)])
def test_default_correction_removes_the_mesh_scale_part(mesh):
    """300 iterations leave a hundredth of the plain integrals; what is left is smooth (see consistency)."""
    correction = slip_box(SOLID, mesh()).correction
    assert correction["solved"] and correction["iterations"] <= 300
    assert correction["after"] < 1e-2 * correction["before"]


@pytest.mark.parametrize(
    "options, message",
    [
        ({"body_force": lambda x, t: x[:, :1]}, "body_force of shape"),
        ({"body_force": [1.0]}, "body_force of shape"),
        ({"gravity": [0.0, 0.0, -9.81]}, "gravity .*give 2 finite numbers"),
        ({"gravity": [0.0, np.nan]}, "gravity .*give 2 finite numbers"),
        ({"support": -1.0}, "support -1.0: it must be positive"),
        ({"threads": 0}, "threads 0"),
    ],
)
def test_messages(options, message):
    with pytest.raises(ValueError, match=message):
        slip_box(SOLID, **options).step(1e-3)


def test_a_body_that_is_no_list():
    with pytest.raises(TypeError, match="give a list of Wall"):
        fempm.Simulation(rectangle(3, 3), [], fempm.Wall())
