"""Gas and solids: piston, walls, rest, leaks, momentum, added mass, energy."""

import warnings

import numpy as np
import pytest
from coupled_scenes import GAMMA, advance, block_in_blast, lagrangian_piston, piston, piston_path

import fempm
from coupling import Coupled, Flow, IdealGas, SlipWall

AIR = IdealGas(GAMMA)
PISTONS = {"heavy": (10.0, (2.0, 1.0), 2.0), "even": (1.0, (2.0, 1.0), 1.0), "light": (0.1, (10.0, 1.0), 0.5)}


def piston_error(kind, cells, **options):
    """Largest error of the place of a piston over its stroke; the scene."""
    mass, pressures, until = PISTONS[kind]
    exact = lagrangian_piston(mass, pressures, until)
    scene = piston(cells, mass, pressures, **options)
    path = piston_path(scene, until)
    error = np.abs(np.interp(path[:, 0], *exact.T) - path[:, 1]).max() / np.ptp(exact[:, 1])
    return error, scene


@pytest.mark.parametrize("kind, most", [("heavy", 0.005), ("even", 0.005), ("light", 0.03)])
def test_piston(kind, most):
    """The bounds are those that the issue asks for at 50 cells (the even one is three times as good)."""
    error, scene = piston_error(kind, 50)
    start = piston(50, *PISTONS[kind][:2]).summary()
    end = scene.summary()
    assert error < most
    assert abs(end["mass"] / start["mass"] - 1) < 1e-12
    assert abs(end["energy"] / start["energy"] - 1) < 0.01
    assert scene.repeated == 0


def test_piston_converges():
    """The light piston, twice as coarse: more than twice the error, the order that the issue's table has."""
    assert piston_error("light", 25)[0] > 2 * piston_error("light", 50)[0]


def test_energy_drift_halves_with_the_step():
    """What the total energy is off by is of first order in the step, beside the losses of the transfers.

    Those do not depend on it: 4e-7 of the total here, of which the piston's motion is 1e-2.
    """
    drift = []
    for dt in (2e-4, 1e-4, 5e-5):
        scene = piston(50, *PISTONS["even"][:2])
        start = scene.summary()["energy"]
        for _ in range(round(0.05 / dt)):
            scene.dt = dt
            scene.step(dt)
        drift.append(scene.summary()["energy"] / start - 1)
    assert np.abs(drift).max() < 2e-6
    np.testing.assert_allclose(np.diff(drift)[1] / np.diff(drift)[0], 0.5, atol=0.1)


@pytest.mark.parametrize(
    "options",
    [{"interface": "sharp"}, {"scheme": "euler"}, {"pair": "B2-B1"}],
    ids=lambda o: str([*o.values()][0]),
)
def test_piston_of_other_schemes(options):
    """The even piston at 30 cells; the interface is 0.1 cells off at most: 5 % of its stroke of 0.07."""
    error, scene = piston_error("even", 30, **options)
    start = piston(30, *PISTONS["even"][:2], **options).summary()
    assert error < 0.05
    assert abs(scene.summary()["mass"] / start["mass"] - 1) < 1e-12
    assert abs(scene.summary()["energy"] / start["energy"] - 1) < 0.01


def held(mesh, lower, upper, spacing, walls=()):
    """A body that is held in place, a block of lattice points."""
    body = fempm.Body(*fempm.fill_box(lower, upper, spacing), fempm.NeoHookean(1e4, 1e4), name="wall")
    return fempm.Simulation(mesh, [body], walls, condition=lambda x, v, t: 0 * v)


def test_solid_reflects_like_a_wall():
    """The Sod shock reflected by a solid at x = 0.8: exact states and speed (reference README) within 2 %."""
    errors = []
    for cells in (200, 400):
        mesh = fempm.interval_mesh(np.linspace(0, 1, cells + 1))
        solid = held(mesh, [0.8], [1.0], 0.25 / cells, [fempm.Wall("right")])

        def initial(x):
            left = x[:, 0] < 0.5
            return np.where(left, 1.0, 0.125), 0.0, np.where(left, 1.0, 0.1)

        scene = advance(Coupled(solid, AIR, initial, [SlipWall("boundary")]), 0.3 / 1.7521557 + 0.06)
        x, fields = mesh.points[:, 0], scene.vertex_fields()
        pressure, middle = fields["pressure"], 0.5 * (0.30313018 + 0.78038608)
        last = np.flatnonzero((pressure < middle) & (x < 0.79))[-1]
        front = np.interp(middle, pressure[last : last + 2], x[last : last + 2])
        behind = (x > 0.8 - 0.06 * 1.0101936 + 0.015) & (x < 0.79)
        errors.append(
            [
                abs((0.8 - front) / 0.06 / 1.0101936 - 1),
                abs(pressure[behind].mean() / 0.78038608 - 1),
                abs(fields["density"][behind].mean() / 0.50939532 - 1),
            ]
        )
    assert max(errors[1]) < 0.02
    assert np.all(np.array(errors[1]) < errors[0])


