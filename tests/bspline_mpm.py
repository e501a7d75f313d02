"""Explicit MPM with quadratic B-splines on a uniform grid, 1D and 2D (plane strain).

An independent reference for the unstructured code: it shares nothing with fempm.
"""

import numpy as np
from numba import njit

E_BAR, L_BAR, V_BAR = 100.0, 25.0, 0.75
PAD = 2  # grid nodes beyond the walls; a quadratic spline centred further out misses the box


@njit
def stencil(x, dx, shape):
    """Flat node indices, weights, weight gradients and x_node - x_particle, 3^d per particle."""
    n, d = x.shape
    k = 3**d
    nodes = np.zeros((n, k), np.int64)
    w, dw, r = np.ones((n, k)), np.ones((n, k, d)), np.empty((n, k, d))
    for p in range(n):
        for a in range(d):
            s = x[p, a] / dx + PAD
            base = int(np.floor(s - 0.5))
            t = s - base
            N = (0.5 * (1.5 - t) ** 2, 0.75 - (t - 1) ** 2, 0.5 * (t - 0.5) ** 2)
            dN = ((t - 1.5) / dx, 2 * (1 - t) / dx, (t - 0.5) / dx)
            for j in range(k):
                i = j // 3**a % 3
                if not 0 <= base + i < shape[a]:
                    raise ValueError("a particle left the grid")
                nodes[p, j] = nodes[p, j] * shape[a] + base + i
                w[p, j] *= N[i]
                r[p, j, a] = (i - t) * dx
                for b in range(d):
                    dw[p, j, b] *= dN[i] if a == b else N[i]
    return nodes, w.reshape(n, k, 1), dw, r


@njit
def scatter(n_nodes, nodes, values):
    """Sum the values (n, 3^d, c) of each particle and stencil node at the nodes."""
    q = np.zeros((n_nodes, values.shape[2]))
    for p in range(len(nodes)):
        for j in range(nodes.shape[1]):
            q[nodes[p, j]] += values[p, j]
    return q


def material(E, nu, neo_hookean):
    """Function from F to Kirchhoff stress and energy per initial volume.

    Neo-Hookean: tau = mu (F F^T - I) + lambda ln J I. Linear: tau = P F^T with
    P = 2 mu eps + lambda tr(eps) I and eps = sym(F) - I.
    """
    mu, lam = E / (2 * (1 + nu)), E * nu / ((1 + nu) * (1 - 2 * nu))

    def stress(F):
        I, FT = np.eye(F.shape[-1]), F.swapaxes(1, 2)
        if neo_hookean:
            lnJ = np.log(np.linalg.det(F))
            W = 0.5 * mu * ((F**2).sum((1, 2)) - len(I) - 2 * lnJ) + 0.5 * lam * lnJ**2
            return mu * (F @ FT - I) + lam * lnJ[:, None, None] * I, W
        eps, tr = 0.5 * (F + FT) - I, np.trace(F - I, axis1=1, axis2=2)
        P = 2 * mu * eps + lam * tr[:, None, None] * I
        return P @ FT, mu * (eps**2).sum((1, 2)) + 0.5 * lam * tr**2

    return stress


class BSplineMPM:
    """Particles, and the grid of a box [0, box]; its sides are multiples of `dx`.

    Parameters
    ----------
    x, v : (n, d) array
        Initial positions and velocities; F starts as I and the APIC matrix C as 0.
    walls : dict
        (axis, side) to "fixed" or "slip", side 0 or 1; other sides of the box are open.
    apic, flip
        APIC, or a share `flip` of FLIP in the particle velocity (the rest PIC).
    """

    def __init__(self, x, v, m, V0, dx, box, stress, walls=None, g=0.0, apic=False, flip=1.0):
        self.x, self.v, self.m, self.V0 = np.array(x), np.array(v), m, V0
        n, d = self.x.shape
        self.C, self.F = np.zeros((n, d, d)), np.tile(np.eye(d), (n, 1, 1))
        self.dx, self.shape = dx, np.rint(np.array(box) / dx).astype(int) + 2 * PAD + 1
        self.stress, self.walls, self.g, self.apic, self.flip = stress, walls or {}, g, apic, flip
        self.tau, self.W = stress(self.F)

    def mirrored(self, q):
        """For each wall, nodal fields with its axis first and itself at PAD, and their signs."""
        d, q = self.x.shape[1], q.reshape(*self.shape, -1)
        for (axis, side), kind in self.walls.items():
            odd = (kind == "fixed") | (np.arange(d) == axis)
            sign = np.append(1, np.tile(np.where(odd, -1, 1), 2))[-q.shape[-1] :]
            yield np.moveaxis(q, axis, 0)[:: -1 if side else 1], sign

    def step(self, dt):
        """One symplectic Euler step."""
        d, (nodes, w, dw, r) = self.x.shape[1], stencil(self.x, self.dx, self.shape)
        m = w * self.m[:, None, None]
        momentum = m * (self.v[:, None] + r @ self.C.swapaxes(1, 2))
        force = -self.V0[:, None, None] * (dw @ self.tau.swapaxes(1, 2))
        q = scatter(self.shape.prod(), nodes, np.concatenate([m, momentum, force], axis=2))
        # As if mirror particles stood behind the walls: add what they would give to the nodes ...
        for a, sign in self.mirrored(q):
            a[PAD : 2 * PAD + 1] += sign * a[PAD::-1]
        q = q[:, 1:] / np.where(q[:, :1] > 0, q[:, :1], np.inf)
        q[:, d:] += self.g
        q[:, :d] += dt * q[:, d:]
        # ... and continue the fields into the wall (on it, gravity breaks the zeros).
        for a, sign in self.mirrored(q):
            a[PAD] *= (1 + sign) / 2
            a[:PAD] = sign * a[2 * PAD : PAD : -1]
        v_node, a_node = np.split(q[nodes], 2, axis=2)
        v = (w * v_node).sum(1)
        if self.apic:
            self.v, self.C = v, 4 / self.dx**2 * (w * v_node).swapaxes(1, 2) @ r
        else:
            self.v = self.flip * (self.v + dt * (w * a_node).sum(1)) + (1 - self.flip) * v
        self.x = self.x + dt * v
        self.F = self.F + dt * v_node.swapaxes(1, 2) @ dw @ self.F
        self.tau, self.W = self.stress(self.F)

    def observe(self):
        """Energies, and Cauchy stress of the particles."""
        kinetic, elastic = 0.5 * self.m @ (self.v**2).sum(1), self.V0 @ self.W
        stress = self.tau / np.linalg.det(self.F)[:, None, None]
        return {"kinetic": kinetic, "elastic": elastic, "stress": stress}


