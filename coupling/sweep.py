"""Jacobi's preconditioner with a second sweep in the cells that hold solid.

There the ghost matrix is many times stiffer than the gas: sound crosses more of a cell in a step, and
conjugate gradients with Jacobi alone need an iteration more than in the gas (shell explosion: residuals fall
by 5e-3 against 7e-4). A second sweep squares that, and costs little in the few cells with solid.
"""

import numpy as np
from numba import njit

from .advection import options


@njit(**options)
def number_nodes(corners, cells, nodes, number, own):
    """Make `own` (k, corners) the numbers, in order of appearance, of the nodes of some cells; how many.

    `number` (n,) is -1 everywhere, before and after.
    """
    count = 0
    for k in range(len(cells)):
        for b in range(len(corners)):
            i = nodes[cells[k], b]
            if number[i] < 0:
                number[i] = count
                count += 1
            own[k, b] = number[i]
    for c in cells:
        for b in range(len(corners)):
            number[nodes[c, b]] = -1
    return count


@njit(**options)
def take_up(corners, size, cells, dofs, nodes, coefficients, dt, stiffness, mobility, inverse, own, matrix):
    """What `second_sweep` needs of some cells: sqrt(dt / M) A, and diagonal and S; returns max 1 - S / D."""
    most = 0.0
    for k in range(len(cells)):
        c = cells[k]
        q = dofs[c, 0]
        for b in range(len(corners)):
            scale = np.sqrt(dt * mobility[nodes[c, b]])
            for a in range(len(size)):
                own[k, b, a] = scale * coefficients[c, 0, b, a]
        matrix[k, 0], matrix[k, 1] = inverse[q], stiffness[q]
        most = max(most, 1.0 - inverse[q] * stiffness[q])
    return most


@njit(**options)
def second_sweep(corners, size, dofs, nodes, coefficients, matrix, relaxation, x, force, y):
    """Add to `y` (nq,), which is x / D, relaxation (x - B y) / D at some dofs (k,), see `SolidSweep`."""
    force[:] = 0.0
    for k in range(len(dofs)):
        p = y[dofs[k]]
        for b in range(len(corners)):
            for a in range(len(size)):
                force[nodes[k, b], a] += coefficients[k, b, a] * p
    for k in range(len(dofs)):
        q, total = dofs[k], 0.0
        for b in range(len(corners)):
            for a in range(len(size)):
                total += coefficients[k, b, a] * force[nodes[k, b], a]
        y[q] += relaxation * matrix[k, 0] * (x[q] - matrix[k, 1] * y[q] - total)


class SolidSweep:
    """The preconditioner of a `PressureSystem` with one pressure in each cell, for PETSc.

    It is D^-1 + r D^-1 (D - B) D^-1, D what Jacobi's method takes for the diagonal of S + dt A^T M^-1 A, and
    B the part of that matrix that belongs to this rank's cells with solid; at walls and open ends M^-1 is its
    mean over the directions, in D as in B. As the force at a node is the sum over its k cells,
    x . B x is at most x . (S + k (D - S)) x, and the preconditioner is positive definite if
    r (k - 1) (1 - S / D) < 1, which r is chosen for: one where sound crosses little of a cell in a step.

    Attributes
    ----------
    cells : numbers of the cells with solid, an array that is new whenever they change
    """

    def __init__(self, system):
        space = system.part.space
        self.system, self.cells, self.numbered = system, np.empty(0, np.int64), None
        self.lists = space.cell_pressures, space.cell_nodes, space.coefficients
        self.sizes = system.part.shape[1:]
        self.most = np.bincount(space.cell_nodes.ravel()).max(initial=1)
        self.number = np.full(len(space.points), -1, np.int32)
        self.diagonal = system.right.duplicate()
        system.use_preconditioner(self)

    def number_cells(self, cells):
        """Give the nodes of some cells numbers of their own."""
        (dofs, nodes, _), (corners, size) = self.lists, self.sizes
        self.numbered, self.dofs = cells, dofs[cells, 0]
        self.nodes = np.empty((len(cells), len(corners)), np.int32)
        count = number_nodes(corners, cells, nodes, self.number, self.nodes)
        self.force = np.empty((count, len(size)))
        self.coefficients, self.matrix = np.empty((*self.nodes.shape, len(size))), np.empty((len(cells), 2))

    def setUp(self, preconditioner):
        """Take up the matrix, for PETSc."""
        system = self.system
        if self.numbered is not self.cells:
            self.number_cells(self.cells)
        system.getDiagonal(None, self.diagonal)
        self.inverse = 1 / self.diagonal.array_r
        matrix = system.dt, system.stiffness, system.effective, self.inverse
        by_sound = take_up(*self.sizes, self.cells, *self.lists, *matrix, self.coefficients, self.matrix)
        self.relaxation = min(1.0, 0.9 / max((self.most - 1) * by_sound, 1e-300))

    def apply(self, preconditioner, x, y):
        """Apply it to x, for PETSc."""
        own = self.dofs, self.nodes, self.coefficients, self.matrix
        x, y = x.array_r, y.array
        np.multiply(x, self.inverse, out=y)
        second_sweep(*self.sizes, *own, self.relaxation, x, self.force, y)
