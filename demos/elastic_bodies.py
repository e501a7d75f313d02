"""Quasi-static hyperelastic bodies with contact, for the data sets of plates and letters.

A state is the node positions x (n, d). Its energy is a sum of terms, each with `energy(x)` in J (per metre of
depth in 2D, plane strain), inf where the state is impossible, with `derivatives(x, convex)`, the gradient
(n, d) and a Hessian (n d, n d), positive semidefinite if `convex`, and with `safe_share(x, step)`, how much
of a step it lets pass.
"""

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu
from scipy.spatial import cKDTree


class NotConverged(RuntimeError):
    """Newton's method found no state of equilibrium."""


class Term:
    """What the energies share: by default any step is allowed."""

    def safe_share(self, x, step):
        return 1.0


class ElasticBody(Term):
    """Neo-Hookean solid of linear simplices: W = mu/2 (|F|^2 - d - 2 ln J) + lambda/2 (ln J)^2.

    Parameters
    ----------
    material : (n, d) positions of all nodes at rest in m, also of those of other bodies
    cells : (nc, d + 1) corners of this body's cells
    young, poisson : in Pa and 1
    """

    def __init__(self, material, cells, young, poisson):
        d = material.shape[1]
        self.cells, self.num_dofs = np.asarray(cells, np.int64), material.size
        corners = material[self.cells]
        edges = corners[:, 1:] - corners[:, :1]
        inner = np.linalg.inv(edges).transpose(0, 2, 1)
        self.slopes = np.concatenate([-inner.sum(axis=1, keepdims=True), inner], axis=1)  # of the corners
        self.volumes = np.abs(np.linalg.det(edges)) / (2 if d == 2 else 6)
        self.mu = young / (2 * (1 + poisson))
        self.lame = young * poisson / ((1 + poisson) * (1 - 2 * poisson))

    def grow(self, growth):
        """Replace the state at rest by one deformed by (nc, d, d) in each cell, whether that fits or not."""
        self.slopes = self.slopes @ np.linalg.inv(growth)
        self.volumes = self.volumes * np.linalg.det(growth)

    def deformation(self, x):
        """(nc, d, d) F = dx/dX."""
        return np.einsum("cai,caj->cij", x[self.cells], self.slopes)

    def stress(self, F):
        """(nc, d, d) first Piola stress in Pa, F^-T and ln J."""
        Q = np.linalg.inv(F).transpose(0, 2, 1)
        log_j = np.log(np.linalg.det(F))
        return self.mu * (F - Q) + self.lame * log_j[:, None, None] * Q, Q, log_j

    def energy(self, x):
        F = self.deformation(x)
        J = np.linalg.det(F)
        if not J.min() > 0:
            return np.inf
        log_j = np.log(J)
        shear = np.einsum("cij,cij->c", F, F) - F.shape[1] - 2 * log_j
        return self.volumes @ (0.5 * self.mu * shear + 0.5 * self.lame * log_j**2)

    def derivatives(self, x, convex=True):
        P, Q, log_j = self.stress(self.deformation(x))
        nc, d = len(P), P.shape[1]
        force = np.einsum("c,cij,caj->cai", self.volumes, P, self.slopes)
        gradient = np.zeros_like(x)
        np.add.at(gradient, self.cells, force)
        turn = (self.mu - self.lame * log_j)[:, None, None, None, None]
        tangent = turn * np.einsum("cil,ckj->cijkl", Q, Q) + self.lame * np.einsum("cij,ckl->cijkl", Q, Q)
        tangent = tangent.reshape(nc, d * d, d * d) + self.mu * np.eye(d * d)
        if convex:
            tangent = projected(tangent)
        # dF of each nodal displacement
        nodal = np.einsum("caj,ik->caikj", self.slopes, np.eye(d)).reshape(nc, (d + 1) * d, d * d)
        blocks = nodal @ (self.volumes[:, None, None] * tangent) @ nodal.transpose(0, 2, 1)
        dofs = (d * self.cells[:, :, None] + np.arange(d)).reshape(nc, -1)
        return gradient, scatter(blocks, dofs, self.num_dofs)

    def von_mises(self, x):
        """(n,) von Mises stress in Pa (3D): at a node the mean of its cells, 0 at those of other bodies."""
        F = self.deformation(x)
        cauchy = self.stress(F)[0] @ F.transpose(0, 2, 1) / np.linalg.det(F)[:, None, None]
        deviator = cauchy - np.trace(cauchy, axis1=1, axis2=2)[:, None, None] * np.eye(3) / 3
        size = np.sqrt(1.5 * np.einsum("cij,cij->c", deviator, deviator))
        corners = self.cells.ravel()
        weight = np.bincount(corners, np.repeat(self.volumes, 4), len(x))
        total = np.bincount(corners, np.repeat(self.volumes * size, 4), len(x))
        return total / np.where(weight > 0, weight, 1)


