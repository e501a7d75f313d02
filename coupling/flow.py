"""Compressible gas: the pressure-split Euler equations on a simplex mesh (thesis 3.2.1-3.2.9).

A step advects the conserved variables along edges, explicitly, and then solves for the pressure,
implicitly: the time step is limited by the velocity of the gas and not by that of sound.
"""

import numpy as np

from fempm import checkpoint
from fempm.parallel import Ranks
from fempm.solver import SimulationError

from . import advection, limiters
from .boundaries import Boundaries, Periodic, check_covered
from .gas import conserved
from .initial import initial_state
from .partition import Part
from .pressure import PressureSystem, divide_by_mass
from .spaces import build_space

SCHEMES = ("imex", "euler")
GAMMA = 1 - 1 / np.sqrt(2)  # of the two-stage scheme
STILL = 1e-9  # gas slower than this share of the speed of sound carries nothing
SHOCK = 0.003  # compression in one step from which a wave counts as a shock
START_STEPS, START_CFL = 5, 0.25  # first steps, limited by the speed of sound
SMALLEST = 2.0**-12  # share of a step that is tried when positivity is lost


class LostPositivity(ArithmeticError):
    """Density or internal energy that is not positive."""


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
    scheme : "imex", two stages and second order, or "euler", the one stage of the thesis
    limiter : one of `limiters.NAMES`
    cfl : Courant number of |u| and grad p; the first five steps also stay below a quarter of the
        time in which sound crosses a cell, since the pressure has no gradient yet where it jumps
    gravity : (d,) acceleration

    Attributes
    ----------
    U : (n, d + 2) density, momentum, total energy per volume at this rank's nodes
    iterations : of each pressure solve
    repeated : steps that would have lost positivity and were repeated in halves
    """

    particles = None

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
        self.limiter, self.limiter_name = limiters.known(limiter), limiter
        self.gravity = None if gravity is None else np.asarray(gravity, float)
        self.ranks = Ranks()
        self.part = Part(whole, self.ranks)
        states = initial_state(mesh, whole, eos, initial)
        self.conditions = Boundaries(mesh, whole, boundaries, eos, states)
        states[self.conditions.fixed] = self.conditions.fixed_state
        self.conditions.restrict(self.part.nodes)
        self.U = self.from_primitive(states[self.part.nodes])
        self.pressure_system = PressureSystem(self.part)
        self.time, self.dt, self.steps, self.repeated = 0.0, 0.0, 0, 0
        self.iterations = []
        self.cut = 0
        self.allocate()

    def allocate(self):
        """Work arrays, and what stays the same in all steps."""
        space, c = self.part.space, self.conditions
        n, d = space.points.shape
        self.width = space.volumes ** (1 / d)
        self.W, self.rate, self.gradient = np.empty((n, d + 2)), np.empty((n, d + 2)), np.empty((n, d + 2, d))
        self.needed, self.active = np.empty(n, np.uint8), np.empty(len(space.edges), np.int32)
        self.special = np.union1d(c.constrained, c.open).astype(np.int32)
        self.free = np.broadcast_to(np.eye(d), (len(self.special), d, d)).copy()
        self.free[np.searchsorted(self.special, c.constrained)] = c.project
        self.open_special = np.searchsorted(self.special, c.open)
        self.open_size = np.linalg.norm(c.open_area, axis=1)
        self.outward = c.open_area / np.maximum(self.open_size, 1e-300)[:, None]
        nodes, dofs, squares = self.part.pairs
        pairs = np.flatnonzero(np.isin(nodes, c.open))
        sums = self.part.sum_nodes(np.bincount(nodes[pairs], squares[pairs], n))
        self.inside = np.searchsorted(c.open, nodes[pairs]), dofs[pairs], squares[pairs] / sums[nodes[pairs]]
        self.fixed_U = self.from_primitive(c.fixed_state)

    def step(self, dt):
        """Advance by dt, in two halves where that would lose positivity."""
        self.advance(dt, dt)
        self.time += dt
        self.steps += 1

    def advance(self, dt, whole):
        """One step, or two of half its length."""
        try:
            self.U = self.one_step(self.U, dt) if dt == whole else self.safe_step(self.U, dt)
        except LostPositivity as lost:
            if dt <= SMALLEST * whole:
                raise self.failure(lost) from None
            self.repeated += 1
            self.advance(dt / 2, whole)
            self.advance(dt / 2, whole)

    def safe_step(self, U, dt):
        """One stage of first order: states of the nodes themselves cannot carry away more than there is."""
        return self.one_step(U, dt, "euler", limiters.known("first_order"))

    def one_step(self, U, dt, scheme=None, limiter=None):
        """The conserved variables after a step."""
        self.waves = self.outgoing_waves(U)
        if (scheme or self.scheme) == "euler":
            U = self.implicit_pressure(U + dt * self.advection(U, limiter), dt, U)
        else:
            tau = GAMMA * dt
            first = self.implicit_pressure(U + tau * self.advection(U), tau, U)
            slope = (first - U) / tau
            ahead = self.limited(U, dt / (2 * GAMMA) * slope)
            change = (1 - GAMMA) * dt * slope + tau * self.advection(ahead)
            U = self.implicit_pressure(U + change, tau, ahead, self.limited(U, change))
        U = self.attenuate(U, dt)
        self.primitive(U)
        return U

    def advection(self, U, limiter=None):
        """Rate of change (n, d + 2) of the conserved variables by transport with the gas."""
        s, part = self.part.space, self.part
        W, pressure = self.primitive(U)
        sound = np.sqrt(self.eos.bulk_modulus(W[:, 0], pressure) / W[:, 0])
        count = advection.active_edges(s.edges, W, STILL * sound, self.active, self.needed)
        part.sum_nodes(self.needed)
        graph = s.forward, s.backward
        advection.gradients(part.size, s.edges, *graph, s.volumes, W, self.needed, self.gradient)
        part.sum_nodes(self.gradient)
        rate, active = self.rate, self.active[:count]
        rate[:] = 0.0
        advection.add_fluxes(
            part.size,
            active,
            s.edges,
            s.vectors,
            *graph,
            W,
            self.gradient,
            self.limiter if limiter is None else limiter,
            rate,
        )
        part.sum_nodes(rate)
        flow = np.sum(W[self.conditions.open, 1:-1] * self.conditions.open_area, axis=1)
        rate[self.conditions.open] -= flow[:, None] * U[self.conditions.open]
        return rate / s.volumes[:, None]

    def limited(self, U, change):
        """U + change, with the change at a node cut where it would use up its internal energy.

        Extrapolation from one stage to the next is linear in momentum, so that kinetic energy outruns the
        total where a gas is pushed from rest or moves much faster than sound.
        """
        out = np.empty_like(U)
        self.cut += advection.limited_sum(U, change, out)
        return out

    def implicit_pressure(self, U, dt, guess, star=None):
        """The conserved variables after the implicit pressure has acted for a time dt."""
        part, s, c, system = self.part, self.part.space, self.conditions, self.pressure_system
        W, pressure = self.primitive(U if star is None else star)
        density, velocity = U[:, 0], U[:, 1:-1] / U[:, :1]
        if self.gravity is not None:
            velocity = velocity + dt * self.gravity
        bulk = self.eos.bulk_modulus(W[:, 0], pressure)
        # means over the mass of a cell, not its volume: rarefactions that begin at a jump lag less behind
        # what advection has compressed comes off again: the implicit part acts on all of rho c^2 div u
        guess = guess[:, 1:-1] / guess[:, :1]
        carried = bulk - self.eos.heating(W[:, 0], pressure) * pressure
        expansion = dt * self.outflow_of(guess)
        # not in shocks, where counting the compression twice is the bulk viscosity that they need
        smooth = 1 / (1 + (np.minimum(expansion, 0) / SHOCK) ** 2)
        before = pressure + carried * expansion * smooth
        pressure = np.where(before > 0.25 * pressure, before, pressure)
        mass, star, stiff = part.means(np.stack([density, density * pressure, density * bulk], axis=1)).T
        star, stiff = star / mass, stiff / mass
        inverse = 1 / (s.volumes * density)
        impedance, outgoing = self.waves
        tensors = self.mobility(dt * impedance * self.open_size * inverse[c.open])
        force = part.pressure_force(star, np.empty_like(s.points))
        force[c.open] -= outgoing[:, None] * c.open_area
        velocity = velocity / inverse[:, None] + dt * force
        divide_by_mass(part.size, inverse, self.special, tensors, velocity)
        velocity[c.fixed] = c.fixed_state[:, 1:-1]
        rhs = -part.divergence(velocity, np.empty(len(star)))
        increment = system.solve(dt, s.pressure_volumes / (stiff * dt), inverse, self.special, tensors, rhs)
        self.iterations.append(system.iterations)
        force = part.pressure_force(increment, force)
        divide_by_mass(part.size, inverse, self.special, tensors, force)
        velocity += dt * force

        work = part.work(star + increment, velocity)
        through = np.sum(velocity[c.open] * self.outward, axis=1)
        work[c.open] -= (outgoing + impedance * through) * through * self.open_size
        inner = W[:, -1]
        energy = U[:, -1] + dt * (work / s.volumes - self.outflow_of(velocity - guess, inner))
        if self.gravity is not None:
            energy += dt * density * (velocity @ self.gravity)
        U = np.concatenate([density[:, None], density[:, None] * velocity, energy[:, None]], axis=1)
        U[c.fixed] = self.fixed_U
        return U

    def outflow_of(self, velocity, values=None):
        """div (values u) at the nodes, central on each edge; values are 1 if not given. Collective."""
        s, c, out = self.part.space, self.conditions, np.zeros(len(velocity))
        advection.add_outflow(self.part.size, s.edges, s.forward, s.backward, velocity, values, out)
        self.part.sum_nodes(out)
        through = np.sum(velocity[c.open] * c.open_area, axis=1)
        out[c.open] += through if values is None else through * values[c.open]
        return out / s.volumes

    def outgoing_waves(self, U):
        """Impedance Z and p - Z u . n (m,) just inside of the outflow nodes, kept through a step."""
        c = self.conditions
        if len(c.open) == 0:
            return np.empty(0), np.empty(0)
        (W, pressure), (row, dofs, weights) = self.primitive(U), self.inside
        values = np.concatenate([pressure[:, None], W], axis=1)
        inside = np.zeros((len(c.open), values.shape[1]))
        np.add.at(inside, row, self.part.means(values)[dofs] * weights[:, None])
        pressure, density, velocity = inside[:, 0], inside[:, 1], inside[:, 2:-1]
        impedance = np.sqrt(self.eos.bulk_modulus(density, pressure) * density)
        return impedance, pressure - impedance * np.sum(velocity * self.outward, axis=1)

    def mobility(self, ratio):
        """M^-1 at the special nodes over 1 / (m rho); `ratio` (m,) is dt Z |b| / (m rho) at open nodes."""
        tensors = self.free.copy()
        at = self.open_special
        normal = np.einsum("kab,kb->ka", tensors[at], self.outward)
        share = ratio / (1 + ratio * np.sum(normal**2, axis=1))
        tensors[at] -= share[:, None, None] * normal[:, :, None] * normal[:, None, :]
        return tensors

    def attenuate(self, U, dt):
        """Damp what incoming waves carry at outflows, relative to the far state."""
        c = self.conditions
        if len(c.open) == 0:
            return U
        W, pressure = self.primitive(U)
        density, velocity, pressure = W[c.open, 0], W[c.open, 1:-1], pressure[c.open]
        sound = np.sqrt(self.eos.bulk_modulus(density, pressure) / density)
        decay, normal = np.exp(-c.attenuation * dt), self.outward
        speed = np.sum(velocity * normal, axis=1)
        apart, drift = pressure - c.far[:, -1], velocity - c.far[:, 1:-1]
        across = np.sum(drift * normal, axis=1)
        outgoing = apart + density * sound * across
        incoming = (apart - density * sound * across) * np.where(speed < sound, decay, 1)
        carried = np.where(speed < 0, decay, 1)
        entropy = (density - c.far[:, 0] - apart / sound**2) * carried
        along = (drift - across[:, None] * normal) * carried[:, None]
        apart = (outgoing + incoming) / 2
        velocity = along + ((outgoing - incoming) / (2 * density * sound))[:, None] * normal
        density = c.far[:, 0] + entropy + apart / sound**2
        state = np.concatenate(
            [density[:, None], c.far[:, 1:-1] + velocity, (c.far[:, -1] + apart)[:, None]], axis=1
        )
        U[c.open] = self.from_primitive(state)
        return U

    def primitive(self, U):
        """Density, velocity, internal energy per volume as (n, d + 2), and the pressure (n,). Collective.

        Raises LostPositivity on all ranks if density or internal energy is not positive somewhere.
        """
        W = np.empty_like(U)
        worst = advection.primitive(U, W)
        (density, *_, energy), lost = W[worst], None
        if not (density > 0 and energy > 0):
            x = self.part.space.points[worst].round(6).tolist()
            lost = LostPositivity(f"density {density:.6g}, internal energy {energy:.6g} at {x}")
        self.ranks.raise_together(lost)
        return W, self.eos.pressure(W[:, 0], W[:, -1])

    def from_primitive(self, state):
        """Conserved variables of density, velocity and pressure (k, d + 2)."""
        return conserved(self.eos, state[:, 0], state[:, 1:-1], state[:, -1])

    def failure(self, lost):
        """The error that ends a run."""
        return SimulationError(
            f"the gas lost its positivity at time {self.time:.6g}, {lost}, even with a step of "
            f"{SMALLEST:.2g} of the stable one: refine the mesh there or take a smaller cfl"
        )

    def stable_step(self):
        """Time step from |u| and grad p (Kwatra et al. 2009), of sound in the first steps. Collective."""
        s, (W, pressure) = self.part.space, self.primitive(self.U)
        rate, slopes = np.empty(len(W)), np.empty_like(s.points)
        advection.step_rates(
            self.part.size, s.edges, s.forward, s.backward, s.volumes, W, pressure, rate, slopes
        )
        self.part.sum_nodes(rate)
        push = np.linalg.norm(self.part.sum_nodes(slopes), axis=1) / (W[:, 0] * self.width)
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
        W, pressure = self.primitive(self.U)
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
        W, pressure = self.primitive(self.U)
        total = self.part.total(self.U)
        solves = self.iterations[-2:] or [0]
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
        }

    def save(self, path):
        """Write a checkpoint, an HDF5 file that is there as a whole or not at all. Collective."""
        mine = self.part.mine
        with checkpoint.storing(self, path, self.fingerprint()) as store:
            store("nodes", self.part.nodes[mine])
            store("conserved", self.U[mine])
            store("counters", np.array([self.repeated, self.cut]) * (self.ranks.rank == 0))

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
        repeated, cut = file["counters"][:2].tolist()
        return {"U": whole[self.part.nodes], "repeated": repeated, "cut": cut, **checkpoint.clock(file)}

    def fingerprint(self):
        """What a checkpoint and the scene that goes on from it must have in common."""
        return checkpoint.mesh_fingerprint(self.mesh) | {
            "gas": checkpoint.describe(self.eos),
            "scheme": f"{self.pair}, {self.scheme}, {self.limiter_name}",
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
