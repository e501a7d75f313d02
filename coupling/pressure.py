"""The implicit pressure: one symmetric positive definite system for its increment (thesis 3.2.7).

With A_bq = int chi_q grad phi_b, momentum and pressure of the implicit part are

    M u = M u* + dt (A P - w),      S (P - P*) + A^T u = 0,      S = diag(V_q / (rho c^2 dt)),

and, with u eliminated, (S + dt A^T M^-1 A) (P - P*) = -A^T (u* + dt M^-1 (A P* - w)). At walls M^-1 loses its
normal part, at inflows all of it. At outflows the pressure of the boundary is that of the wave which leaves,
p* + Z (u - u*) . n with the impedance Z = rho c: Z joins M, the rest is w, and nothing is reflected.
"""

import sys

import numpy as np
from numba import njit

from fempm.cli import split_petsc
from fempm.solver import SimulationError

from .advection import options

RTOL = 1e-6  # of a stage's change of pressure: after 150 steps states are 1e-8 from those solved to 1e-12


@njit(**options)
def pressure_force(shape, nodes, dofs, coefficients, pressure, out):
    """`out` (n, d) = A P; `shape` holds tuples as long as dofs and nodes per cell and dimensions."""
    per_cell, corners, size = shape
    out[:] = 0.0
    for c in range(len(nodes)):
        for q in range(len(per_cell)):
            p = pressure[dofs[c, q]]
            for b in range(len(corners)):
                for a in range(len(size)):
                    out[nodes[c, b], a] += coefficients[c, q, b, a] * p


@njit(**options)
def add_divergence(shape, nodes, dofs, coefficients, velocity, out):
    """Add A^T u to `out` (nq,)."""
    per_cell, corners, size = shape
    for c in range(len(nodes)):
        for q in range(len(per_cell)):
            total = 0.0
            for b in range(len(corners)):
                for a in range(len(size)):
                    total += coefficients[c, q, b, a] * velocity[nodes[c, b], a]
            out[dofs[c, q]] += total


@njit(**options)
def add_work(shape, nodes, dofs, coefficients, weights, pressure, velocity, out):
    """Add to `out` (n,) the energy that the pressure gives each node, which sums to zero in every cell.

    A node gets the work of the force on it, which is what its kinetic energy gains, and of the heat -P div u
    of the cell the share `weights`: so internal energy only falls where the gas expands.
    """
    per_cell, corners, size = shape
    for c in range(len(nodes)):
        for q in range(len(per_cell)):
            p, total = pressure[dofs[c, q]], 0.0
            for b in range(len(corners)):
                work = 0.0
                for a in range(len(size)):
                    work += coefficients[c, q, b, a] * velocity[nodes[c, b], a]
                out[nodes[c, b]] += p * work
                total += p * work
            for b in range(len(corners)):
                out[nodes[c, b]] -= weights[q, b] * total


@njit(**options)
def add_means(shape, nodes, dofs, weights, volumes, density, first, second, out):
    """Add to `out` (nq, 3) the integrals of rho, rho times `first` and rho times `second` (n,) each."""
    per_cell, corners, _ = shape
    for c in range(len(nodes)):
        for q in range(len(per_cell)):
            mass = one = other = 0.0
            for b in range(len(corners)):
                i = nodes[c, b]
                share = weights[q, b] * density[i]
                mass += share
                one += share * first[i]
                other += share * second[i]
            volume = volumes[c] / len(per_cell)
            out[dofs[c, q], 0] += mass * volume
            out[dofs[c, q], 1] += one * volume
            out[dofs[c, q], 2] += other * volume


@njit(**options)
def before_solve(size, U, pressure, carried, expansion, shock, dt, volumes, gravity, velocity, inverse, star):
    """Velocity, 1 / (m rho) and P* at the nodes; `expansion` (n,) is m div u of the advection.

    What advection has compressed comes off the pressure again, since the implicit part acts on all of
    rho c^2 div u. Not in shocks: there, counting the compression twice is the bulk viscosity that they need.
    Nor where little pressure would be left; returns at how many nodes.
    """
    kept = 0
    for i in range(len(U)):
        inverse[i] = 1.0 / (volumes[i] * U[i, 0])
        for a in range(len(size)):
            velocity[i, a] = U[i, 1 + a] / U[i, 0]
            if gravity is not None:
                velocity[i, a] += dt * gravity[a]
        step = dt * expansion[i] / volumes[i]
        smooth = 1.0 / (1.0 + (min(step, 0.0) / shock) ** 2)
        star[i] = pressure[i] + carried[i] * step * smooth
        if not star[i] > 0.25 * pressure[i]:
            star[i] = pressure[i]
            kept += 1
    return kept


@njit(**options)
def after_solve(size, velocity, work, outflow, dt, volumes, gravity, U, out):
    """Conserved variables `out` from those before, U, the new velocity, and work - outflow on the energy."""
    for i in range(len(U)):
        energy = U[i, len(size) + 1] + dt * (work[i] - outflow[i]) / volumes[i]
        for a in range(len(size)):
            out[i, 1 + a] = U[i, 0] * velocity[i, a]
            if gravity is not None:
                energy += dt * out[i, 1 + a] * gravity[a]
        out[i, 0] = U[i, 0]
        out[i, len(size) + 1] = energy


@njit(**options)
def accelerate(size, inverse, dt, force, velocity):
    """Make a velocity (n, d) a momentum, by 1 / mass (n,), and add dt times the force (n, d)."""
    for i in range(len(inverse)):
        mass = 1.0 / inverse[i]
        for a in range(len(size)):
            velocity[i, a] = mass * velocity[i, a] + dt * force[i, a]