class RigidContact(Term):
    """Penalty k/2 (layer - gap)^2 at nodes closer than `layer` to a rigid body that is given by its gap.

    Parameters
    ----------
    nodes : that can touch it
    gap : function of points (m, d) returning distances (m,) to its surface in m and normals (m, d)
    stiffness, layer : in N/m and m
    """

    def __init__(self, nodes, gap, stiffness, layer):
        self.nodes, self.gap, self.stiffness, self.layer = nodes, gap, stiffness, layer

    def energy(self, x):
        depth = (self.layer - self.gap(x[self.nodes])[0]).clip(0)
        return 0.5 * self.stiffness * depth @ depth

    def derivatives(self, x, convex=True):
        distance, normal = self.gap(x[self.nodes])
        near = distance < self.layer
        nodes, normal = self.nodes[near], normal[near]
        gradient, d = np.zeros_like(x), x.shape[1]
        gradient[nodes] = self.stiffness * (distance[near] - self.layer)[:, None] * normal
        blocks = self.stiffness * normal[:, :, None] * normal[:, None]
        return gradient, scatter(blocks, d * nodes[:, None] + np.arange(d), x.size)


class SelfContact(Term):
    """Barrier k (layer - s)^2 ln(layer / s) between nodes and segments of outlines at distances s < layer.

    It is that of incremental potential contact (Li et al. 2020), in 2D: no step lets a node meet a segment.

    Parameters
    ----------
    segments : (ns, 2) nodes of the outlines' segments
    stiffness, layer : in Pa and m
    reach : longest step of a node in m
    """

    def __init__(self, segments, stiffness, layer, reach):
        self.segments, self.nodes = segments, np.unique(segments)
        self.stiffness, self.layer, self.reach = stiffness, layer, reach

    def pairs(self, x, within):
        """(m, 3) close node and segment ends, their shares (m, 3) in the offset (m, 2) between them."""
        ends = x[self.segments]
        longest = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1).max()
        middles = cKDTree(ends.mean(axis=1))
        found = cKDTree(x[self.nodes]).sparse_distance_matrix(
            middles, within + longest / 2, output_type="coo_matrix"
        )
        triples = np.column_stack([self.nodes[found.row], self.segments[found.col]])
        triples = triples[(triples[:, :1] != triples[:, 1:]).all(axis=1)]
        p, a, b = x[triples].transpose(1, 0, 2)
        along = np.einsum("mi,mi->m", p - a, b - a) / np.einsum("mi,mi->m", b - a, b - a)
        shares = np.column_stack([np.ones(len(along)), along.clip(0, 1) - 1, -along.clip(0, 1)])
        offset = np.einsum("ma,mai->mi", shares, x[triples])
        close = np.linalg.norm(offset, axis=1) < within
        return triples[close], shares[close], offset[close]

    def energy(self, x):
        distance = np.linalg.norm(self.pairs(x, self.layer)[2], axis=1)
        if not np.all(distance > 0):
            return np.inf
        return self.stiffness * ((self.layer - distance) ** 2 @ np.log(self.layer / distance))

    def derivatives(self, x, convex=True):
        triples, shares, offset = self.pairs(x, self.layer)
        s, d = np.linalg.norm(offset, axis=1), x.shape[1]
        log, depth = np.log(s / self.layer), self.layer - s
        slope = self.stiffness * (2 * depth * log - depth**2 / s)
        curvature = self.stiffness * (-2 * log + 4 * depth / s + depth**2 / s**2)
        toward = (shares[:, :, None] * (offset / s[:, None])[:, None]).reshape(-1, 3 * d)
        gradient = np.zeros_like(x)
        np.add.at(gradient, triples, (slope[:, None] * toward).reshape(-1, 3, d))
        blocks = curvature[:, None, None] * toward[:, :, None] * toward[:, None]
        # Hessian of s = |offset|, minus what the shares gain by following the node along the segment
        normal, edge = offset / s[:, None], x[triples[:, 2]] - x[triples[:, 1]]
        aside = np.column_stack([-normal[:, 1], normal[:, 0]])
        sideways = (shares[:, :, None] * aside[:, None]).reshape(-1, 3 * d)
        slide = np.array([0.0, 1.0, -1.0])[:, None] * normal[:, None] - (
            shares[:, :, None] * edge[:, None] / s[:, None, None]
        )
        free = (shares[:, 1:] < 0).all(axis=1)
        slide = slide.reshape(-1, 3 * d) * (free / np.linalg.norm(edge, axis=1))[:, None]
        bend = sideways[:, :, None] * sideways[:, None] / s[:, None, None]
        bend -= s[:, None, None] * slide[:, :, None] * slide[:, None]
        blocks = blocks + slope[:, None, None] * bend
        if convex:
            blocks = projected(blocks)
        dofs = (d * triples[:, :, None] + np.arange(d)).reshape(-1, 3 * d)
        return gradient, scatter(blocks, dofs, x.size)

    def safe_share(self, x, step):
        """A share in which no distance can lose more than 0.8 of itself, whatever the directions are."""
        share = min(1.0, self.reach / max(np.linalg.norm(step, axis=1).max(), 1e-300))
        triples, _, offset = self.pairs(x, self.layer + 2 * share * np.linalg.norm(step, axis=1).max())
        towards = np.linalg.norm(step[triples[:, 1:]] - step[triples[:, :1]], axis=2).max(axis=1)
        return min([share, *(0.8 * np.linalg.norm(offset, axis=1) / towards.clip(1e-300))])