@pytest.mark.parametrize(
    "dim, options", [(1, {}), (2, {}), (2, {"pair": "B2-B1"}), (2, {"interface": "sharp"}), (3, {})]
)
def test_rest(dim, options):
    """A ragged body that half fills vertices in gas at rest: nothing moves, so no shape feels a force."""
    mesh = fempm.box_mesh((0.0,) * dim, (1.0,) * dim, 0.1 if dim < 3 else 0.2)
    x, volume = fempm.fill_box((0.2,) * dim, (0.9,) * dim, 0.04 if dim < 3 else 0.08)
    some = np.linalg.norm(x - 0.5, axis=1) < 0.3
    share = np.random.default_rng(1).uniform(0.3, 1.0, some.sum())
    body = fempm.Body(x[some], share * volume[some], fempm.NeoHookean(3.0, 50.0, 0.3 if dim > 1 else 0.0))
    scene = Coupled(
        fempm.Simulation(mesh, [body]), AIR, lambda x: (1.0, 0.0, 1.0), [SlipWall("boundary")], **options
    )
    for _ in range(100):
        scene.dt = scene.stable_step()
        scene.step(scene.dt)
    assert np.abs(scene.vertex_fields()["velocity"]).max() < 1e-10
    assert np.abs(scene.particles.velocity).max() < 1e-10
    assert 0 < scene.theta.min() or scene.theta.max() == 1


@pytest.mark.parametrize("shift", [0.0, 0.25, 0.5])
def test_wall_of_two_cells_is_tight(shift):
    """Gas beside a wall two cells thick: less than 1e-3 passes while sound crosses half the box."""
    h = 0.04
    mesh = fempm.box_mesh((0, 0), (1.0, 0.2), h)
    jitter = np.random.default_rng(0).uniform(-0.15, 0.15, mesh.points.shape) * h
    jitter[np.unique(mesh.exterior_facets)] = 0
    mesh = fempm.SimplexMesh(mesh.points + jitter, mesh.cells, boundaries=mesh.boundaries)
    middle = 0.5 + shift * h
    solid = held(mesh, [middle - h, 0], [middle + h, 0.2], h / 3, [fempm.Wall("boundary", "slip")])

    def initial(x):
        pressure = np.where(x[:, 0] < 0.5, 2.0, 1.0)
        return pressure, 0.0, pressure

    scene = Coupled(solid, AIR, initial, [SlipWall("boundary")])
    masses = []
    for until in (0.0, 0.5 / np.sqrt(GAMMA)):
        advance(scene, until)
        mass = scene.theta * scene.part.whole.volumes * scene.U[:, 0]
        masses.append(mass[mesh.points[:, 0] < middle].sum())
    assert abs(masses[1] / masses[0] - 1) < 1e-3


@pytest.mark.parametrize("dim, h, until", [(2, 0.05, 0.02), (3, 0.125, 0.005)])
def test_momentum(dim, h, until):
    """Gas pushes a body off its centre: until waves reach the walls, the sum is zero to 1e-10."""
    size = {2: 2.0, 3: 1.5}[dim]
    mesh = fempm.box_mesh((0.0,) * dim, (size,) * dim, h)
    body = fempm.Body(
        *fempm.fill_box((0.52 * size,) * dim, (0.52 * size + 0.18,) * dim, h / 2),
        fempm.NeoHookean(3.0, 50.0, 0.3),
    )

    def initial(x):
        return 1.0, 0.0, np.where(np.linalg.norm(x - 0.48 * size, axis=1) < 0.15, 3.0, 1.0)

    scene = Coupled(fempm.Simulation(mesh, [body]), AIR, initial, [SlipWall("boundary")], cfl=0.1)
    scene.solid.cfl = 0.1
    scene.stages.system.ksp.setTolerances(rtol=1e-14)  # the implicit pressure is felt everywhere, a little
    advance(scene, until)
    end, p = scene.summary(), scene.particles
    moving = np.linalg.norm(scene.U[:, 1:-1], axis=1) @ (scene.theta * scene.part.whole.volumes)
    moving += p.mass @ np.linalg.norm(p.velocity, axis=1)
    names = [f"momentum_{a}" for a in "xyz"[:dim]]
    assert min(abs(end[f"solid_{n}"]) for n in names) > 0.01 * moving
    assert max(abs(end[n]) for n in names) < 1e-10 * moving


