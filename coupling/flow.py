"""Compressible gas: the pressure-split Euler equations on a simplex mesh (thesis 3.2.1-3.2.9).

A step advects the conserved variables along edges, explicitly, and then solves for the pressure,
implicitly: the time step is limited by the velocity of the gas and not by that of sound.
"""

import numpy as np

from fempm import checkpoint
from fempm.parallel import Ranks, RemoteError
from fempm.solver import SimulationError

from . import advection, limiters
from .boundaries import Boundaries, Periodic, check_covered
from .initial import initial_state
from .partition import Part
from .pressure import StepFailed
from .spaces import build_space
from .stages import Stages

SCHEMES = ("imex", "euler")
GAMMA = 1 - 1 / np.sqrt(2)  # of the two-stage scheme
AROUND = (1.0, 1.0, 1.18, 1.4)  # sum |u . n| / 2 m over |u| / h in regular duals, by dimension
START_STEPS, START_CFL = 5, 0.25  # first steps, limited by the speed of sound
SMALLEST, MOST_REPEATS = 2.0**-12, 200  # share of a step that is tried when positivity is lost, and how often


class Flow:
    """A gas on a mesh, ready for `fempm.run`.

    Parameters
    ----------
    mesh : fempm.SimplexMesh
    eos : equation of state, see `gas.IdealGas`
    initial : function of points (n, d) returning density (n,), velocity (n, d) and pressure (n,), or what
        NumPy broadcasts to these shapes
    boundaries : conditions, one for each exterior facet, see `boundaries`
    pair : velocity and pressure space, "B1-B0" or "B2-B1"
    scheme : "imex", two stages and second order, or "euler", the one stage of the thesis with advection by
        Heun's method
    limiter : one of `limiters.NAMES`
    cfl : Courant number of |u| and grad p; the first five steps also stay below a quarter of the
        time in which sound crosses a cell, since the pressure has no gradient yet where it jumps
    gravity : (d,) acceleration

    Attributes
    ----------
    U : (n, d + 2) density, momentum, total energy per volume at this rank's nodes
    stages : Stages, with `stages.iterations` of each pressure solve
    repeated : steps that would have lost positivity and were repeated in halves
    """

    particles = None
    stages_kind = Stages

    def __init__(
        self,
        mesh,
        eos,
        initial,
        boundaries,
        pair="B1-B0",
        scheme="imex",
        limiter="contact",
        cfl=0.5,
        gravity=None,
    ):
        check_options(scheme, limiter, cfl)
        check_covered(mesh, boundaries)
        periodic = [(c.boundary, c.other) for c in boundaries if isinstance(c, Periodic)]
        whole = build_space(mesh, pair, periodic)
        self.mesh, self.eos, self.pair, self.scheme, self.cfl = mesh, eos, pair, scheme, cfl
        self.limiter = limiter
        if gravity is not None:
            gravity = np.array(gravity, float).reshape(mesh.dim)
        self.ranks = Ranks()
        self.part = Part(whole, self.ranks)
        states = initial_state(mesh, whole, eos, initial)
        conditions = Boundaries(mesh, whole, boundaries, eos, states)
        states[conditions.fixed] = conditions.fixed_state
        conditions.restrict(self.part.nodes)
        self.stages = self.stages_kind(self.part, eos, conditions, limiters.known(limiter), gravity)
        self.U = self.stages.from_primitive(states[self.part.nodes])
        self.width = self.part.space.volumes ** (1 / mesh.dim)
        self.time, self.dt, self.steps, self.repeated = 0.0, 0.0, 0, 0

    def step(self, dt):
        """Advance by dt, in two halves where that fails."""
        self.dt, self.first_repeat = dt, self.repeated
        self.advance(dt, dt)
        self.time += dt
        self.steps += 1

    def advance(self, dt, whole):
        """One step, or two of half its length."""
        try:
            self.U = self.one_step(self.U, dt) if dt == whole else self.safe_step(self.U, dt)
        except (StepFailed, RemoteError) as problem:
            if dt <= SMALLEST * whole or self.repeated - self.first_repeat > MOST_REPEATS:
                raise self.failure(problem) from None
            self.repeated += 1
            self.advance(dt / 2, whole)
            self.advance(dt / 2, whole)

    def safe_step(self, U, dt):
        """One stage of first order: states of the nodes themselves cannot carry away more than there is."""
        return self.one_step(U, dt, "euler", limiters.known("first_order"))

    def one_step(self, U, dt, scheme=None, limiter=None):
        """The conserved variables after a step."""
        stages = self.stages
        stages.begin_step(U, dt)
        if (scheme or self.scheme) == "euler":
            ahead = U + dt * stages.advection(U, limiter)
            U = stages.implicit_pressure(0.5 * (U + ahead + dt * stages.advection(ahead, limiter)), dt)
        else:
            tau = GAMMA * dt
            first = stages.implicit_pressure(U + tau * stages.advection(U), tau, U)
            slope = (first - U) / tau
            ahead = stages.limited(U, dt / (2 * GAMMA) * slope)
            change = (1 - GAMMA) * dt * slope + tau * stages.advection(ahead)
            U = stages.implicit_pressure(U + change, tau, ahead, stages.limited(U, change))
        U = stages.attenuate(U, dt)
        stages.primitive(U)
        return U

    def failure(self, problem):
        """The error that ends a run."""
        return SimulationError(
            f"the gas could not go on from time {self.time:.6g}, {problem}, even with a step of "
            f"{SMALLEST:.2g} of the stable one or after {MOST_REPEATS} repetitions: refine the mesh there or "
            "take a smaller cfl"
        )

    def stable_step(self):
        """Time step from |u| and grad p (Kwatra et al. 2009), of sound in the first steps. Collective."""
        s, (W, pressure) = self.part.space, self.stages.primitive(self.U)
        rate, slopes = np.empty(len(W)), np.empty_like(s.points)
        advection.step_rates(
            self.part.size, s.edges, s.forward, s.backward, s.volumes, W, pressure, rate, slopes
        )
        rate = self.part.sum_nodes(rate) / AROUND[s.dim]
        slopes = self.part.sum_nodes(slopes)
        push = np.sqrt(np.einsum("na,na->n", slopes, slopes)) / (W[:, 0] * self.width)
        limit = self.cfl / max(np.max(0.5 * (rate + np.sqrt(rate**2 + 4 * push))), 1e-300)
        if self.steps < START_STEPS:
            sound = np.sqrt(self.eos.bulk_modulus(W[:, 0], pressure) / W[:, 0])
            speed = np.linalg.norm(W[:, 1:-1], axis=1) + sound
            limit = min(limit, START_CFL * np.min(self.width / speed))
        else:
            limit = min(limit, 2 * self.dt)  # where nothing moves, nothing else limits it
        return self.ranks.min(limit)

    def vertex_fields(self):
        """Density, velocity, pressure, Mach number and |grad rho| ("schlieren") at the mesh's vertices."""
        part, s = self.part, self.part.space
        W, pressure = self.stages.primitive(self.U)
        sound = np.sqrt(self.eos.bulk_modulus(W[:, 0], pressure) / W[:, 0])
        graph = s.forward, s.backward
        gradient = np.empty((*W.shape, s.dim))
        advection.gradients(part.size, s.edges, *graph, s.volumes, W, np.ones(len(W), np.uint8), gradient)
        fields = {
            "density": W[:, 0],
            "velocity": W[:, 1:-1],
            "pressure": pressure,
            "mach": np.linalg.norm(W[:, 1:-1], axis=1) / sound,
            "schlieren": np.linalg.norm(part.sum_nodes(gradient)[:, 0], axis=1),
        }
        at = part.whole.node_of_vertex
        return {name: part.gather(field)[at] for name, field in fields.items()}

    def summary(self):
        """Time, step, mass, energy, momentum and extremes, the columns of a run's log. Collective."""
        W, pressure = self.stages.primitive(self.U)
        total = self.part.total(self.U)
        solves = self.stages.iterations[-2:] or [0]
        names = "xyz"[: self.mesh.dim]
        return {
            "time": self.time,
            "dt": self.dt,
            "mass": total[0],
            "energy": total[-1],
            **{f"momentum_{a}": m for a, m in zip(names, total[1:-1])},
            "least_density": self.ranks.min(W[:, 0].min()),
            "least_pressure": self.ranks.min(pressure.min()),
            "iterations": max(solves),
            "repeated": self.repeated,
            "limited": self.ranks.sum(self.stages.cut),
        }

    def save(self, path):
        """Write a checkpoint, an HDF5 file that is there as a whole or not at all. Collective."""
        with checkpoint.storing(self, path, self.fingerprint()) as store:
            self.store(store)

    def store(self, store):
        """Write what a checkpoint holds of the gas with an open `checkpoint.storing`. Collective."""
        mine = self.part.mine
        store("nodes", self.part.nodes[mine])
        store("conserved", self.U[mine])
        store("repeated", np.array([self.repeated] * (self.ranks.rank == 0)))

    def load(self, path):
        """Take up a checkpoint of the same scene, on any number of ranks. Collective.

        Raises
        ------
        fempm.CheckpointError, FileNotFoundError
            on all ranks, for a file that is damaged or of another scene; nothing is changed then
        """
        state = checkpoint.read(self.ranks, path, self.fingerprint(), self.stored)
        vars(self).update(state)

    def stored(self, file):
        """What a checkpoint holds for this rank: attribute -> value."""
        whole = np.empty((len(self.part.whole.points), self.U.shape[1]))
        whole[file["nodes"][()]] = file["conserved"][()]
        repeated = int(file["repeated"][0])
        return {"U": whole[self.part.nodes], "repeated": repeated, **checkpoint.clock(file)}

    def fingerprint(self):
        """What a checkpoint and the scene that goes on from it must have in common."""
        return checkpoint.mesh_fingerprint(self.mesh) | {
            "gas": checkpoint.describe(self.eos),
            "scheme": f"{self.pair}, {self.scheme}, {self.limiter}",
            "nodes": str(len(self.part.whole.points)),
        }


def check_options(scheme, limiter, cfl):
    """Raise a ValueError for options that are out of range."""
    if scheme not in SCHEMES:
        raise ValueError(f"scheme {scheme!r}: give one of {', '.join(map(repr, SCHEMES))}")
    if limiter not in limiters.NAMES:
        raise ValueError(f"limiter {limiter!r}: give one of {', '.join(map(repr, limiters.NAMES))}")
    if not cfl > 0:
        raise ValueError(f"cfl {cfl}: it must be positive")