class Drag(Term):
    """First-order inertia: rate/2 sum m |x - x_before|^2, with masses (n,) and a rate in J/(kg m^2)."""

    def __init__(self, mass, rate, before):
        self.weight, self.before = rate * mass, before.copy()

    def energy(self, x):
        return 0.5 * self.weight @ np.sum((x - self.before) ** 2, axis=1)

    def derivatives(self, x, convex=True):
        return self.weight[:, None] * (x - self.before), sparse.diags(np.repeat(self.weight, x.shape[1]))


def projected(blocks):
    """Symmetric blocks (m, k, k) without their negative eigenvalues."""
    value, vector = np.linalg.eigh(blocks)
    return (vector * value.clip(0)[:, None]) @ vector.transpose(0, 2, 1)


def scatter(blocks, dofs, size):
    """Sum of dense blocks (m, k, k) at the dofs (m, k) in a sparse matrix."""
    pairs = (np.broadcast_to(a, blocks.shape).ravel() for a in (dofs[:, :, None], dofs[:, None]))
    return sparse.coo_matrix((blocks.ravel(), tuple(pairs)), (size, size)).tocsc()


def minimise(terms, x, free, tolerance, most=200):
    """Positions of least energy near x, by Newton's method with backtracking.

    Parameters
    ----------
    terms : energies
    x : (n, d) positions to start from
    free : (n,) bool, the nodes that may move
    tolerance : Newton step in m at which it ends
    most : iterations

    Returns
    -------
    (n, d) positions, and the number of iterations

    Raises
    ------
    NotConverged
    """
    x, dofs = x.copy(), np.flatnonzero(np.repeat(free, x.shape[1]))
    energy = sum(term.energy(x) for term in terms)
    for iteration in range(1, most + 1):
        step = np.zeros(x.size)
        for convex in (False, True):  # the second one is sure to go downhill, the first one is faster
            gradients, hessians = zip(*(term.derivatives(x, convex) for term in terms))
            slope = -sum(gradients).ravel()[dofs]
            system = sum(hessians).tocsc()[dofs][:, dofs]
            factors = splu(system, permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True})
            step[dofs] = factors.solve(slope)
            if slope @ step[dofs] > 0:
                break
        step = step.reshape(x.shape)
        size = np.linalg.norm(step, axis=1).max()
        share = min(term.safe_share(x, step) for term in terms)
        wanted = 1e-4 * (slope @ step.ravel()[dofs])
        while not (ahead := sum(term.energy(x + share * step) for term in terms)) <= energy - share * wanted:
            share /= 2
            if share * size < 1e-3 * tolerance:
                break  # rounding errors of the energy hide what is left to gain
        else:
            x, energy = x + share * step, ahead
        if size < tolerance:
            return x, iteration
        if share * size < 1e-3 * tolerance:
            raise NotConverged(f"steps of {size:.3g} m do not lower the energy, take smaller frames")
    raise NotConverged(f"none within {most} iterations, last step {size:.3g} m: take smaller frames")
