"""The sharp interface of the thesis (system 3.37), for comparison with the mixture: 1D and 2D, one rank.

Every cell belongs to the gas or to the solid; vertices between them have both velocities. There,
multipliers h make the normal velocities equal (thesis 3.30), with N_i = int_Gamma phi_i n out of the gas:

    m_f u_f = m_f u_f* + dt (A_f P - N h),   m_s u_s = m_s u_s* + dt (A_s P + N h),   N . (u_f - u_s) = 0,

with the pressures P of the cells of either kind. Eliminating the velocities leaves a symmetric positive
definite system for P and h. It is the mixture with other volumes: a vertex's gas fills its gas cells.
"""

import numpy as np

from . import pressure
from .mixture import Mixture, add_gas_work


class SharpSystem(pressure.PressureSystem):
    """The matrix of (3.37) for the increments of pressures and multipliers, one of these for every node."""

    def __init__(self, part):
        super().__init__(part, more=len(part.space.points))

    def solve_both(self, stages, dt, stiffness, by_gas, by_solid, rhs):
        """Increments of P (nq,) and h (n,); `by_gas` and `by_solid` divide forces (n, d) by the masses."""
        self.stages, self.dt, self.stiffness = stages, dt, stiffness
        self.by_gas, self.by_solid = by_gas, by_solid
        both = self.solve_for(rhs)
        return both[: len(stiffness)].copy(), both[len(stiffness) :].copy()

    def mult(self, matrix, x, y):
        """y = matrix times x, for PETSc."""
        n = len(self.stiffness)
        pressures, multipliers = x.array_r[:n], x.array_r[n:]
        gas, solid = self.stages.forces(pressures, multipliers)
        self.by_gas(gas), self.by_solid(solid)
        flux, slip = self.stages.constraints(gas, solid)
        y.array[:n] = self.stiffness * pressures + self.dt * flux
        y.array[n:] = np.where(self.stages.tied, self.dt * slip, multipliers)

    def getDiagonal(self, matrix, diagonal):
        """Diagonal of the matrix, for PETSc; of the pressures' part an estimate from the lighter phase."""
        n, stages = len(self.stiffness), self.stages
        ones = np.ones_like(stages.normal)
        gas, solid = (by(ones.copy()).max(axis=1) for by in (self.by_gas, self.by_solid))
        sums = self.stiffness.copy()
        nodes, dofs, squares = self.part.pairs
        mass = np.where(stages.of_gas[dofs], gas[nodes], solid[nodes])
        np.add.at(sums, dofs, self.dt * squares * mass)
        diagonal.array[:n] = sums
        diagonal.array[n:] = np.where(stages.tied, self.dt * stages.slip, 1.0)


