"""Small coupled scenes, and a Lagrangian solution of the piston between two gases."""

import numpy as np

import fempm
from coupling import Coupled, IdealGas, SlipWall

GAMMA = 1.4


def advance(scene, until):
    """Step to a time; returns the scene."""
    while scene.time < until * (1 - 1e-12):
        scene.dt = min(scene.stable_step(), until - scene.time)
        scene.step(scene.dt)
    return scene


def piston(cells, mass, pressures, young=1e3, **options):
    """Tube [0, 1] with an elastic piston of a mass per area in [0.4, 0.5] between two gases at rest."""
    mesh = fempm.interval_mesh(np.linspace(0, 1, cells + 1))
    x, volume = fempm.fill_box([0.4], [0.5], 0.25 / cells)
    body = fempm.Body(x, volume, fempm.NeoHookean(mass / 0.1, young), name="piston")
    left, right = pressures

    def initial(x):
        return 1.0, 0.0, np.where(x[:, 0] < 0.45, left, right)

    return Coupled(
        fempm.Simulation(mesh, [body]), IdealGas(GAMMA), initial, [SlipWall("boundary")], **options
    )


def centre(scene):
    """(d,) centre of mass of the solid."""
    p = scene.particles
    return scene.ranks.sum(p.mass @ p.position) / scene.ranks.sum(p.mass.sum())


def piston_path(scene, until):
    """(k, 2) times and places of the piston's left face."""
    path = []
    while scene.time < until * (1 - 1e-12):
        scene.dt = min(scene.stable_step(), until - scene.time)
        scene.step(scene.dt)
        path.append((scene.time, centre(scene)[0] - 0.05))
    return np.array(path)


def lagrangian_piston(mass, pressures, until, cells=400):
    """(k, 2) times and places of a rigid piston's left face, two gases in mass coordinates.

    Staggered in space and time, with the artificial viscosity of von Neumann and Richtmyer (1950).
    """
    sides = []
    for low, high, pressure in ((0.0, 0.4, pressures[0]), (0.5, 1.0, pressures[1])):
        x = np.linspace(low, high, cells + 1)
        energy = np.full(cells, pressure / (GAMMA - 1))
        sides.append([x, np.full(cells, (high - low) / cells), energy, np.zeros(cells + 1)])
    speed, time, path = 0.0, 0.0, [(0.0, 0.4)]
    while time < until:
        pushes, limit = [], until - time + 1e-15
        for x, m, e, u in sides:
            volume = np.diff(x) / m
            p, jump = (GAMMA - 1) * e / volume, np.diff(u)
            sound = np.sqrt(GAMMA * p * volume)
            q = np.where(jump < 0, (2 * jump**2 + 0.3 * sound * abs(jump)) / volume, 0)
            limit = min(limit, 0.25 * np.min(np.diff(x) / sound))
            pushes.append((p, q, volume))
        total = [p + q for p, q, _ in pushes]
        inert = mass + 0.5 * sides[0][1][-1] + 0.5 * sides[1][1][0]
        speed += limit * (total[0][-1] - total[1][0]) / inert
        for k, ((x, m, e, u), (p, q, volume)) in enumerate(zip(sides, pushes, strict=True)):
            u[1:-1] -= limit * np.diff(total[k]) / (0.5 * (m[1:] + m[:-1]))
            u[-1 if k == 0 else 0] = speed
            x += limit * u
            now = np.diff(x) / m
            change = now - volume
            e[:] = (e - (0.5 * p + q) * change) / (1 + 0.5 * (GAMMA - 1) * change / now)
        time += limit
        path.append((time, sides[0][0][-1]))
    return np.array(path)


def block_in_blast(dim=2, h=0.05, density=3.0, young=50.0, material=None, transfer="flip", **options):
    """A block in a closed box, gas at rest, denser and under pressure in front of it."""
    mesh = fempm.box_mesh((0.0,) * dim, (1.0, 0.6, 0.6)[:dim], h)
    x, volume = fempm.fill_box([0.4] + [0.15] * (dim - 1), [0.6] + [0.45] * (dim - 1), h / 2)
    material = material or fempm.NeoHookean(density, young, 0.3)
    solid = fempm.Simulation(mesh, [fempm.Body(x, volume, material, name="block")], transfer=transfer)

    def initial(x):
        inside = x[:, 0] < 0.25
        return np.where(inside, 3.0, 1.0), 0.0, np.where(inside, 4.0, 1.0)

    return Coupled(solid, IdealGas(GAMMA), initial, [SlipWall("boundary")], **options)