@njit(**options)
def divide_by_mass(size, inverse, special, tensors, force):
    """Make a force (n, d) a velocity: `inverse` (n,) of the mass, `tensors` (k, d, d) at `special` nodes."""
    x = np.empty(len(size))
    for k in range(len(special)):
        i = special[k]
        for a in range(len(size)):
            x[a] = force[i, a]
        for a in range(len(size)):
            force[i, a] = 0.0
            for b in range(len(size)):
                force[i, a] += tensors[k, a, b] * x[b]
    for i in range(len(inverse)):
        for a in range(len(size)):
            force[i, a] *= inverse[i]


@njit(**options)
def add_stiffness(dt, stiffness, x, out):
    """Make `out` (nq,) dt `out` + S x."""
    for q in range(len(out)):
        out[q] = dt * out[q] + stiffness[q] * x[q]


@njit(**options)
def add_diagonal(nodes, dofs, squares, inverse, out):
    """Add to `out` (nq,) the diagonal of A^T M^-1 A."""
    for k in range(len(nodes)):
        out[dofs[k]] += squares[k] * inverse[nodes[k]]


class StepFailed(ArithmeticError):
    """A step that cannot be made with its length."""


class PressureSystem:
    """The matrix S + dt A^T M^-1 A, applied cell by cell, and its PETSc solver.

    Conjugate gradients with Jacobi's preconditioner (or that given to `use_preconditioner`), to `RTOL` of the
    right hand side, unless PETSc's options (-ksp_rtol, -ksp_monitor, ... on the command line or in
    PETSC_OPTIONS) say otherwise.

    Parameters
    ----------
    part : Part, the space of this rank
    more : unknowns of this rank beside the pressures

    Attributes
    ----------
    iterations : of the last solve
    effective : (n,) 1 / M, its mean over the directions, that the diagonal was last computed with
    """

    def __init__(self, part, more=0):
        from fempm import compat  # noqa: F401, before PETSc: see there

        # isort: split
        from mpi4py import MPI
        from petsc4py import PETSc

        self.part, self.iterations = part, 0
        space = part.space
        self.pressure, self.result = (np.zeros(len(space.pressure_volumes)) for _ in range(2))
        self.velocity = np.empty_like(space.points)
        comm = part.ranks.comm or MPI.COMM_SELF
        sizes = ((part.num_owned + more, None),) * 2
        matrix = PETSc.Mat().createPython(sizes, self, comm)
        matrix.setOption(PETSc.Mat.Option.SPD, True)
        matrix.setUp()
        for name, value in split_petsc(sys.argv)[1]:
            PETSc.Options().setValue(name, value)
        self.ksp = PETSc.KSP().create(comm)
        self.ksp.setOperators(matrix)
        self.ksp.setType("cg")
        self.ksp.getPC().setType("jacobi")
        self.ksp.setTolerances(rtol=RTOL, atol=0.0, max_it=2000)
        self.ksp.setFromOptions()
        self.right, self.left = matrix.createVecs()

    def use_preconditioner(self, context):
        """Let a Python object precondition, unless PETSc's options choose another way."""
        self.ksp.getPC().setType("python")
        self.ksp.getPC().setPythonContext(context)
        self.ksp.setFromOptions()

    def solve(self, dt, stiffness, inverse, special, tensors, rhs, mobility=None):
        """Solve (stiffness + dt A^T M^-1 A) x = rhs; returns x (nq,).

        Parameters
        ----------
        dt : time step
        stiffness, rhs : (nq,)
        inverse, special, tensors : M^-1, see `divide_by_mass`
        mobility : function that applies M^-1 in place to (n, d), where it is not these blocks; they then are
            what its diagonal is taken from

        Raises
        ------
        SimulationError
            if PETSc needs more iterations than it may have
        StepFailed
            if it breaks down, with its reason
        """
        self.dt, self.stiffness, self.mass = dt, stiffness, (inverse, special, tensors)
        self.mobility = mobility
        return self.part.spread(self.solve_for(rhs[self.part.owned]))

    def solve_for(self, rhs):
        """The solution for a right hand side, both of this rank's unknowns, after `mult` knows its matrix."""
        from petsc4py import PETSc

        self.right.array[:] = rhs
        self.ksp.getOperators()[0].assemble()
        self.ksp.solve(self.right, self.left)
        self.iterations = self.ksp.getIterationNumber()
        reason = self.ksp.getConvergedReason()
        if reason == PETSc.KSP.ConvergedReason.DIVERGED_MAX_IT:
            raise SimulationError(
                f"the pressure did not converge in {self.iterations} iterations of PETSc: "
                "take a smaller time step or a higher -ksp_max_it"
            )
        if reason < 0:
            raise StepFailed(f"PETSc cannot solve for the pressure (reason {reason})")
        return self.left.array_r

    def mult(self, matrix, x, y):
        """y = (S + dt A^T M^-1 A) x, for PETSc."""
        part = self.part
        self.pressure[:] = part.spread(x.array_r)
        force = part.pressure_force(self.pressure, self.velocity)
        if self.mobility is None:
            divide_by_mass(part.size, *self.mass, force)
        else:
            self.mobility(force)
        part.divergence(force, self.result)
        add_stiffness(self.dt, self.stiffness, self.pressure, self.result)
        y.array[:] = self.result[part.owned]

    def getDiagonal(self, matrix, diagonal):
        """Diagonal of the matrix, for PETSc."""
        space, (inverse, special, tensors) = self.part.space, self.mass
        self.effective = inverse.copy()
        self.effective[special] *= np.trace(tensors, axis1=1, axis2=2) / space.dim
        sums = self.stiffness.copy()
        add_diagonal(*self.part.pairs, self.dt * self.effective, sums)
        diagonal.array[:] = sums[self.part.owned]
