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

from . import pressure, push
from .advection import options
from .stages import Stages
from .sweep import SolidSweep

EXTRAPOLATE = 1 + np.sqrt(2)  # (1 - gamma) / gamma of the two-stage scheme


@njit(**options)
def add_gas_work(shape, nodes, dofs, coefficients, weights, dry, pressure, velocity, internal, out):
    """`add_work` in the cells of gas alone, those marked `dry` (nc,)."""
    per_cell, corners, size = shape
    work, share = np.empty(len(corners)), np.empty(len(corners))
    for c in range(len(nodes)):
        if not dry[c]:
            continue
        for q in range(len(per_cell)):
            p, taken, shares = pressure[dofs[c, q]], 0.0, 0.0
            for b in range(len(corners)):
                i, own = nodes[c, b], 0.0
                for a in range(len(size)):
                    own += coefficients[c, q, b, a] * velocity[i, a]
                work[b] = p * own
                taken += p * own
            for b in range(len(corners)):
                share[b] = weights[q, b] * (internal[nodes[c, b]] if taken > 0.0 else 1.0)
                shares += share[b]
            each = taken / shares
            for b in range(len(corners)):
                out[nodes[c, b]] += work[b] - share[b] * each


@njit(**options)
def add_work(
    shape, nodes, dofs, coefficients, weights, volumes, wet, pressures, theta, alpha, internal, phases, out
):
    """Add to `out` (n,) the energy that the pressure gives to each node's gas; returns what no gas takes.

    A node gets the work on its gas, and of the heat -P times the expansion of the gas in a cell a share. The
    expansion is what the flux of both phases leaves when that of the ghost matrix is taken off: so the gas
    loses what the solid and its ghost gain. What an expansion takes, the nodes pay according to their energy
    `internal` (n,) per open volume: between hot gas and a vacuum they have no equal shares to give.
    `wet` lists the cells where there is solid; `pressures` are P, that of the ghost matrix, the volume by
    which it expands for a difference of the two, the volume of each of them (nq,), and dt; `phases` (n, d)
    are the velocities of the gas, and of the solid before and after.
    """
    (per_cell, corners, size), (P, ghost, taken_up, whole, dt) = shape, pressures
    gas, old, new = phases
    lost, share = 0.0, np.empty(len(corners))
    for c in wet:
        for q in range(len(per_cell)):
            k = dofs[c, q]
            p, total, shares = P[k], 0.0, 0.0
            for b in range(len(corners)):
                i, own = nodes[c, b], 0.0
                for a in range(len(size)):
                    own += theta[i] * coefficients[c, q, b, a] * gas[i, a]
                    total += 0.5 * alpha[i] * coefficients[c, q, b, a] * (old[i, a] + new[i, a])
                out[i] += p * own
                total += own
            total -= taken_up[k] * (ghost[k] - p) * volumes[c] / (whole[k] * dt * len(per_cell))
            taken = p * total
            for b in range(len(corners)):
                i = nodes[c, b]
                share[b] = weights[q, b] * theta[i] * (internal[i] if taken > 0.0 else 1.0)
                shares += share[b]
            if shares > 0.0:
                for b in range(len(corners)):
                    out[nodes[c, b]] -= share[b] * (taken / shares)
            else:
                lost -= taken
    return lost


@njit(**options)
def cells_near(corners, nodes, near, dry):
    """Numbers of the cells that have a node marked `near` (n,); `dry` (nc,) becomes 1 in all others."""
    numbers, count = np.empty(len(nodes), np.int64), 0
    for c in range(len(nodes)):
        found = 0
        for b in range(len(corners)):
            found |= near[nodes[c, b]]
        dry[c] = 1 - found
        numbers[count] = c
        count += found
    return numbers[:count].copy()


@njit(**options)
def add_filled(shape, nodes, dofs, weights, volumes, wet, theta, compliance, ghost, soft, out):
    """Add to `out` (nq, 3) int alpha, int alpha / (lambda_g J_g) and that times p_g, in the cells `wet`.

    `compliance` (n,) and `ghost` are alpha / (lambda_g J_g) and that times p_g at the nodes. Marks the
    pressures of these cells as `soft` (nq,).
    """
    per_cell, corners, _ = shape
    for c in wet:
        for q in range(len(per_cell)):
            soft[dofs[c, q]] = 1
            for b in range(len(corners)):
                share = weights[q, b] * volumes[c] / len(per_cell)
                i = nodes[c, b]
                out[dofs[c, q], 0] += share * (1.0 - theta[i])
                out[dofs[c, q], 1] += share * compliance[i]
                out[dofs[c, q], 2] += share * ghost[i]


