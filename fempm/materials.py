"""Constitutive laws: dataclasses of parameters with Kirchhoff stress, stored energy and wave speed.

Every law gives, for deformation gradients F (n, d, d), the Kirchhoff stress tau = P F^T = J sigma
(n, d, d), which is what enters f_i = -sum_p V0_p tau_p grad w_ip (thesis eq. 2.8 with V = J V0), and
the energy per initial volume psi (n,) with P = d psi / d F. In two dimensions F is in plane strain.
Loops are compiled; a law of one's own needs a density and the same three methods, in NumPy if one likes.
`state` names the internal variables per particle that a law has, with the shape of each, e.g.
{"plastic_strain": ()}: both functions of F get them by keyword and may change them (see `plasticity`).
"""

from dataclasses import dataclass

import numpy as np
from numba import njit

from .spectral import compose, determinant, kernel_options, principal_strains


@dataclass(frozen=True)
class Elastic:
    """Common parameters: density rho (kg/m^d), Young's modulus E (Pa), Poisson's ratio nu."""

    density: float
    young: float
    poisson: float = 0.0
    state = {}

    def __post_init__(self):
        name = type(self).__name__
        if not self.density > 0:
            raise ValueError(f"{name}: density must be positive, got {self.density}")
        if not self.young > 0:
            raise ValueError(f"{name}: Young's modulus must be positive, got {self.young}")
        if not -1 < self.poisson < 0.5:
            raise ValueError(f"{name}: singular for Poisson's ratio {self.poisson}, it must lie in (-1, 0.5)")

    @property
    def lame(self):
        """Lame parameters (lambda, mu)."""
        e, nu = self.young, self.poisson
        return e * nu / ((1 + nu) * (1 - 2 * nu)), e / (2 * (1 + nu))

    def wave_speed(self, stretch=1.0, jacobian=1.0):
        """Bound on the speed of pressure waves in space, sqrt((lambda + 2 mu) / rho) when undeformed.

        `stretch` is the largest principal stretch in the body, `jacobian` the least det F. Along a
        principal axis the square of the speed is stretch^2 (d^2 psi / d stretch^2) / rho.
        """
        return np.sqrt(self._stiffness(*self.lame, max(stretch, 1.0), min(jacobian, 1.0)) / self.density)

    def kirchhoff_stress(self, deformation_gradient, out):
        """Write tau (n, d, d) to `out`; returns the first particle with det F not in (0, inf), or -1."""
        return self._stress(deformation_gradient, *self.lame, out)

    def energy(self, deformation_gradient):
        """Energy per initial volume psi (n,)."""
        f = deformation_gradient
        return self._energy(f, *self.lame)


class LinearElastic(Elastic):
    """psi = mu eps : eps + lambda tr(eps)^2 / 2, eps = sym(F) - I; in 1D with nu = 0, P = E (F - 1)."""

    def _stiffness(self, lam, mu, stretch, jacobian):
        return (lam + 2 * mu) * stretch**2

    def _stress(self, f, lam, mu, out):
        return linear_stress(f, lam, mu, out)

    def _energy(self, f, lam, mu):
        eps = 0.5 * (f + np.swapaxes(f, 1, 2)) - np.eye(f.shape[1])
        return mu * np.sum(eps**2, axis=(1, 2)) + 0.5 * lam * np.trace(eps, axis1=1, axis2=2) ** 2


class NeoHookean(Elastic):
    """psi = mu (tr(F F^T) - d) / 2 - mu ln J + lambda (ln J)^2 / 2."""

    def _stiffness(self, lam, mu, stretch, jacobian):
        return mu * stretch**2 + mu + lam * (1 - np.log(jacobian))

    def _stress(self, f, lam, mu, out):
        return neo_hookean_stress(f, lam, mu, out)

    def _energy(self, f, lam, mu):
        log_j = np.log(np.linalg.det(f))
        return 0.5 * mu * (np.sum(f**2, axis=(1, 2)) - f.shape[1]) - mu * log_j + 0.5 * lam * log_j**2


