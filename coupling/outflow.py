"""Open ends: waves leave, and what comes in decays to the far state (thesis 3.2.9, Kwatra et al. 2009)."""

import numpy as np


class OpenEnds:
    """The nodes at outflows.

    The pressure there is p + Z (u - u_in) . n, that of the wave which leaves, with the unknown velocity u of
    the node and the impedance Z = rho c. p and u_in are those of the cells inside as a step begins, or,
    the more so the more cells sound crosses in it, those of the far state.

    Parameters
    ----------
    part : Part, the space of this rank
    conditions : Boundaries, restricted to it
    eos : equation of state

    Attributes
    ----------
    nodes : (m,) their numbers
    area : (m, d) int phi_i n; normal : (m, d) its direction
    resistance : (m, d, d) sum of |int phi_i n| n n^T over the ends that meet at a node
    impedance, carried : (m,) Z, and (m, d) int phi_i (p - Z u_in . n) n, in the present step
    """

    def __init__(self, part, conditions, eos):
        self.part, self.eos = part, eos
        self.nodes, self.area, self.far = conditions.open, conditions.open_area, conditions.far
        self.attenuation, self.resistance = conditions.attenuation, conditions.resistance
        size = np.linalg.norm(self.area, axis=1)
        self.normal = self.area / np.maximum(size, 1e-300)[:, None]
        self.inside = Inside(part, self.nodes, self.normal)
        self.width = (2 * part.space.volumes[self.nodes]) ** (1 / part.space.dim)

    def begin_step(self, W, pressure, dt):
        """Look at the gas inside: W (n, d + 2) its density, velocity and internal energy."""
        p, density, *velocity = self.inside.means(W[:, 0].copy(), np.stack([pressure, *W[:, :-1].T]))
        velocity = np.array(velocity).T
        sound = np.sqrt(self.eos.bulk_modulus(density, p) / density)
        crossed = np.maximum(sound * dt / self.width - 1, 0)
        crossed[np.sum(velocity * self.normal, axis=1) > sound] = 0  # nothing comes in
        known = 1 / (1 + crossed**2)
        p = self.far[:, -1] + known * (p - self.far[:, -1])
        velocity = self.far[:, 1:-1] + known[:, None] * (velocity - self.far[:, 1:-1])
        self.impedance = density * sound
        back = np.einsum("kab,kb->ka", self.resistance, velocity)
        self.carried = p[:, None] * self.area - self.impedance[:, None] * back

    def mobility(self, free, ratio):
        """(m, d, d) inverse of 1 + ratio K on the directions that `free` (m, d, d) projects onto."""
        resisted = np.einsum("kab,kbc,kcd->kad", free, self.resistance, free)
        return np.linalg.inv(np.eye(free.shape[1]) + ratio[:, None, None] * resisted) @ free

    def power(self, velocity):
        """(m,) work of the gas on what is outside, per time."""
        u = velocity[self.nodes]
        push = np.einsum("kab,kb->ka", self.resistance, u) * self.impedance[:, None]
        return np.sum((self.carried + push) * u, axis=1)

    def attenuate(self, W, pressure, dt):
        """(m, d + 2) density, velocity and pressure, what incoming waves carry damped towards the far state.

        The waves are those of the linear equations around the present state: p' + Z u' . n leaves as long
        as u . n > -c, p' - Z u' . n comes in unless u . n > c, entropy and the flow along the end go with u.
        """
        density, velocity, pressure = W[self.nodes, 0], W[self.nodes, 1:-1], pressure[self.nodes]
        sound = np.sqrt(self.eos.bulk_modulus(density, pressure) / density)
        impedance, decay = density * sound, np.exp(-self.attenuation * dt)
        speed = np.sum(velocity * self.normal, axis=1)
        apart, drift = pressure - self.far[:, -1], velocity - self.far[:, 1:-1]
        across = np.sum(drift * self.normal, axis=1)
        outgoing = (apart + impedance * across) * np.where(speed > -sound, 1, decay)
        incoming = (apart - impedance * across) * np.where(speed < sound, decay, 1)
        convected = np.where(speed < 0, decay, 1)
        entropy = (density - self.far[:, 0] - apart / sound**2) * convected
        along = (drift - across[:, None] * self.normal) * convected[:, None]
        apart = (outgoing + incoming) / 2
        state = np.empty((len(self.nodes), W.shape[1]))
        state[:, 0] = self.far[:, 0] + entropy + apart / sound**2
        state[:, 1:-1] = self.far[:, 1:-1] + along
        state[:, 1:-1] += ((outgoing - incoming) / (2 * impedance))[:, None] * self.normal
        state[:, -1] = self.far[:, -1] + apart
        return state


class Inside:
    """Means just inside of some nodes of the boundary, weighted like the force of the pressure on them.

    Parameters
    ----------
    part : Part
    nodes : (m,) their numbers
    normal : (m, d) outward directions
    """

    def __init__(self, part, nodes, normal):
        self.part, self.nodes = part, nodes
        cells, corner = np.nonzero(np.isin(part.space.cell_nodes, nodes))
        self.row = np.searchsorted(nodes, part.space.cell_nodes[cells, corner])
        self.dofs = part.space.cell_pressures[cells]
        force = part.space.coefficients[cells, :, corner]
        self.share = np.einsum("kqa,ka->kq", force, normal[self.row])
        self.share /= self.sums(np.ones((1, len(part.dofs))))[0][self.row][:, None]

    def sums(self, values):
        """(k, m) sums of values (k, nq) with the shares. Collective."""
        out = np.zeros((len(self.part.nodes), len(values)))
        np.add.at(out, self.nodes[self.row], np.einsum("xkq,kq->kx", values[:, self.dofs], self.share))
        return self.part.sum_nodes(out)[self.nodes].T

    def means(self, density, fields):
        """(k, m) mass-weighted means of nodal fields (k, n). Collective."""
        pairs = [fields[i : i + 2] for i in range(0, len(fields), 2)]
        return self.sums(np.concatenate([self.part.means(density, f[0], f[-1])[: len(f)] for f in pairs]))