@njit(**options)
def add_ghost(soft, gas_volume, compliance, ghost, stiff, dt, target, stiffness):
    """Make P* and S (nq,) of the gas those of gas and ghost matrix at the `soft` pressures.

    `stiff` (nq,) is the gas's rho c^2, `ghost` (nq,) the other's P*; `gas_volume` and `compliance` (k,).
    """
    for k in range(len(soft)):
        q = soft[k]
        if compliance[k] == 0.0:
            stiffness[q] = gas_volume[k] / (stiff[q] * dt)
            continue
        gas = gas_volume[k] / stiff[q] if gas_volume[k] > 0.0 else 0.0
        push = gas * target[q] if gas > 0.0 else 0.0
        target[q] = (push + compliance[k] * ghost[q]) / (gas + compliance[k])
        stiffness[q] = (gas + compliance[k]) / dt


class Mixture(Stages):
    """The stages of a step of gas beside a solid, see `Stages`; `begin` tells them where the solid is.

    Attributes
    ----------
    theta : (n,) open share of the dual cells; wet, closed : nodes where it is not all, and none
    soft : numbers of the pressures that the solid has a part in; compliance, gas_volume : of these
    wet_cells : numbers of the cells with solid; dry : (nc,) marks all others
    start, now : (n, d) velocity of the solid at the nodes when the step begins, and after the last stage
    ghost : (nq,) pressure of the ghost matrix as the step begins; P : the last pressure
    lost : energy that the pressure gave to vertices without gas in this step
    """

    def __init__(self, *args):
        super().__init__(*args)
        part, s = self.part, self.part.space
        d = s.dim
        self.sweep = SolidSweep(self.system) if s.cell_pressures.shape[1] == 1 else None
        self.walls = self.free.copy()  # of the solid, at special nodes: not held at inflows
        self.walls[np.isin(self.special, self.fixed)] = np.eye(d)
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
        free[old], walls[old] = self.free, self.walls
        at = np.searchsorted(special, vertices)
        walls[at] = project @ walls[at]
        self.open_special = old[self.open_special]
        self.special, self.free, self.walls = special, free, walls
        self.place = np.full(len(self.part.nodes), -1, np.int32)
        self.place[special] = np.arange(len(special))

    def begin(self, theta, openness, flat, velocity, inverse_mass, filled, ghost, taken, soft, cells, merge):
        """Take up the solid at the start of a step.

        Parameters
        ----------
        theta : (n,) open shares; openness : (ne,) of the dual faces
        flat : nodes beside closed ones, where states are not reconstructed
        velocity, inverse_mass : (n, d), (n,) of the solid, at vertices
        filled : (nq, 2 or more) int alpha and int alpha / (lambda_g J_g); ghost : (nq,) pressure p_g
        taken : (nq,) sums of V / lambda_g of the particles, with which their ghost matrix takes a change up
        soft : see above; cells : `wet_cells` and `dry`
        merge : function that gives nodes which share a state that state, in conserved variables (n, d + 2)
        """
        s = self.part.space
        self.theta, self.openness, self.flat = theta, openness, flat
        self.wet, self.closed = np.flatnonzero(theta < 1), np.flatnonzero(theta == 0)
        self.share = theta.copy()
        self.share[self.closed] = 1
        self.volumes = self.share * s.volumes
        self.start, self.inverse = self.lift(velocity), self.lift(inverse_mass[:, None])[:, 0]
        self.moved = np.zeros(len(theta))
        self.moved[self.wet] = (1 - theta[self.wet]) * (self.inverse[self.wet] > 0)
        self.pushed = self.wet if self.ends is None else np.flatnonzero(inverse_mass)
        self.taken, self.soft, self.merge = taken, soft, merge
        self.wet_cells, self.dry = cells
        if self.sweep is not None:
            self.sweep.cells = self.wet_cells
        self.compliance, left = filled[soft, 1], s.pressure_volumes[soft] - filled[soft, 0]
        self.gas_volume = np.where(left < 1e-12 * s.pressure_volumes[soft], 0, left)
        self.now, self.P, self.ghost, self.lost = self.start, ghost, ghost, 0.0

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
        return self.per_open_volume(super().outflow_of(velocity, values))

    def per_open_volume(self, values):
        """Values (n,) per dual volume divided by its open share, in place."""
        values[self.wet] /= self.share[self.wet]
        return values

    def add_push(self, dt, force, velocity):
        """Add to the solid's velocity (n, d) what a force (n, d) on both phases does in dt. Collective."""
        share = self.moved
        if self.ends is not None:
            force, share = self.lower(self.moved[:, None] * force), np.ones(len(force))
        fixed = share, self.inverse, self.place, self.walls, dt
        push.add_push(self.part.size, self.pushed, *fixed, force, velocity)
        return self.lift(velocity)

    def implicit_pressure(self, U, dt, advected=None, star=None):
        """The conserved variables of the gas after the pressure has acted on it and the solid. Collective."""
        part, before = self.part, self.before_pressure(U, dt, advected, star)
        inverse, tensors = before.inverse, self.free_directions(dt, before.inverse)
        solid, ghost = self.before_stage(star is not None)
        target, stiffness = self.targets(U, before, ghost, dt)

        force = self.force(target)
        gas = before.velocity
        pressure.accelerate(part.size, inverse, dt, force, gas)
        pressure.divide_by_mass(part.size, inverse, self.special, tensors, gas)
        gas[self.fixed] = self.fixed_state[:, 1:-1]
        new = self.add_push(dt, force, solid.copy())
        flux = gas.copy()
        push.mix(part.size, self.wet, self.theta, self.moved, gas, new, flux)
        rhs = -part.divergence(flux, np.empty(len(target)))
        blocks, divide = self.mobility(inverse, tensors)
        increment = self.system.solve(dt, stiffness, *blocks, rhs, divide)
        self.iterations.append(self.system.iterations)
        force = part.pressure_force(increment, force)
        self.add_push(dt, force, new)
        pressure.divide_by_mass(part.size, inverse, self.special, tensors, force)
        gas += dt * force
        gas[self.closed] = new[self.closed]
        self.P, self.now, self.stiffness = target + increment, new, stiffness

        work = self.work(solid, new, gas, ghost, before.internal, dt)
        if len(self.open.nodes):
            work[self.open.nodes] -= self.open.power(gas) * self.theta[self.open.nodes]
        return self.after_pressure(U, dt, before, gas, self.per_open_volume(work))

    def before_stage(self, second):
        """Velocity (n, d) of the solid and pressure (nq,) of its ghost that a stage starts from."""
        if not second:
            return self.start, self.ghost
        velocity, ghost = self.start.copy(), self.ghost.copy()
        at, soft = self.pushed, self.soft
        velocity[at] += EXTRAPOLATE * (self.now[at] - self.start[at])
        ghost[soft] += EXTRAPOLATE * (self.P[soft] - self.ghost[soft])
        return velocity, ghost

    def after_pressure(self, U, dt, before, velocity, work):
        """See `Stages`; what stands for gas at closed nodes stays. Collective."""
        out = super().after_pressure(U, dt, before, velocity, work)
        out[self.closed] = U[self.closed]
        return self.merge(out)

    def kicked(self, velocity):
        """What the forces inside of the solid, which made its velocity that given, add to `soft` pressures.

        The ghost matrix has to follow the velocity with which the particles will move: with that from before
        the stress has acted, it would lag behind and feed the solid's waves. Collective.
        """
        s, flux, soft = self.part.space, np.zeros(len(self.P)), self.soft
        lists = s.cell_nodes, s.cell_pressures, s.coefficients
        states = self.moved, self.now, self.lift(velocity)
        push.add_expansion(self.part.shape, self.wet_cells, *lists, *states, flux)
        return -self.part.sum_dofs(flux)[soft] / self.stiffness[soft]

    def targets(self, U, before, ghost, dt):
        """P* and S (nq,) of the gas and the ghost matrix together. Collective."""
        with np.errstate(all="ignore"):  # cells without gas
            target, stiff = self.part.means(self.theta * U[:, 0], before.star, before.bulk)
            stiffness = self.part.space.pressure_volumes / (stiff * dt)
        add_ghost(self.soft, self.gas_volume, self.compliance, ghost, stiff, dt, target, stiffness)
        return target, stiffness

    def mobility(self, inverse, tensors):
        """What divides a force by the mass of both phases, see `PressureSystem.solve`."""
        special, both = self.special, inverse.copy()
        push.mix_mobility(self.wet, self.theta, self.moved, self.inverse, both)
        gas = inverse[special] * self.theta[special]
        solid = self.moved[special] ** 2 * self.inverse[special]
        blocks = gas[:, None, None] * tensors + solid[:, None, None] * self.walls
        fused = both, special, blocks / both[special, None, None]
        if self.ends is None:
            return fused, None
        of_gas = inverse * self.theta

        def divide(force):
            by_solid = self.add_push(1.0, force, np.zeros_like(force))
            pressure.divide_by_mass(self.part.size, of_gas, special, tensors, force)
            force += self.moved[:, None] * by_solid

        return fused, divide

    def work(self, old, new, gas, ghost, internal, dt):
        """(n,) power of the pressure on the gas of each node, `lost` counting the rest. Collective."""
        part, s, out = self.part, self.part.space, np.zeros(len(self.theta))
        lists = part.shape, s.cell_nodes, s.cell_pressures, s.coefficients, s.weights
        add_gas_work(*lists, self.dry, self.P, gas, internal, out)
        pressures = self.P, ghost, self.taken, s.pressure_volumes, dt
        solid = s.cell_volumes, self.wet_cells, pressures, self.theta, self.moved
        self.lost += dt * add_work(*lists, *solid, internal, (gas, old, new), out)
        return part.sum_nodes(out)