class StVenantKirchhoff(Elastic):
    """psi = mu E : E + lambda tr(E)^2 / 2, E = (F^T F - I) / 2."""

    def _stiffness(self, lam, mu, stretch, jacobian):
        square = stretch**2  # the second term is that of equal stretches across
        return square * ((lam + 2 * mu) * (3 * square - 1) / 2 + lam * (square - 1))

    def _stress(self, f, lam, mu, out):
        return st_venant_kirchhoff_stress(f, lam, mu, out)

    def _energy(self, f, lam, mu):
        green = 0.5 * (np.swapaxes(f, 1, 2) @ f - np.eye(f.shape[1]))
        return mu * np.sum(green**2, axis=(1, 2)) + 0.5 * lam * np.trace(green, axis1=1, axis2=2) ** 2


class Hencky(Elastic):
    """psi = mu sum(e_i^2) + lambda (sum e_i)^2 / 2 with the logarithms e_i of the principal stretches."""

    def _stiffness(self, lam, mu, stretch, jacobian):
        least_log = np.log(jacobian) - 2 * np.log(stretch)  # of the third stretch, the others largest
        return lam + 2 * mu - lam * np.log(jacobian) - 2 * mu * least_log

    def _stress(self, f, lam, mu, out):
        return hencky_stress(f, lam, mu, out)

    def _energy(self, f, lam, mu):
        return hencky_energy(f, None, lam, mu)


@dataclass(frozen=True)
class WeaklyCompressibleFluid:
    """Pressure p = K / gamma (J^-gamma - 1) of a barotropic liquid, with viscosity left out.

    psi = K / gamma (J^(1 - gamma) / (gamma - 1) + J), tau = -J p I. Parameters: density (kg/m^d),
    bulk modulus K (Pa), exponent gamma > 1 (7 for water).
    """

    density: float
    bulk: float
    gamma: float = 7.0
    state = {}

    def __post_init__(self):
        for name in ("density", "bulk"):
            if not getattr(self, name) > 0:
                raise ValueError(
                    f"WeaklyCompressibleFluid: {name} must be positive, got {getattr(self, name)}"
                )
        if not self.gamma > 1:
            raise ValueError(f"WeaklyCompressibleFluid: singular for gamma {self.gamma}, it must exceed 1")

    def wave_speed(self, stretch=1.0, jacobian=1.0):
        """Speed of sound where det F is `jacobian`, sqrt(K / rho) at rest."""
        return np.sqrt(self.bulk / self.density * min(jacobian, 1.0) ** (1 - self.gamma))

    def kirchhoff_stress(self, deformation_gradient, out):
        """Write tau (n, d, d) to `out`; returns the first particle with det F not in (0, inf), or -1."""
        return fluid_stress(deformation_gradient, self.bulk, self.gamma, out)

    def energy(self, deformation_gradient):
        """Energy per initial volume psi (n,), zero at J = 1."""
        j, g = np.linalg.det(deformation_gradient), self.gamma
        return self.bulk / g * (j ** (1 - g) / (g - 1) + j - g / (g - 1))


@njit(**kernel_options)
def extremes(f):
    """Bound on the largest principal stretch (row sums of F F^T) and the least det F of F (n, d, d)."""
    n, d, _ = f.shape
    largest, least = 0.0, np.inf
    for p in range(n):
        least = min(least, determinant(f, p))
        for a in range(d):
            row = 0.0
            for b in range(d):
                t = 0.0
                for c in range(d):
                    t += f[p, a, c] * f[p, b, c]
                row += abs(t)
            largest = max(largest, row)
    return np.sqrt(largest), least


