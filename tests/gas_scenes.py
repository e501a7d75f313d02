"""Gas scenes that tests share: meshes with named sides, closed boxes, totals and errors."""

from pathlib import Path

import numpy as np
from mesh_factory import cube, gmsh_cube, rectangle

import fempm
from coupling import Flow, IdealGas, Outflow, SlipWall

AIR = IdealGas(1.4)
DATA = Path(__file__).parent / "data"
PAIRS = ("B1-B0", "B2-B1")
SCHEMES = ("imex", "euler")
SIDES = (("left", "right"), ("bottom", "top"), ("front", "back"))


def named_sides(mesh):
    """The mesh with its lower and upper sides named, for boxes with sides along the axes."""
    low, high = mesh.points.min(axis=0), mesh.points.max(axis=0)
    for k in range(mesh.dim):
        for name, at in zip(SIDES[k], (low[k], high[k])):
            fempm.mark_boundary(mesh, name, lambda x, k=k, at=at: np.abs(x[k] - at) < 1e-9)
    return mesh


def uneven_interval(n, length=1.0):
    """n cells whose lengths differ by up to a factor of two, at random but always the same."""
    h = np.random.default_rng(1).uniform(1, 2, n)
    return fempm.interval_mesh(length * np.append(0, np.cumsum(h)) / h.sum())


def box(d, n):
    """Irregular mesh of the unit box with about n cells along an edge, its sides named."""
    if d == 1:
        return uneven_interval(n)
    if d == 2:
        return named_sides(rectangle(n, n))
    return named_sides(gmsh_cube(1 / n))


def even_box(d, n):
    """Uniform mesh of the unit box, its sides named."""
    if d == 1:
        return fempm.interval_mesh(np.linspace(0, 1, n + 1))
    return named_sides(rectangle(n, n, jitter=0) if d == 2 else cube(n))


def walls(d):
    """Slip walls on all sides of a box."""
    return [SlipWall(name) for pair in SIDES[:d] for name in pair]


def blast(x):
    """A ball of dense gas at twice the pressure off the centre, moving, in gas at rest."""
    inside = np.linalg.norm(x - 0.4, axis=1) < 0.25
    velocity = np.where(inside[:, None], 0.3, 0.0) * np.ones_like(x)
    return np.where(inside, 1.0, 0.5), velocity, np.where(inside, 1.0, 0.5)


def at_rest(density=1.0, pressure=1.0):
    """Initial state of uniform gas at rest."""
    return lambda x: (density, 0.0, pressure)


def jump(left, right, at=0.5):
    """Initial state of a shock tube: (density, velocity, pressure) on both sides of x = at."""

    def initial(x):
        density, speed, pressure = (np.where(x[:, 0] < at, a, b) for a, b in zip(left, right))
        velocity = np.zeros_like(x)
        velocity[:, 0] = speed
        return density, velocity, pressure

    return initial


def sod_tube(cells, **options):
    """Sod's tube on a uniform mesh, open at both ends."""
    mesh = fempm.interval_mesh(np.linspace(0, 1, cells + 1))
    return Flow(mesh, AIR, jump((1, 0, 1), (0.125, 0, 0.1)), [Outflow("left"), Outflow("right")], **options)


def advance(gas, steps=None, until=None):
    """Stable steps, a number of them or up to a time."""
    last = gas.steps + (steps or 10**9)
    while gas.steps < last and (until is None or gas.time < until * (1 - 1e-12)):
        gas.dt = gas.stable_step() if until is None else min(gas.stable_step(), until - gas.time)
        gas.step(gas.dt)
    return gas


def totals(gas):
    """Mass, momentum and energy (d + 2,)."""
    return gas.part.total(gas.U)


def positive(gas):
    """Whether density and pressure are finite and positive everywhere."""
    fields = gas.vertex_fields()
    return all(np.isfinite(fields[k]).all() and fields[k].min() > 0 for k in ("density", "pressure"))


def run(gas, until, **options):
    """Run a gas to a time; returns the log of all steps, whose `iterations` are the most of a step."""
    return fempm.run(gas, until, frames=1, log_every=1, progress=False, **options).log


def table(name):
    """Columns of a file of reference data, tests/data/<name>.csv."""
    return np.loadtxt(DATA / f"{name}.csv", delimiter=",", skiprows=1).T


def order(cells, errors):
    """Order of convergence, fitted to errors at numbers of cells."""
    return -np.polyfit(np.log(cells), np.log(errors), 1)[0]
