"""The two parts that the stages of a step are made of: explicit advection and implicit pressure.

In the two-stage scheme all of the sound is implicit: the pressure solve acts on rho c^2 div u, and what the
energy gained from the compression in the advection is exchanged for that of the new velocity, with the same
central fluxes. So the pressure of the solve is the one that the energy has afterwards, up to the second
order, and the time step knows no speed of sound. The one stage of the thesis (3.2.5) and of Kwatra et al.
2009 leaves the compression in the advection, which is of first order in time.
"""

from dataclasses import dataclass

import numpy as np

from . import advection, pressure
from .gas import conserved
from .outflow import Inside, OpenEnds

STILL = 1e-9  # gas slower than this share of the speed of sound carries nothing
SHOCK = 0.003  # compression in one step from which a wave counts as a shock


@dataclass
class Before:
    """A stage before its pressure is known: (n,) arrays at the nodes, and velocities (n, d).

    `pressure`, its stiffness `bulk` = rho c^2, P* (`star`), internal energy per volume, the velocity that
    inertia keeps, 1 / (m rho), and the velocity `old` of the advection, None where that keeps compression.
    """

    pressure: np.ndarray
    bulk: np.ndarray
    star: np.ndarray
    internal: np.ndarray
    velocity: np.ndarray
    inverse: np.ndarray
    old: np.ndarray | None


class LostPositivity(pressure.StepFailed):
    """Density or internal energy that is not positive."""


