"""Gas and solid in one implicit pressure: an effective density (thesis 3.2.4-3.2.7, design note).

The open share theta of a dual cell moves with u_f, the share alpha that the solid fills with u_s, and both
feel the one pressure of each cell:

    m_f u_f = m_f u_f* + dt theta A P,      m_s u_s = m_s u_s* + dt alpha A P,
    S (P - P*) + A^T (theta u_f + alpha u_s) = 0,

S the compressibility of the gas, theta / (rho c^2), and of the solid's ghost matrix, alpha / (lambda_g J_g),
over dt, and P* their mean pressure, weighted so. The matrix of the gas alone, with theta / rho_f + alpha /
rho_s in the place of 1 / rho, does it.
"""

from itertools import combinations

import numpy as np
from numba import njit

from . import pressure
from .advection import options
from .stages import Stages

EXTRAPOLATE = 1 + np.sqrt(2)  # (1 - gamma) / gamma of the two-stage scheme


@njit(**options)
def add_work(shape, nodes, dofs, coefficients, weights, P, expansion, theta, alpha, gas, solid, out):
    """Add to `out` (n,) the energy that the pressure gives to each node's gas; returns what no gas takes.

    A node gets the work on its gas, and of the heat -P times the expansion of the gas in a cell a share. The
    expansion is what the flux of both phases leaves when that of the ghost matrix, `expansion` (nc, np), is
    taken off: so the gas loses what the solid and its ghost gain.
    """
    per_cell, corners, size = shape
    lost = 0.0
    for c in range(len(nodes)):
        for q in range(len(per_cell)):
            p, total, gassy = P[dofs[c, q]], -expansion[c, q], 0.0
            for b in range(len(corners)):
                i = nodes[c, b]
                own = other = 0.0
                for a in range(len(size)):
                    own += coefficients[c, q, b, a] * gas[i, a]
                    other += coefficients[c, q, b, a] * solid[i, a]
                out[i] += p * theta[i] * own
                total += theta[i] * own + alpha[i] * other
                gassy += weights[q, b] * theta[i]
            if gassy > 0.0:
                for b in range(len(corners)):
                    i = nodes[c, b]
                    out[i] -= weights[q, b] * theta[i] / gassy * p * total
            else:
                lost -= p * total
    return lost