def run(mpm, t_end, dt, every, observe):
    """Step to `t_end`; stack what `observe()` gives at the start and every so many steps."""
    n = int(np.ceil(t_end / dt - 1e-9))
    rows = [{"t": 0.0, **observe()}]
    for k in range(1, n + 1):
        mpm.step(t_end / n)
        if k % every == 0:
            rows.append({"t": k * t_end / n, **observe()})
    return {key: np.array([row[key] for row in rows]) for key in rows[0]}


def bar_exact(x0, t, v0=V_BAR):
    """Displacement, velocity and stress of the vibrating bar, (times, points)."""
    k, w = np.pi / (2 * L_BAR), np.pi / (2 * L_BAR) * np.sqrt(E_BAR)
    x, y = k * np.asarray(x0), w * np.asarray(t)[:, None]
    u, v = v0 / w * np.sin(y) * np.sin(x), v0 * np.cos(y) * np.sin(x)
    return u, v, E_BAR * k * v0 / w * np.sin(y) * np.cos(x)


def run_bar(dx=1.0, ppc=4, v0=V_BAR, cfl=0.1, record=1, t_end=10.0, **options):
    """Vibrating bar; `x0` (n,) and over time `t`, `u`, `v`, `stress` (n), `kinetic`, `elastic`."""
    h = dx / ppc
    x0 = h * (np.arange(round(L_BAR / h)) + 0.5)
    v, V0 = v0 * np.sin(np.pi * x0 / (2 * L_BAR)), np.full(len(x0), h)
    box, walls = [np.ceil(1.2 * L_BAR / dx) * dx], {(0, 0): "fixed"}
    stress = material(E_BAR, 0.0, neo_hookean=False)
    mpm = BSplineMPM(x0[:, None], v[:, None], V0, V0, dx, box, stress, walls, **options)

    def observe():
        o = mpm.observe()
        return {**o, "stress": o["stress"][:, 0, 0], "u": mpm.x[:, 0] - x0, "v": mpm.v[:, 0]}

    return {"x0": x0, **run(mpm, t_end, cfl * dx / np.sqrt(E_BAR), record, observe)}


def run_disks(dx=0.05, points=0.0125, dt=1e-3, t_end=3.5, every=1, **options):
    """Two neo-Hookean disks that collide in the unit square, by default open.

    Parameters
    ----------
    points : float or (n, 2) array
        Spacing of a square lattice, or the points of one disk relative to its centre, of equal
        volume; the other disk is its image under a half turn.

    Returns
    -------
    dict of arrays over time
        t, momentum (of the left disk, 2), total_momentum (2), kinetic, elastic, centre (of the
        left disk, 2), stress (Cauchy, 2 x 2, of the particle first nearest to that centre).
    """
    if np.isscalar(points):
        s = points * (np.arange(-np.ceil(0.2 / points), np.ceil(0.2 / points)) + 0.5)
        points = np.stack(np.meshgrid(s, s, indexing="ij"), -1).reshape(-1, 2)
        points = points[(points**2).sum(1) < 0.2**2]
    n, probe = len(points), np.square(points).sum(1).argmin()
    V0 = np.full(2 * n, np.pi * 0.2**2 / n)
    x = np.concatenate([np.add(0.2, points), np.subtract(0.8, points)])
    v = np.repeat([[0.1, 0.1], [-0.1, -0.1]], n, axis=0)
    stress = material(1000.0, 0.3, neo_hookean=True)
    mpm = BSplineMPM(x, v, 1000.0 * V0, V0, dx, [1.0, 1.0], stress, **options)

    def observe():
        o, p = mpm.observe(), mpm.m[:, None] * mpm.v
        left = {"momentum": p[:n].sum(0), "centre": mpm.x[:n].mean(0), "stress": o["stress"][probe]}
        return {**o, **left, "total_momentum": p.sum(0)}

    return run(mpm, t_end, dt, every, observe)