class Stages:
    """Advection and pressure on the nodes of one rank.

    Parameters
    ----------
    part : Part, the space of this rank
    eos : equation of state
    conditions : Boundaries, restricted to it
    limiter : tuple, see `limiters.known`
    gravity : (d,) acceleration, or None

    Attributes
    ----------
    iterations : of each pressure solve
    cut : how often an extrapolation between stages was shortened at a node, see `limited`
    """

    def __init__(self, part, eos, conditions, limiter, gravity):
        self.part, self.eos, self.limiter, self.gravity = part, eos, limiter, gravity
        self.system = pressure.PressureSystem(part)
        self.iterations, self.cut = [], 0
        self.openness, self.volumes = None, part.space.volumes  # all of them open to the gas
        self.graph = part.space.forward, part.space.backward
        n, d = part.space.points.shape
        self.gradient, self.active = np.empty((n, d + 2, d)), np.empty(len(part.space.edges), np.int32)
        self.needed = np.empty(n, np.uint8)
        self.fixed, self.floating = conditions.fixed, np.flatnonzero(conditions.floating)
        self.fixed_state, self.fixed_area = conditions.fixed_state, conditions.fixed_area
        outward = self.fixed_area / np.linalg.norm(self.fixed_area, axis=1, keepdims=True)
        self.beside = Inside(part, self.fixed, outward)
        self.open = OpenEnds(part, conditions, eos)
        self.any_open, self.any_floating = (
            part.ranks.max(len(k)) > 0 for k in (self.open.nodes, self.floating)
        )
        self.special = np.union1d(conditions.constrained, conditions.open).astype(np.int32)
        self.free = np.broadcast_to(np.eye(d), (len(self.special), d, d)).copy()
        self.free[np.searchsorted(self.special, conditions.constrained)] = conditions.project
        self.open_special = np.searchsorted(self.special, conditions.open)

    def begin_step(self, U, dt):
        """Look at the gas inside of open ends."""
        if self.any_open:
            self.open.begin_step(*self.primitive(U), dt)

    def advection(self, U, limiter=None):
        """Rate of change (n, d + 2) of the conserved variables by transport with the gas. Collective."""
        s, part, ends = self.part.space, self.part, self.open
        W, p = self.primitive(U)
        sound = np.sqrt(self.eos.bulk_modulus(W[:, 0], p) / W[:, 0])
        active = self.active[: advection.active_edges(s.edges, W, STILL * sound, self.active, self.needed)]
        part.sum_nodes(self.needed)
        graph = self.graph
        advection.gradients(part.size, s.edges, *graph, s.volumes, W, self.needed, self.gradient)
        if part.ranks.size > 1:
            self.gradient[self.needed == 0] = 0  # what nobody has computed must not pile up
        part.sum_nodes(self.gradient)
        self.flatten(self.gradient)
        rate = np.zeros_like(U)
        chosen = self.limiter if limiter is None else limiter
        states = W, self.gradient, chosen, self.openness
        advection.add_fluxes(part.size, active, s.edges, s.vectors, *graph, *states, rate)
        part.sum_nodes(rate)
        through = np.sum(W[ends.nodes, 1:-1] * ends.area, axis=1) * self.open_share(ends.nodes)
        rate[ends.nodes] -= through[:, None] * U[ends.nodes]
        rate /= self.volumes[:, None]
        rate[self.fixed] = 0
        return rate

    def limited(self, U, change):
        """U + change, with the change at a node cut where it would use up its internal energy.

        Extrapolation from one stage to the next is linear in momentum, so that kinetic energy outruns the
        total where a gas is pushed from rest or moves much faster than sound.
        """
        out = np.empty_like(U)
        self.cut += advection.limited_sum(U, change, out)
        return out

    def implicit_pressure(self, U, dt, advected=None, star=None):
        """The conserved variables after the implicit pressure has acted for a time dt. Collective.

        Parameters
        ----------
        U : (n, d + 2) conserved variables after the explicit part
        dt : length of the stage
        advected : state whose velocity the advection of this stage had, for implicit sound
        star : state whose pressure is linearised about, U itself when not given
        """
        part, s, ends = self.part, self.part.space, self.open
        before = self.before_pressure(U, dt, advected, star)
        mass = before.inverse, self.special, self.free_directions(dt, before.inverse)

        # means over the mass of a cell, not its volume: rarefactions that begin at a jump lag less behind
        star, stiff = part.means(np.ascontiguousarray(U[:, 0]), before.star, before.bulk)
        force = self.force(star)
        velocity = before.velocity
        pressure.accelerate(part.size, before.inverse, dt, force, velocity)
        pressure.divide_by_mass(part.size, *mass, velocity)
        velocity[self.fixed] = self.fixed_state[:, 1:-1]
        rhs = -part.divergence(velocity, np.empty(len(star)))
        increment = self.system.solve(dt, s.pressure_volumes / (stiff * dt), *mass, rhs)
        self.iterations.append(self.system.iterations)
        force = part.pressure_force(increment, force)
        pressure.divide_by_mass(part.size, *mass, force)
        velocity += dt * force

        work = part.work(star + increment, velocity)
        if len(ends.nodes):
            work[ends.nodes] -= ends.power(velocity)
        return self.after_pressure(U, dt, before, velocity, work)

    def before_pressure(self, U, dt, advected, star):
        """What a stage knows before it solves for the pressure, see `implicit_pressure`."""
        W, p = self.primitive(U if star is None else star)
        if star is not None:
            self.check_density(U)
        bulk = self.eos.bulk_modulus(W[:, 0], p)
        carried = bulk - self.eos.heating(W[:, 0], p) * p
        old = None if advected is None else advected[:, 1:-1] / advected[:, :1]
        expansion = np.zeros(len(U)) if old is None else self.outflow_of(old)
        velocity, inverse, around = (
            np.empty((len(U), self.part.space.dim)),
            np.empty(len(U)),
            np.empty(len(U)),
        )
        fixed = dt, self.part.space.volumes, self.gravity
        self.cut += pressure.before_solve(
            self.part.size, U, p, carried, expansion, SHOCK, *fixed, velocity, inverse, around
        )
        return Before(p, bulk, around, np.ascontiguousarray(W[:, -1]), velocity, inverse, old)

    def force(self, values):
        """(n, d) force of the pressure and of what is behind open ends. Collective."""
        force = self.part.pressure_force(values, np.empty_like(self.part.space.points))
        if len(self.open.nodes):
            force[self.open.nodes] -= self.open.carried
        return force

    def after_pressure(self, U, dt, before, velocity, work):
        """Conserved variables with the new velocity (n, d) and the power (n,) of the pressure. Collective."""
        outflow = np.zeros(len(U))
        if before.old is not None:
            outflow = self.outflow_of(velocity - before.old, before.internal)
        out = np.empty_like(U)
        fixed = dt, self.part.space.volumes, self.gravity
        pressure.after_solve(self.part.size, velocity, work, outflow, *fixed, U, out)
        out[self.fixed] = self.inflow_state(U, before.pressure)
        return out

    def free_directions(self, dt, inverse):
        """(k, d, d) what walls and open ends leave of the velocity of a force at the special nodes."""
        tensors, ends = self.free.copy(), self.open
        if len(ends.nodes):
            ratio = dt * ends.impedance * inverse[ends.nodes]
            tensors[self.open_special] = ends.mobility(tensors[self.open_special], ratio)
        return tensors

    def outflow_of(self, velocity, values=None):
        """m_i div (values u), central on each edge; values (n,) are 1 if not given. Collective."""
        s, ends, out = self.part.space, self.open, np.zeros(len(velocity))
        graph = s.edges, *self.graph
        advection.add_outflow(self.part.size, *graph, velocity, values, self.openness, out)
        self.part.sum_nodes(out)
        for nodes, area in ((ends.nodes, ends.area), (self.fixed, self.fixed_area)):
            through = np.sum(velocity[nodes] * area, axis=1) * self.open_share(nodes)
            out[nodes] += through if values is None else through * values[nodes]
        return out

    def open_share(self, nodes):
        """Share of the boundary at some nodes through which gas passes."""
        return 1.0

    def flatten(self, gradient):
        """Where states are not reconstructed, the gradient (n, d + 2, d) is made zero."""

    def inflow_state(self, U, pressure):
        """(f, d + 2) conserved variables at inflows; the pressure of subsonic ones is that inside."""
        state = self.fixed_state
        if self.any_floating:
            state = state.copy()
            state[self.floating, -1] = self.beside.means(U[:, 0].copy(), pressure[None])[0][self.floating]
        return self.from_primitive(state)

    def attenuate(self, U, dt):
        """Damp what incoming waves carry at open ends. Collective."""
        if self.any_open:
            U[self.open.nodes] = self.from_primitive(self.open.attenuate(*self.primitive(U), dt))
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
        self.part.ranks.raise_together(lost)
        return W, self.eos.pressure(W[:, 0], W[:, -1])

    def check_density(self, U):
        """Raise LostPositivity on all ranks if a density is not positive. Collective."""
        worst, lost = int(np.argmin(U[:, 0])), None
        if not U[worst, 0] > 0:
            x = self.part.space.points[worst].round(6).tolist()
            lost = LostPositivity(f"density {U[worst, 0]:.6g} at {x}")
        self.part.ranks.raise_together(lost)

    def from_primitive(self, state):
        """Conserved variables of density, velocity and pressure (k, d + 2)."""
        return conserved(self.eos, state[:, 0], state[:, 1:-1], state[:, -1])
