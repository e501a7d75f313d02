"""The one-dimensional benchmarks of Kwatra et al. 2009, for demos and tests: states, times, exact values."""

from dataclasses import dataclass

import numpy as np

import fempm

from .boundaries import Outflow, Periodic, SlipWall
from .flow import Flow
from .gas import IdealGas
from .riemann import State, solution

AIR = IdealGas(1.4)


@dataclass(frozen=True)
class Case:
    """A gas in a tube, at rest or not, cut into pieces of constant state.

    Attributes
    ----------
    title : what it is called
    states : of the pieces, from the left; none for `smooth_waves`
    until : time to compare at
    jumps : where the pieces meet
    ends : "open", "walls" or "periodic"
    """

    title: str
    states: tuple
    until: float
    jumps: tuple = (0.5,)
    ends: str = "open"

    @property
    def left(self):
        """State at the left end."""
        return self.states[0]

    @property
    def right(self):
        """State at the right end."""
        return self.states[-1]

    @property
    def has_exact(self):
        """Whether it is one Riemann problem, of which the exact solution is known."""
        return len(self.states) == 2

    def initial(self, x):
        """Density, velocity and pressure at points (n, 1), the initial state of a `Flow`."""
        if not self.states:
            return smooth_waves(x)
        piece = np.searchsorted(self.jumps, x[:, 0], side="right")
        table = np.array([[s.density, s.velocity, s.pressure] for s in self.states])[piece]
        return table[:, 0], table[:, 1:2], table[:, 2]

    def exact(self, x, time):
        """Exact density, velocity and pressure (n,) each at x (n,), for a single jump."""
        if not self.has_exact:
            raise ValueError(f"{self.title}: no exact solution, compare with `reference`")
        return solution(self.left, self.right, (np.asarray(x) - self.jumps[0]) / time, AIR.gamma)


HIGH, LOW = State(1.0, 0.0, 1.0), State(0.125, 0.0, 0.1)
CASES = {
    "sod": Case("Sod", (HIGH, LOW), 0.15),
    "lax": Case("Lax", (State(0.445, 0.698, 3.528), State(0.5, 0.0, 0.571)), 0.12),
    "strong": Case("Strong shock", (State(1.0, 0.0, 1e10), LOW), 2.5e-6),
    "mach3": Case("Mach 3", (State(3.857, 0.92, 10.333), State(1.0, 3.55, 1.0)), 0.09),
    "high_mach": Case("Mach 239", (State(10.0, 2000.0, 500.0), State(20.0, 0.0, 500.0)), 1.75e-4),
    "two_rarefactions": Case("Two rarefactions", (State(1.0, -2.0, 0.4), State(1.0, 2.0, 0.4)), 0.15),
    "two_shocks": Case("Two shocks", (LOW, HIGH, LOW), 0.15, (0.4, 0.6)),
    "blast": Case(
        "Interacting blasts",
        (State(1.0, 0.0, 1000.0), State(1.0, 0.0, 0.01), State(1.0, 0.0, 100.0)),
        0.038,
        (0.1, 0.9),
        "walls",
    ),
    "smooth": Case("Smooth waves", (), 5e-5, (), "periodic"),
}
SMOOTH_SOUND = np.sqrt(1.4e9)  # m/s


def smooth_waves(x):
    """Weak waves in a stiff gas at rest, of one and two lengths in the tube."""
    pressure = 1e9 + 1e3 * (60 * np.cos(2 * np.pi * x[:, 0]) + 100 * np.sin(4 * np.pi * x[:, 0]))
    return (pressure / 1e9) ** (1 / AIR.gamma), 0.0, pressure


def tube(case, cells, **options):
    """The gas of a case on a uniform mesh of the unit interval.

    Parameters
    ----------
    case : Case or its name in CASES
    cells : number of them, or the coordinates (n,) of the vertices
    options : of `Flow`
    """
    case = CASES[case] if isinstance(case, str) else case
    mesh = fempm.interval_mesh(np.linspace(0, 1, cells + 1) if np.ndim(cells) == 0 else cells)
    ends = {
        "open": [Outflow("left"), Outflow("right")],
        "walls": [SlipWall("left"), SlipWall("right")],
        "periodic": [Periodic("left", "right")],
    }
    return Flow(mesh, AIR, case.initial, ends[case.ends], **options)


def acoustic_step(cells, courant):
    """Time step in which sound crosses `courant` cells in the smooth waves."""
    return courant / (cells * SMOOTH_SOUND)


def reference(case, cells, courant=3.0, until=None, **options):
    """Fields of a fine run at the end of a case, or at a given time: vertices (n,), dict name -> (n,)."""
    case = CASES[case] if isinstance(case, str) else case
    gas = tube(case, cells, **options)
    dt = acoustic_step(cells, courant) if case.ends == "periodic" else None
    fempm.run(gas, until=until or case.until, frames=1, dt=dt, progress=False)
    return gas.mesh.points[:, 0], {name: np.ravel(v) for name, v in gas.vertex_fields().items()}


def exact_density(case, x, time=None):
    """Exact density (n,) at x (n,), at the end of a case unless a time is given."""
    case = CASES[case] if isinstance(case, str) else case
    return case.exact(x, case.until if time is None else time)[0]


def mean_error(x, density, exact):
    """Mean over the tube of |density - exact|, both at vertices x (n,) in increasing order."""
    weights = np.gradient(x)
    weights[[0, -1]] *= 0.5
    return weights @ np.abs(density - exact) / (x[-1] - x[0])