class Sharp(Mixture):
    """The stages of a step of gas beside a solid with a sharp interface, see `Mixture`.

    Attributes
    ----------
    of_gas : (nc,) whether a cell, and its pressure, belongs to the gas
    normal : (n, d) N_i; tied : (n,) nodes at the interface
    """

    def __init__(self, part, *args):
        if part.ranks.size > 1 or part.space.dim > 2 or part.shape[0] != (1,) or len(part.shape[1]) > 3:
            raise ValueError(
                "interface 'sharp' is for comparison, in 1D and 2D with B1-B0 and on one rank: take 'mixture'"
            )
        super().__init__(part, *args)
        self.system, self.sweep = SharpSystem(part), None

    def divide_cells(self, of_gas):
        """Give every cell to the gas or to the solid; returns the open shares (n,) of the nodes."""
        s = self.part.space
        self.of_gas, d = of_gas, s.dim
        coefficients = s.coefficients[:, 0]
        self.normal = np.zeros_like(s.points)
        np.add.at(self.normal, s.cell_nodes[of_gas], coefficients[of_gas])
        gas, solid = (np.zeros(len(s.points), bool) for _ in range(2))
        gas[s.cell_nodes[of_gas]] = True
        solid[s.cell_nodes[~of_gas]] = True
        self.tied = gas & solid
        self.normal[~self.tied] = 0
        volumes = np.bincount(
            s.cell_nodes[of_gas].ravel(), np.repeat(s.cell_volumes[of_gas], d + 1), len(gas)
        )
        self.graph = self.part_graph(np.flatnonzero(~of_gas))
        return np.where(solid, volumes / (d + 1) / s.volumes, 1.0)

    def part_graph(self, solid):
        """c_ij and c_ji of the edges without the cells of the solid."""
        s = self.part.space
        forward, backward = s.forward.copy(), s.backward.copy()
        keys = s.edges.astype(np.int64) @ [len(s.points), 1]
        order = np.argsort(keys)
        for a in range(s.dim + 1):
            for b in range(a + 1, s.dim + 1):
                i, j = s.cell_nodes[solid, a].astype(np.int64), s.cell_nodes[solid, b].astype(np.int64)
                lower, upper = np.minimum(i, j), np.maximum(i, j)
                e = order[np.searchsorted(keys, lower * len(s.points) + upper, sorter=order)]
                at_i, at_j = (s.coefficients[solid, 0, k] / (s.dim + 1) for k in (a, b))
                turned = (i > j)[:, None]
                np.subtract.at(forward, e, np.where(turned, at_i, at_j))
                np.subtract.at(backward, e, np.where(turned, at_j, at_i))
        return forward, backward

    def begin(self, theta, openness, flat, *solid):
        flat = np.union1d(flat, np.flatnonzero(self.tied))
        super().begin(theta, None, flat, *solid)
        volumes, of_gas = self.part.space.cell_volumes[self.soft], self.of_gas[self.soft]
        self.compliance = np.where(of_gas, 0.0, np.maximum(self.compliance, 1e-12 * volumes))
        self.gas_volume = np.where(of_gas, volumes, 0.0)
        self.h = np.zeros(len(theta))

    def forces(self, pressures, multipliers):
        """(n, d) forces on gas and solid."""
        part = self.part
        push = multipliers[:, None] * self.normal
        gas = part.pressure_force(np.where(self.of_gas, pressures, 0.0), np.empty_like(self.normal))
        solid = part.pressure_force(np.where(self.of_gas, 0.0, pressures), np.empty_like(self.normal))
        return gas - push, solid + push

    def constraints(self, gas, solid):
        """(nq,) volume flux out of the cells, of either phase, and (n,) slip in the normal direction."""
        parts = [self.part.divergence(u, np.empty(len(self.of_gas))) for u in (gas, solid)]
        slip = -np.sum(self.normal * (gas - solid), axis=1)
        return np.where(self.of_gas, *parts), slip

    def implicit_pressure(self, U, dt, advected=None, star=None):
        """The conserved variables of the gas after the pressure has acted on it and the solid."""
        size, before = self.part.size, self.before_pressure(U, dt, advected, star)
        inverse, tensors = before.inverse / self.share, self.free_directions(dt, before.inverse / self.share)
        inverse[self.closed] = 0
        solid, ghost = self.before_stage(star is not None)
        target, stiffness = self.targets(U, before, ghost, dt)

        def by_gas(force):
            pressure.divide_by_mass(size, inverse, self.special, tensors, force)
            return force

        def by_solid(force):
            pressure.divide_by_mass(size, self.inverse, self.special, self.walls, force)
            return force

        self.slip = self.constraints(by_gas(-self.normal), by_solid(self.normal.copy()))[1]
        self.tied &= self.slip > 1e-9 * self.slip.max(initial=0)  # not where walls hold both phases
        at_nodes = np.where(self.tied, self.mean_pressure(target), 0.0)  # h begins at the pressure around
        on_gas, on_solid = self.forces(target, at_nodes)
        if len(self.open.nodes):
            on_gas[self.open.nodes] -= self.open.carried
        gas = before.velocity + dt * by_gas(on_gas)
        gas[self.fixed] = self.fixed_state[:, 1:-1]
        new = solid + dt * by_solid(on_solid)
        flux, slip = self.constraints(gas, new)
        rhs = -np.concatenate([flux, np.where(self.tied, slip, 0.0)])
        increment, more = self.system.solve_both(self, dt, stiffness, by_gas, by_solid, rhs)
        self.iterations.append(self.system.iterations)
        on_gas, on_solid = self.forces(increment, more)
        gas += dt * by_gas(on_gas)
        new += dt * by_solid(on_solid)
        self.h = at_nodes + more
        gas[self.closed] = new[self.closed]
        self.P, self.now, self.stiffness = target + increment, new, stiffness

        work = self.gas_work(gas, 0.5 * (solid + new), before.internal)
        if len(self.open.nodes):
            work[self.open.nodes] -= self.open.power(gas)
        return self.after_pressure(U, dt, before, gas, self.per_open_volume(work))

    def mean_pressure(self, values):
        """(n,) means of the pressures (nc,) of the cells around each node."""
        s = self.part.space
        weights = np.repeat(s.cell_volumes, s.dim + 1)
        total = np.bincount(s.cell_nodes.ravel(), weights * np.repeat(values, s.dim + 1), len(s.points))
        return total / (s.volumes * (s.dim + 1))

    def gas_work(self, gas, solid, internal):
        """(n,) power of pressures and multipliers on the gas of each node."""
        part, s = self.part, self.part.space
        out = np.zeros(len(self.theta))
        lists = s.cell_nodes, s.cell_pressures, s.coefficients, s.weights
        add_gas_work(part.shape, *lists, self.of_gas, self.P, gas, internal, out)
        return out - self.h * np.sum(self.normal * solid, axis=1)

    def kicked(self, velocity):
        flux = self.part.divergence(velocity - self.now, np.empty(len(self.P)))
        return (-np.where(self.of_gas, 0.0, flux) / self.stiffness)[self.soft]
