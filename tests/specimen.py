"""One-element tests of plastic laws: particles taken through given deformations."""

import numpy as np

E, NU = 1000.0, 0.3
K, MU = E / (3 * (1 - 2 * NU)), E / (2 * (1 + NU))


class Specimen:
    """Particles (n,) of a law, taken through total deformation gradients (n, d, d) by steps."""

    def __init__(self, law, n, d):
        self.law = law
        self.total = np.tile(np.eye(d), (n, 1, 1))
        self.elastic, self.tau = self.total.copy(), np.zeros((n, d, d))
        self.state = {name: np.zeros((n, *shape)) for name, shape in law.state.items()}

    def __getattr__(self, name):
        return self.state[name]

    def to(self, f):
        f = np.broadcast_to(f, self.total.shape)
        self.elastic = f @ np.linalg.inv(self.total) @ self.elastic
        self.total = f.copy()
        assert self.law.kirchhoff_stress(self.elastic, self.tau, **self.state) == -1
        return self

    @property
    def energy(self):
        return self.law.energy(self.elastic, **self.state)


def exponentials(strains, times):
    """(m, 1, d, d) diagonal F = exp(t strain), one per time."""
    return np.exp(np.multiply.outer(times, strains))[:, None, :, None] * np.eye(len(strains))


def run(law, path):
    """Specimen after the path (m, n, d, d)."""
    path = np.asarray(path)
    s = Specimen(law, *path.shape[1:3])
    for f in path:
        s.to(f)
    return s


def invariants(s):
    """q and p of 3D stress states, those of lower dimension completed by the lateral strain."""
    d = s.tau.shape[1]
    tau = np.zeros((len(s.tau), 3, 3))
    tau[:, :d, :d] = s.tau
    log_volume = np.log(np.linalg.det(s.elastic)) + (3 - d) * s.lateral_strain
    for i in range(d, 3):
        tau[:, i, i] = 2 * MU * s.lateral_strain + (K - 2 * MU / 3) * log_volume
    p = -np.trace(tau, axis1=1, axis2=2) / 3
    deviator = tau + p[:, None, None] * np.eye(3)
    return np.sqrt(1.5 * np.sum(deviator**2, axis=(1, 2))), p
