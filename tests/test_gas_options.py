"""Gas: limiters by name, equations of state of one's own, and that who needs no gas pays for none."""

import subprocess
from dataclasses import dataclass

import numpy as np
import pytest
from gas_scenes import AIR, PAIRS, run, sod_tube
from small_scene import command

import fempm
from coupling import Flow, Outflow
from coupling.limiters import NAMES
from coupling.riemann import State, solution

# Mean density error of Sod's tube at 400 cells: the numbers of the design note's prototype (2.26, 2.19,
# 2.01, 2.5e-3 for MC, Koren, superbee, WENO; van Leer 2.3e-3) and 10 % for another start, the project's
# bound for the default, and for first order what Kwatra's own scheme has, 5.1e-3, and a fifth.
ERRORS = {
    "first_order": 6.1e-3,
    "van_leer": 2.53e-3,
    "mc": 2.49e-3,
    "koren": 2.41e-3,
    "superbee": 2.2e-3,
    "weno": 2.75e-3,
    "contact": 2.1e-3,
}


def test_all_limiters_are_tested():
    assert set(NAMES) == set(ERRORS)


@pytest.mark.parametrize("name", ERRORS)
def test_limiters(name):
    """Each runs Sod's tube with the error given above, without repeated steps; the first one is worst."""
    gas = sod_tube(400, limiter=name)
    run(gas, 0.15)
    x = gas.mesh.points[:, 0]
    wanted = solution(State(1, 0, 1), State(0.125, 0, 0.1), (x - 0.5) / 0.15)[0]
    error = np.abs(gas.vertex_fields()["density"] - wanted).mean()
    print(name, error)
    assert error <= ERRORS[name]
    assert gas.repeated == 0
    if name == "first_order":
        assert error > 3e-3


@dataclass(frozen=True)
class StiffenedGas:
    """p = (gamma - 1) rho e - gamma p_inf: water, nearly."""

    gamma: float = 4.4
    stiffness: float = 6e8

    def pressure(self, density, internal_energy):
        return (self.gamma - 1) * internal_energy - self.gamma * self.stiffness

    def internal_energy(self, density, pressure):
        return (pressure + self.gamma * self.stiffness) / (self.gamma - 1)

    def bulk_modulus(self, density, pressure):
        return self.gamma * (pressure + self.stiffness)

    def heating(self, density, pressure):
        return self.gamma - 1


@pytest.mark.parametrize("pair", PAIRS)
@pytest.mark.parametrize("eos, density, pressure", [(StiffenedGas(), 1000.0, 1e5), (AIR, 1.2, 1e5)])
def test_speed_of_sound(eos, density, pressure, pair):
    """A weak pulse that runs right goes 0.4 m in 0.4 m / c, at acoustic CFL 1; its height stays.

    Dispersion of second order: the pulse is ten cells wide, k h = 0.16, (k h)^2 / 6 = 0.4 % of the speed, and
    damping takes some percent of its height.
    """
    sound = np.sqrt(eos.bulk_modulus(density, pressure) / density)
    height, cells = 1e-4 * eos.bulk_modulus(density, pressure), 200

    def initial(x):
        p = height * np.exp(-(((x[:, 0] - 0.3) / 0.05) ** 2))
        return density + p / sound**2, (p / (density * sound))[:, None], pressure + p

    mesh = fempm.interval_mesh(np.linspace(0, 1, cells + 1))
    gas = Flow(mesh, eos, initial, [Outflow("left"), Outflow("right")], pair=pair)
    log = run(gas, 0.4 / sound, dt=1 / cells / sound)
    p = gas.vertex_fields()["pressure"] - pressure
    centre = p @ mesh.points[:, 0] / p.sum()
    print(pair, centre, p.max() / height, log["iterations"].max())
    assert centre == pytest.approx(0.7, abs=0.004 * 0.4 + 0.001)
    assert 0.9 < p.max() / height < 1.001
    assert p.min() > -0.02 * height
    assert log["iterations"].max() <= 15
    mass, energy = (log[k] for k in ("mass", "energy"))
    assert np.ptp(mass) < 1e-8 * mass[0] and np.ptp(energy) < 1e-8 * energy[0]


def loaded(code):
    """Top-level packages that a program has loaded at its end."""
    code += "\nimport sys\nprint(*sorted({m.split('.')[0] for m in sys.modules}))"
    start, env = command(1)  # without what MPI left in the environment here
    out = subprocess.run([*start, "-c", code], check=True, capture_output=True, text=True, env=env)
    return set(out.stdout.split())


SOLID = """
import numpy as np, sys
import fempm
mesh = fempm.interval_mesh(np.linspace(0, 1, 11))
body = fempm.Body(*fempm.fill_cells(mesh, 2), fempm.NeoHookean(1.0, 10.0))
fempm.run(fempm.Simulation(mesh, [body], gradient="plain"), 0.01, progress=False)
"""


def test_solids_load_nothing_of_the_gas():
    """Neither the package nor PETSc, in a scene that runs."""
    assert loaded(SOLID) & {"coupling", "petsc4py", "torch"} == set()


def test_gas_loads_nothing_for_others():
    """`coupling` alone loads neither what draws, meshes or learns, nor PETSc before a gas is made."""
    found = loaded("import coupling")
    assert "coupling" in found
    assert not found & {"torch", "gmsh", "matplotlib", "meshio", "petsc4py"}