@pytest.mark.parametrize("ratio, young", [(0.01, 1.0), (1e4, 1e4)])
def test_added_mass(ratio, young):
    """From a hundredth of the gas's density to ten thousand times: stable, and not iterated."""
    scene = block_in_blast(density=ratio, young=young)
    start = scene.summary()
    advance(scene, 0.2)
    end, speed = scene.summary(), np.abs(scene.particles.velocity).max()
    assert abs(end["mass"] / start["mass"] - 1) < 1e-12
    assert abs(end["energy"] / start["energy"] - 1) < 0.05
    # no faster than gas of 4 Pa and 3 kg / m^3 could expand into a vacuum
    assert speed < 2 / (GAMMA - 1) * np.sqrt(GAMMA * 4 / 3)
    if ratio > 1:  # what a pressure of at most 4 Pa does to 2 kg / m in 0.2 s, and that it does something
        assert 1e-6 < speed < 0.2 * 4 * 0.3 / (ratio * 0.06) * 1.5


def test_plastic_and_elastic_body():
    """A blast deforms one for good and heats it; the other springs back. Energy is kept within 2 %."""
    bent = {}
    for name, material in (
        ("elastic", fempm.NeoHookean(3.0, 100.0, 0.3)),
        ("plastic", fempm.VonMises(3.0, 100.0, 0.3, yield_stress=0.1)),
    ):
        scene, shape = block_in_blast(material=material), []
        start = scene.summary()["energy"]
        for until in (0.0, *np.linspace(0.5, 0.7, 11)):
            spread = advance(scene, until).particles.position.std(axis=0)
            shape.append(spread[0] / spread[1])
        end = scene.summary()
        assert abs(end["energy"] / start - 1) < 0.02, name
        assert (end.get("dissipated", 0.0) > 1e-3) == (name == "plastic")
        bent[name] = abs(np.mean(shape[1:]) / shape[0] - 1)
    assert bent["plastic"] > 0.05 and bent["elastic"] < 0.1 * bent["plastic"]


def test_gravity_on_both():
    """A block as heavy as the gas around it neither sinks nor rises; one that is heavier falls faster."""
    speeds = []
    for density in (1.0, 4.0):
        mesh = fempm.box_mesh((0, 0), (1, 1), 0.1)
        body = fempm.Body(
            *fempm.fill_box((0.35, 0.35), (0.65, 0.65), 0.05), fempm.NeoHookean(density, 50.0, 0.3)
        )
        solid = fempm.Simulation(mesh, [body], gravity=(0, -0.5))

        def initial(x):
            return 1.0, 0.0, 2.0 + 0.5 * (0.5 - x[:, 1])

        scene = advance(Coupled(solid, AIR, initial, [SlipWall("boundary")]), 0.2)
        speeds.append(scene.particles.velocity[:, 1].mean())
    assert abs(speeds[0]) < 0.1 * 0.5 * 0.2
    # free fall with buoyancy, g (1 - 1 / 4) t, slowed by the gas that makes room
    assert -0.5 * 0.75 * 0.2 < speeds[1] < -0.4 * 0.5 * 0.75 * 0.2


def test_pieces_lighter_than_a_cell_are_reported():
    """A body too thin to close any vertex lets gas through: a warning; a thicker one gives none."""
    mesh = fempm.box_mesh((0, 0), (1, 1), 0.1)

    def scene(thickness):
        body = fempm.Body(
            *fempm.fill_box((0.45, 0), (0.45 + thickness, 1), 0.02), fempm.NeoHookean(3.0, 50.0)
        )
        return Coupled(fempm.Simulation(mesh, [body]), AIR, lambda x: (1.0, 0.0, 1.0), [SlipWall("boundary")])

    with pytest.warns(UserWarning, match="'body' closes no vertex"):
        scene(0.04)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        scene(0.3)


def test_gas_alone_pays_nothing():
    """No arrays of solids, no particles, and the steps of `Flow` are what they were."""
    gas = Flow(fempm.box_mesh((0, 0), (1, 1), 0.2), AIR, lambda x: (1.0, 0.0, 1.0), [SlipWall("boundary")])
    assert gas.particles is None and gas.stages.openness is None
    assert gas.stages.volumes is gas.part.space.volumes
    assert not hasattr(gas.stages, "theta")


@pytest.mark.parametrize(
    "change, message",
    [
        ({"openness": "half"}, "openness 'half'"),
        ({"interface": "soft"}, "interface 'soft'"),
        ({"ghost_modulus": 1.0}, "ghost_modulus 1.0"),
        ({"gravity": (0.0, -1.0)}, "give one"),
        ({"interface": "sharp", "pair": "B2-B1"}, "with B1-B0"),
    ],
)
def test_errors(change, message):
    with pytest.raises(ValueError, match=message):
        block_in_blast(h=0.2, **change)