@njit(**kernel_options)
def linear_stress(f, lam, mu, out):
    """tau = P F^T, P = 2 mu eps + lambda tr(eps) I."""
    n, d, _ = f.shape
    bad = -1
    for p in range(n):
        if bad < 0 and not 0 < determinant(f, p) < np.inf:
            bad = p
        trace = -float(d)
        for a in range(d):
            trace += f[p, a, a]
        for a in range(d):
            for b in range(d):
                t = lam * trace * f[p, b, a] - 2 * mu * f[p, b, a]
                for c in range(d):
                    t += mu * (f[p, a, c] + f[p, c, a]) * f[p, b, c]
                out[p, a, b] = t
    return bad


@njit(**kernel_options)
def neo_hookean_stress(f, lam, mu, out):
    """tau = mu (F F^T - I) + lambda ln J I."""
    n, d, _ = f.shape
    bad = -1
    for p in range(n):
        j = determinant(f, p)
        if bad < 0 and not 0 < j < np.inf:
            bad = p
        pressure = lam * np.log(j) - mu
        for a in range(d):
            for b in range(a + 1):
                t = 0.0
                for c in range(d):
                    t += f[p, a, c] * f[p, b, c]
                out[p, a, b] = mu * t
                out[p, b, a] = mu * t
            out[p, a, a] += pressure
    return bad


@njit(**kernel_options)
def st_venant_kirchhoff_stress(f, lam, mu, out):
    """tau = F S F^T, S = 2 mu E + lambda tr(E) I."""
    n, d, _ = f.shape
    bad = -1
    s = np.empty((d, d))
    for p in range(n):
        if bad < 0 and not 0 < determinant(f, p) < np.inf:
            bad = p
        trace = 0.0
        for a in range(d):
            for b in range(d):
                t = 0.0
                for c in range(d):
                    t += f[p, c, a] * f[p, c, b]
                s[a, b] = mu * t
            s[a, a] -= mu
            trace += s[a, a] / (2 * mu)
        for a in range(d):
            s[a, a] += lam * trace
        for a in range(d):
            for b in range(d):
                t = 0.0
                for c in range(d):
                    for e in range(d):
                        t += f[p, a, c] * s[c, e] * f[p, b, e]
                out[p, a, b] = t
    return bad


@njit(**kernel_options)
def hencky_stress(f, lam, mu, out):
    """tau = sum (2 mu e_i + lambda sum e) n_i n_i^T; particles without a volume are left out."""
    logs, axes = np.empty(3), np.empty((3, 3))
    bad = -1
    for p in range(len(f)):
        volume = principal_strains(f, p, 0.0, logs, axes)
        if np.isnan(volume):
            bad = p if bad < 0 else bad
            continue
        for i in range(3):
            logs[i] = 2 * mu * logs[i] + lam * volume
        compose(axes, logs, out, p)
    return bad


@njit(**kernel_options)
def hencky_energy(f, lateral, lam, mu):
    """(n,) mu sum(e_i^2) + lambda (sum e)^2 / 2, nan without a volume; `lateral` (n,), None for zeros."""
    logs, axes = np.empty(3), np.empty((3, 3))
    out = np.empty(len(f))
    for p in range(len(f)):
        across = 0.0 if lateral is None else lateral[p]
        volume = principal_strains(f, p, across, logs, axes)
        square = logs[0] ** 2 + logs[1] ** 2 + logs[2] ** 2
        out[p] = mu * square + 0.5 * lam * volume**2
    return out


@njit(**kernel_options)
def fluid_stress(f, bulk, gamma, out):
    """tau = -J p I, p = K / gamma (J^-gamma - 1)."""
    n, d, _ = f.shape
    bad = -1
    for p in range(n):
        j = determinant(f, p)
        if bad < 0 and not 0 < j < np.inf:
            bad = p
        pressure = bulk / gamma * (j ** (1 - gamma) - j)
        for a in range(d):
            for b in range(d):
                out[p, a, b] = -pressure if a == b else 0.0
    return bad
