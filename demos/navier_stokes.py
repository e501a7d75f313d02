"""Incompressible flow in two dimensions: P2 velocity, P1 pressure, incremental pressure correction.

Second order in time: BDF2, extrapolated convection, rotational pressure correction (Guermond, Minev and Shen,
Comput. Methods Appl. Mech. Engrg. 195, 2006). Only w is stored, the velocity with the right boundary values;
w - grad psi is the one without divergence:

    rho (b w - 2 w' + w'' / 2) / dt + rho C - mu lap w + grad(p' + rho (2 psi' - psi'' / 2) / dt) = 0,
    lap psi = div w,      p = p' + b rho psi / dt - mu div w,      b = 3 / 2,

with ' for the step before and C = w . grad w, extrapolated. So all matrices are constant, factorised once.
"""

import numpy as np
import scipy.sparse as sparse
from scipy.sparse.linalg import splu

from fempm import compat

# isort: split
import ufl
from dolfinx import fem

# Second order; with BDF2 undamped waves are stable for omega dt < 0.67, with the usual 2, -1 for none.
EXTRAPOLATION = np.array([2.5, -2.0, 0.5])


class IncompressibleFlow:
    """Flow from an inlet with given velocity, past walls without slip, to an outlet with pressure zero.

    It starts as Stokes flow, so that nothing is set in motion suddenly at time zero.

    Parameters
    ----------
    mesh : dolfinx.mesh.Mesh of triangles, on one process
    inlet, walls, outlet : arrays of facets; where inlet and walls meet the velocity is zero
    inflow : function of x (n, 2) in m for the velocity (n, 2) in m/s
    dt : time step in s
    density, viscosity : in kg/m^3 and Pa s

    Attributes
    ----------
    time : in s
    velocity : (2, n) at vertices and middles of edges, in m/s
    pressure : (m,) at vertices, in Pa; both in the order of DOLFINx's degrees of freedom
    """

    def __init__(self, mesh, inlet, walls, outlet, inflow, dt, density=1.0, viscosity=1e-3):
        if mesh.comm.size > 1:
            raise ValueError(f"the mesh is spread over {mesh.comm.size} processes: make it on MPI.COMM_SELF")
        if not dt > 0:
            raise ValueError(f"the time step dt = {dt} is not positive")
        self.mesh, self.dt, self.density, self.viscosity = mesh, dt, density, viscosity
        self._space = compat.functionspace(mesh, ("Lagrange", 2))
        self._pressures = compat.functionspace(mesh, ("Lagrange", 1))
        self._assemble()
        n, m = self._gradient[0].shape
        entry, fixed = (fem.locate_dofs_topological(self._space, 1, facets) for facets in (inlet, walls))
        boundary = np.zeros((2, n))
        boundary[:, entry] = inflow(self._space.tabulate_dof_coordinates()[entry, :2]).T
        boundary[:, fixed] = 0
        self._free = np.setdiff1d(np.arange(n), np.union1d(entry, fixed))
        self._closed = np.setdiff1d(np.arange(m), fem.locate_dofs_topological(self._pressures, 1, outlet))
        self._project = _inverse(self._mass_p)
        self._poisson = _inverse(self._stiffness_p[self._closed][:, self._closed])
        cells, dofs = compat.cell_vertices(mesh), (self._space.dofmap, self._pressures.dofmap)
        self._at_vertices = np.empty((2, mesh.topology.index_map(0).size_local), int)
        for c, vertices in enumerate(cells):
            self._at_vertices[:, vertices] = [d.cell_dofs(c)[:3] for d in dofs]
        self._start(boundary)

    def _assemble(self):
        u, v = ufl.TrialFunction(self._space), ufl.TestFunction(self._space)
        p, q = ufl.TrialFunction(self._pressures), ufl.TestFunction(self._pressures)
        self._mass, self._stiffness = _matrix(u * v), _matrix(ufl.inner(ufl.grad(u), ufl.grad(v)))
        self._mass_p, self._stiffness_p = _matrix(p * q), _matrix(ufl.inner(ufl.grad(p), ufl.grad(q)))
        self._gradient = [_matrix(p * v.dx(k)) for k in range(2)]
        vectors = compat.functionspace(self.mesh, ("Lagrange", 2, (2,)))
        self._transported = w = fem.Function(vectors)
        test, n = ufl.TestFunction(vectors), ufl.FacetNormal(self.mesh)
        # What comes back through the outlet must not bring energy in; this term is nothing elsewhere.
        back = ufl.min_value(ufl.dot(w, n), 0) / 2 * ufl.inner(w, test) * ufl.ds(degree=6)
        self._convection_form = fem.form(ufl.inner(ufl.grad(w) * w, test) * ufl.dx - back)

    def _start(self, boundary):
        """Stokes flow, from one system for velocity and pressure."""
        n, m = self._gradient[0].shape
        K, (G, H) = self.viscosity * self._stiffness, self._gradient
        A = sparse.bmat([[K, None, -G], [None, K, -H], [-G.T, -H.T, None]], "csr")
        x = np.concatenate([*boundary, np.zeros(m)])
        free = np.concatenate([self._free, n + self._free, 2 * n + np.arange(m)])
        x[free] = splu(A[free][:, free].tocsc()).solve(-(A @ x)[free])
        self.velocity, self.pressure, self.time = x[: 2 * n].reshape(2, n), x[2 * n :], 0.0
        self._older, self._psi = self.velocity, np.zeros((2, m))
        self._boundary, self._acceleration, self._strongest = boundary, np.zeros((2, n)), 0.0
        self._convection = np.stack([self._convect(self.velocity)] * 3)
        self._set_rates(1.0, -1.0, 0.0)

    def _set_rates(self, *rates):
        """Weights, over dt, of the new velocity and the last two in the rate of change."""
        self._rates = rates
        A = (self.density * rates[0] / self.dt * self._mass + self.viscosity * self._stiffness)[self._free]
        self._load = -(A @ self._boundary.T)
        self._momentum = _inverse(A[:, self._free])

    def step(self):
        """Go on by one time step; FloatingPointError where it was too long."""
        rho, dt, (b, b1, b2) = self.density, self.dt, self._rates
        old, older = self.velocity, self._older
        force = self._push(self.pressure - rho / dt * (b1 * self._psi[0] + b2 * self._psi[1]))
        force -= rho / dt * (b1 * old + b2 * older) @ self._mass
        force -= rho * np.tensordot(EXTRAPOLATION, self._convection, 1)
        w = self._boundary.copy()
        w[:, self._free] = self._momentum(self._load + force[:, self._free].T).T
        acceleration = (b * w + b1 * old + b2 * older) / dt
        self._check_stable(acceleration)
        div, psi = self._divergence(w), np.zeros_like(self.pressure)
        psi[self._closed] = self._poisson(-div[self._closed])
        self.pressure = self.pressure + b * rho / dt * psi - self.viscosity * self._project(div)
        self.velocity, self._older, self._psi = w, old, [psi, self._psi[0]]
        self._convection = np.stack([self._convect(w), *self._convection[:2]])
        self.time += dt
        if b == 1:
            self._set_rates(1.5, -2.0, 0.5)

    def _check_stable(self, new):
        """Once started, no flow that is resolved in time turns round in a step, unless nearly nothing moves.

        Unstable small eddies may stay bounded, so that looking at the velocity would not do.
        """
        size, change = np.linalg.norm(self._acceleration), np.linalg.norm(new - self._acceleration)
        self._strongest = max(self._strongest, size)
        if not change < size + 0.01 * self._strongest and self.time > 5 * self.dt:
            raise FloatingPointError(f"unstable at {self.time:.4g} s: the time step {self.dt} s is too long")
        self._acceleration = new

    def _convect(self, w):
        self._transported.x.array[:] = w.T.ravel()
        return fem.assemble_vector(self._convection_form).array.reshape(-1, 2).T

    def _push(self, pressure):
        return np.stack([g @ pressure for g in self._gradient])

    def _divergence(self, w):
        return sum(g.T @ a for g, a in zip(self._gradient, w))

    def vertex_values(self):
        """Velocity (nv, 2) and pressure (nv,) in the order of `compat.vertex_points`."""
        at, at_p = self._at_vertices
        return self.velocity[:, at].T, self.pressure[at_p]

    def mean_divergence(self):
        """Root mean square over the domain, in 1/s, of the divergence as the pressures see it."""
        div = self._divergence(self.velocity)
        return np.sqrt(div @ self._project(div) / self._mass_p.sum())

    def force(self, facets):
        """(2,) force on a body, given by all its facets, in N/m: what the momentum balance there lacks.

        This is as accurate as the energy of the flow; the integral of the stresses is not (John and Matthies,
        Int. J. Numer. Methods Fluids 37, 2001).
        """
        dofs = fem.locate_dofs_topological(self._space, 1, facets)
        inertia = self._acceleration @ self._mass + self._convection[0]
        rest = self.density * inertia + self.viscosity * self.velocity @ self._stiffness
        return -(rest - self._push(self.pressure))[:, dofs].sum(axis=1)


def _matrix(form):
    A = fem.assemble_matrix(fem.form(form * ufl.dx))
    return sparse.csr_matrix((A.data, A.indices, A.indptr))


def _inverse(A):
    """Function that solves with the symmetric matrix A."""
    options = {"SymmetricMode": True}
    return splu(A.tocsc(), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=options).solve