class Mixture(Stages):
    """The stages of a step of gas beside a solid, see `Stages`; `begin` tells them where the solid is.

    Attributes
    ----------
    theta, alpha : (n,) open and filled share of the dual cells
    start, now : (n, d) velocity of the solid at the nodes when the step begins, and after the last stage
    ghost : (nq,) pressure of the ghost matrix as the step begins; P : the last pressure
    lost : energy that the pressure gave to vertices without gas in this step
    """

    def __init__(self, *args):
        super().__init__(*args)
        part, s = self.part, self.part.space
        d, n = s.dim, len(s.points)
        self.theta, self.alpha, self.start, self.lost = np.ones(n), np.zeros(n), np.zeros((n, d)), 0.0
        self.walls = self.special, self.free.copy()
        self.walls[1][np.isin(self.special, self.fixed)] = np.eye(d)
        # nodes of degree two in the middle of edges take the mean of the solid's velocity at the ends
        self.ends = None
        if s.cell_nodes.shape[1] > d + 1:
            pairs = np.array(list(combinations(range(d + 1), 2)))
            middle, first = np.unique(s.cell_nodes[:, d + 1 :], return_index=True)
            ends = s.cell_nodes[:, : d + 1][:, pairs].reshape(-1, 2)[first]
            self.ends = middle, ends, part.mine[middle]

    def constrain_solid(self, vertices, project):
        """Solid walls at nodes (k,) that project (k, d, d) the velocity; done once."""
        d = self.part.space.dim
        special = np.union1d(self.special, vertices).astype(np.int32)
        free, walls = (np.broadcast_to(np.eye(d), (len(special), d, d)).copy() for _ in range(2))
        old = np.searchsorted(special, self.special)
        free[old], walls[old] = self.free, self.walls[1]
        at = np.searchsorted(special, vertices)
        walls[at] = project @ walls[at]
        self.open_special = old[self.open_special]
        self.special, self.free, self.walls = special, free, (special, walls)

    def begin(self, theta, openness, flat, velocity, inverse_mass, compliance, ghost):
        """Take up the solid at the start of a step.

        Parameters
        ----------
        theta : (n,) open shares; openness : (ne,) of the dual faces
        flat : nodes beside closed ones, where states are not reconstructed
        velocity, inverse_mass : (n, d), (n,) of the solid, at vertices
        compliance : (nq,) int alpha / (lambda_g J_g); ghost : (nq,) pressure p_g
        """
        s = self.part.space
        self.theta, self.alpha, self.openness, self.flat = theta, 1 - theta, openness, flat
        self.closed = theta == 0
        self.share = np.where(self.closed, 1.0, theta)
        self.volumes = self.share * s.volumes
        self.start, self.solid_inverse = self.lift(velocity), inverse_mass
        self.moved = self.alpha * (self.lift(inverse_mass[:, None])[:, 0] > 0)
        self.compliance, self.ghost, self.lost = compliance, ghost, 0.0
        sums = np.zeros((len(ghost), 3))
        lists = s.cell_nodes, s.cell_pressures, s.weights, s.cell_volumes
        pressure.add_means(self.part.shape, *lists, theta, theta, theta, sums)
        self.gas_volume = self.part.sum_dofs(sums)[:, 0].copy()
        self.now, self.P = self.start, ghost

    def lift(self, values):
        """Values (n, k) at the vertices continued to nodes in the middle of edges, in place."""
        if self.ends is not None:
            middle, ends, _ = self.ends
            values[middle] = values[ends].mean(axis=1)
        return values

    def lower(self, force):
        """Forces (n, d) of nodes in the middle of edges moved to their ends. Collective."""
        if self.ends is None:
            return force
        middle, ends, mine = self.ends
        out = np.zeros_like(force)
        np.add.at(out, ends[mine].ravel(), np.repeat(0.5 * force[middle[mine]], 2, axis=0))
        self.part.sum_nodes(out)
        force = force + out
        force[middle] = 0
        return force

    def open_share(self, nodes):
        return self.theta[nodes]

    def flatten(self, gradient):
        gradient[self.flat] = 0

    def outflow_of(self, velocity, values=None):
        return super().outflow_of(velocity, values) / self.share

    def push(self, force):
        """(n, d) velocity that a force (n, d) on both phases, per time, gives the solid. Collective."""
        out = self.lower(self.moved[:, None] * force)
        pressure.divide_by_mass(self.part.size, self.solid_inverse, *self.walls, out)
        return self.lift(out)

    def implicit_pressure(self, U, dt, advected=None, star=None):
        """The conserved variables of the gas after the pressure has acted on it and the solid. Collective."""
        part, before = self.part, self.before_pressure(U, dt, advected, star)
        theta, alpha, inverse = self.theta[:, None], self.moved[:, None], before.inverse
        tensors = self.free_directions(dt, inverse)
        solid, ghost = self.start, self.ghost
        if star is not None:
            solid = solid + EXTRAPOLATE * (self.now - solid)
            ghost = ghost + EXTRAPOLATE * (self.P - ghost)
        target, stiffness = self.targets(U, before, ghost, dt)

        force = self.force(target)
        gas = before.velocity / inverse[:, None] + dt * force
        pressure.divide_by_mass(part.size, inverse, self.special, tensors, gas)
        gas[self.fixed] = self.fixed_state[:, 1:-1]
        new = solid + dt * self.push(force)
        rhs = -part.divergence(theta * gas + alpha * new, np.empty(len(target)))
        blocks, divide = self.mobility(inverse, tensors)
        increment = self.system.solve(dt, stiffness, *blocks, rhs, divide)
        self.iterations.append(self.system.iterations)
        force = part.pressure_force(increment, force)
        new += dt * self.push(force)
        pressure.divide_by_mass(part.size, inverse, self.special, tensors, force)
        gas += dt * force
        gas[self.closed] = new[self.closed]
        self.P, self.now, self.stiffness = target + increment, new, stiffness

        work = self.work(0.5 * (solid + new), gas, ghost, dt)
        if len(self.open.nodes):
            work[self.open.nodes] -= self.open.power(gas) * self.theta[self.open.nodes]
        out = self.after_pressure(U, dt, before, gas, work / self.share)
        out[self.closed] = U[self.closed]
        return out

    def kicked(self, velocity):
        """(nq,) what the forces inside of the solid, which made its velocity that given, add to the pressure.

        The ghost matrix has to follow the velocity with which the particles will move: with that from before
        the stress has acted, it would lag behind and feed the solid's waves. Collective.
        """
        change = self.moved[:, None] * (self.lift(velocity) - self.now)
        return -self.part.divergence(change, np.empty(len(self.P))) / self.stiffness

    def targets(self, U, before, ghost, dt):
        """P* and S (nq,) of the gas and the ghost matrix together. Collective."""
        with np.errstate(all="ignore"):
            star, stiff = self.part.means(self.theta * U[:, 0], before.star, before.bulk)
            compliance = np.where(self.gas_volume > 0, self.gas_volume / stiff, 0)
        stiffness = compliance + self.compliance
        star = np.where(self.gas_volume > 0, star, 0)
        return (compliance * star + self.compliance * ghost) / stiffness, stiffness / dt

    def mobility(self, inverse, tensors):
        """What divides a force by the mass of both phases, see `PressureSystem.solve`."""
        size, special = self.part.size, self.special
        gas, solid = self.theta * inverse, self.moved**2 * self.lift(self.solid_inverse[:, None].copy())[:, 0]
        both = np.maximum(gas + solid, 1e-300)
        blocks = gas[special, None, None] * tensors + solid[special, None, None] * self.walls[1]
        fused = both, special, blocks / both[special, None, None]
        if self.ends is None:
            return fused, None

        def divide(force):
            by_solid = self.push(force)
            pressure.divide_by_mass(size, gas, special, tensors, force)
            force += self.moved[:, None] * by_solid

        return fused, divide

    def work(self, solid, gas, ghost, dt):
        """(n,) power of the pressure on the gas of each node, `lost` counting the rest. Collective."""
        part, s, out = self.part, self.part.space, np.zeros(len(self.theta))
        expansion = self.compliance * (ghost - self.P) / dt / s.pressure_volumes
        per_cell = s.cell_pressures.shape[1]
        expansion = expansion[s.cell_pressures] * (s.cell_volumes / per_cell)[:, None]
        lists = s.cell_nodes, s.cell_pressures, s.coefficients, s.weights
        shares = self.theta, self.moved, gas, solid
        self.lost += dt * add_work(part.shape, *lists, self.P, expansion, *shares, out)
        return part.sum_nodes(out)
