"""Plastic laws on Hencky elasticity, with return maps in principal logarithmic strains.

Here `deformation_gradient` is the elastic part F^e of F = F^e F^p. A step multiplies it as if all of the
step were elastic; `kirchhoff_stress` then takes it back to the yield surface in place, and adds to the
internal variables. With e_i the principal logarithmic strains of F^e, the lateral ones included,
tau_i = 2 mu e_i + lambda v, v = sum e_i, and the invariants are

    p = -tr(tau) / 3 = -K v,  q = sqrt(3 / 2) |dev tau| = 3 mu e_q,  e_q = sqrt(2 / 3) |dev e|.

Both stay coaxial in a return, F^e_new = n diag(exp(e_new - e_trial)) n^T F^e_trial, and backward Euler in
e is that of small strains (Simo, Comput. Methods Appl. Mech. Engrg. 99 (1992), section 3).

State variables, all zero at the start:

    plastic_strain   sum of sqrt(2 / 3) |dev (plastic strain increment)|
    lateral_strain   elastic logarithmic strain in each direction without a coordinate, where the
                     total is zero in plane strain (2D) and in uniaxial strain (1D); unused in 3D
    dissipation      plastic dissipation per initial volume (J/m^3)
    plastic_volume   ln det F^p, so that det F = det F^e exp((3 - d) lateral_strain + plastic_volume)
    opening          the part of plastic_volume that pressure closes first, see `DruckerPrager`
"""

from dataclasses import dataclass, field

import numpy as np
from numba import njit

from .materials import Hencky, hencky_energy
from .spectral import add_product, compose, determinants, inlined, kernel_options, principal_strains

# Strains closer than this to the yield surface count as on it: F^e is stored to a few 1e-16, so that
# a state just returned is found admissible and left as it is, bit by bit.
ROUNDOFF = 4e-15


@dataclass(frozen=True)
class Plastic(Hencky):
    """Common part of plastic laws: Hencky elasticity with internal variables."""

    poisson: float = field()  # no default here, as parameters without one follow
    state = {"plastic_strain": (), "lateral_strain": (), "dissipation": ()}

    def energy(self, deformation_gradient, lateral_strain, **state):
        """Stored elastic energy per initial volume psi (n,) of F^e."""
        return hencky_energy(deformation_gradient, lateral_strain, *self.lame)

    def _require(self, good, message):
        if not good:
            raise ValueError(f"{type(self).__name__}: {message}")


def volume_ratio(deformation_gradient, lateral_strain=0.0, plastic_volume=0.0, **state):
    """(n,) det F of the whole deformation, from F^e (n, d, d) and the state variables of a law."""
    d = deformation_gradient.shape[1]
    ratio = determinants(deformation_gradient, np.empty(len(deformation_gradient)))
    return ratio * np.exp((3 - d) * lateral_strain + plastic_volume)


@dataclass(frozen=True)
class J2Softening(Plastic):
    """q <= kappa = (peak - residual) exp(-softening eps) + residual, eps the plastic strain (thesis 2.3.4).

    Parameters: density, E, nu, peak and residual strength (Pa), softening eta. Refused where
    3 mu <= eta (peak - residual): kappa then falls faster than the stress a step can take back.
    """

    peak: float
    residual: float
    softening: float

    def __post_init__(self):
        super().__post_init__()
        self._require(self.peak > 0, f"peak strength must be positive, got {self.peak}")
        self._require(
            0 <= self.residual <= self.peak,
            f"residual strength must lie in [0, peak strength {self.peak}], got {self.residual}",
        )
        self._require(self.softening >= 0, f"softening must not be negative, got {self.softening}")
        steepest, mu = self.softening * (self.peak - self.residual), self.lame[1]
        self._require(
            3 * mu > steepest,
            f"singular, softening (peak - residual) = {steepest:.6g} must stay below 3 mu = {3 * mu:.6g}",
        )

    def kirchhoff_stress(self, deformation_gradient, out, plastic_strain, lateral_strain, dissipation):
        """Return F^e to the yield surface and write tau; the first particle without a volume, or -1."""
        strength = (self.residual, self.peak - self.residual, self.softening, 0.0)
        state = (plastic_strain, lateral_strain, dissipation)
        return j2_stress(deformation_gradient, *self.lame, strength, *state, out)


@dataclass(frozen=True)
class VonMises(Plastic):
    """q <= max(yield_stress + hardening eps, 0), eps the plastic strain; a negative `hardening` softens.

    Parameters: density, E, nu, yield stress (Pa), hardening modulus (Pa) above -3 mu.
    """

    yield_stress: float
    hardening: float = 0.0

    def __post_init__(self):
        super().__post_init__()
        self._require(self.yield_stress > 0, f"yield stress must be positive, got {self.yield_stress}")
        mu = self.lame[1]
        self._require(
            3 * mu + self.hardening > 0,
            f"singular for hardening {self.hardening}, it must exceed -3 mu = {-3 * mu:.6g}",
        )

    def kirchhoff_stress(self, deformation_gradient, out, plastic_strain, lateral_strain, dissipation):
        """Return F^e to the yield surface and write tau; the first particle without a volume, or -1."""
        strength = (self.yield_stress, 0.0, 0.0, self.hardening)
        state = (plastic_strain, lateral_strain, dissipation)
        return j2_stress(deformation_gradient, *self.lame, strength, *state, out)


@dataclass(frozen=True)
class DruckerPrager(Plastic):
    """q <= M p + k with plastic flow (dev tau, dilation B per plastic strain), and opening in tension.

    Parameters: density, E, nu, friction angle, dilation angle (degrees), cohesion (Pa), and `fit`, which
    cone passes through Mohr and Coulomb's law: "compression" agrees with it in triaxial compression,
    "plane_strain" for flow in plane strain, whatever the dilation (see `cone`).

    Beyond the apex p = -k / M the material parts at that stress, and the gain of volume is kept in
    `opening` (v_c of Klar et al., ACM Trans. Graph. 35 (2016), section 7). It closes at p = 0, before any
    pressure builds up, so that a heap that jumps lands with the volume it left with. Steps that start
    open do not dilate. Dilation by flow on the cone is permanent.

    Dissipation is q d(eps) - p d(volume), never negative as B <= M, and nothing in closing, at p = 0.
    """

    friction_angle: float
    dilation_angle: float = 0.0
    cohesion: float = 0.0
    fit: str = "compression"
    state = {**Plastic.state, "plastic_volume": (), "opening": ()}

    def __post_init__(self):
        super().__post_init__()
        self._require(
            0 < self.friction_angle < 90,
            f"singular for friction angle {self.friction_angle}, it must lie in (0, 90) degrees; "
            "VonMises has none",
        )
        self._require(
            0 <= self.dilation_angle <= self.friction_angle,
            f"dilation angle must lie in [0, friction angle], got {self.dilation_angle}",
        )
        self._require(0 <= self.cohesion < np.inf, f"cohesion must not be negative, got {self.cohesion}")
        self._require(
            self.fit in ("compression", "plane_strain"),
            f"fit {self.fit!r}: give 'compression' or 'plane_strain'",
        )

    @property
    def cone(self):
        """Slope M, strength k at p = 0 (Pa), and dilation B = d(volume) / d(plastic strain).

        In triaxial compression M = 6 sin phi / (3 - sin phi), k = 6 c cos phi / (3 - sin phi), and B is
        as M of the dilation angle psi. In plane strain the plastic strain across vanishes, which
        makes B = 3 sin psi / r and M = 3 r sin phi / (3 + sin phi sin psi), r^2 = 3 + sin^2 psi, and
        k = M c cot phi.
        """
        phi, psi = np.radians([self.friction_angle, self.dilation_angle])
        s, t = np.sin(phi), np.sin(psi)
        if self.fit == "compression":
            m, b = 6 * s / (3 - s), 6 * t / (3 - t)
        else:
            r = np.sqrt(3 + t * t)
            m, b = 3 * r * s / (3 + s * t), 3 * t / r
        return m, m * self.cohesion / np.tan(phi), b

    def kirchhoff_stress(
        self,
        deformation_gradient,
        out,
        plastic_strain,
        lateral_strain,
        dissipation,
        plastic_volume,
        opening,
    ):
        """Return F^e to the cone and write tau; the first particle without a volume, or -1."""
        state = (plastic_strain, lateral_strain, dissipation, plastic_volume, opening)
        return drucker_prager_stress(deformation_gradient, *self.lame, self.cone, *state, out)


@njit(**inlined)
def workspace(d):
    """Arrays for one particle: principal strains, directions, growth of the stretches, a matrix."""
    return np.empty(3), np.empty((3, 3)), np.empty(3), np.empty((1, d, d))


@njit(**inlined)
def shear_strain(logs, volume):
    """e_q = sqrt(2 / 3) |dev e|."""
    x, y, z = logs[0] - volume / 3, logs[1] - volume / 3, logs[2] - volume / 3
    return np.sqrt((x * x + y * y + z * z) / 1.5)


@njit(**inlined)
def move(f, p, work, volume, new_volume, ratio, lateral):
    """Bring strains and f[p] from sum `volume` to `new_volume`, with the deviator times `ratio`."""
    logs, axes, growth, matrix = work
    for i in range(3):
        new = new_volume / 3 + ratio * (logs[i] - volume / 3)
        growth[i] = np.expm1(new - logs[i])
        logs[i] = new
    add_product(f, p, axes, growth, matrix)
    if f.shape[1] < 3:
        lateral[p] = logs[2]


@njit(**inlined)
def write_stress(logs, axes, volume, lam, mu, out, p):
    """out[p] = sum (2 mu e_i + lambda v) n_i n_i^T; `logs` is overwritten."""
    for i in range(3):
        logs[i] = 2 * mu * logs[i] + lam * volume
    compose(axes, logs, out, p)


@njit(**kernel_options)
def plastic_step(excess, slope, fall, rate):
    """Root x of excess - slope x - fall (exp(-rate x) - 1), slope > fall rate, fall >= 0, excess > 0.

    The function is concave and falls, so that Newton's method from the right of the root goes down to
    it without ever passing it, until round-off stops it. Both starts lie to the right: the tangent
    at x = 0, and the strength fallen as far as it can.
    """
    x = min(excess / (slope - fall * rate), (excess + fall) / slope)
    for _ in range(100):  # not reached: halving the distance is the slowest it gets, where slopes are equal
        change = fall * np.expm1(-rate * x)
        new = x + (excess - slope * x - change) / (slope - rate * (fall + change))
        if not new < x:
            break
        x = new
    return x


@njit(**kernel_options)
def j2_stress(f, lam, mu, strength, plastic_strain, lateral, dissipation, out):
    """Return to q = kappa = base + fall exp(-rate eps) + hardening eps, and tau.

    The dissipation of a step is that at the mean of kappa before and after, of second order.
    """
    base, fall, rate, hardening = strength
    logs, axes, _, _ = work = workspace(f.shape[1])
    bad = -1
    for p in range(len(f)):
        volume = principal_strains(f, p, lateral[p], logs, axes)
        if np.isnan(volume):
            bad = p if bad < 0 else bad
            continue
        q = 3 * mu * shear_strain(logs, volume)
        left = fall * np.exp(-rate * plastic_strain[p])
        kappa = max(base + left + hardening * plastic_strain[p], 0.0)
        if q > kappa + 3 * mu * ROUNDOFF:
            step = min(plastic_step(q - kappa, 3 * mu + hardening, left, rate), q / (3 * mu))
            new = max(q - 3 * mu * step, 0.0)
            plastic_strain[p] += step
            dissipation[p] += 0.5 * (kappa + new) * step
            move(f, p, work, volume, volume, new / q, lateral)
        write_stress(logs, axes, volume, lam, mu, out, p)
    return bad


@njit(**kernel_options)
def drucker_prager_stress(
    f, lam, mu, cone, plastic_strain, lateral, dissipation, plastic_volume, opening, out
):
    """Close what is open, return to q = M p + k or to its apex, and tau."""
    m, k, dilation = cone
    bulk = lam + 2 * mu / 3
    apex = k / (m * bulk)  # volume strain there
    logs, axes, _, _ = work = workspace(f.shape[1])
    bad = -1
    for p in range(len(f)):
        trial = principal_strains(f, p, lateral[p], logs, axes)
        if np.isnan(trial):
            bad = p if bad < 0 else bad
            continue
        volume = new_volume = trial
        gap, step, ratio = opening[p], 0.0, 1.0
        if gap > 0 and volume < -ROUNDOFF:
            gap = max(gap + volume, 0.0)
            volume = new_volume = min(volume + opening[p], 0.0)
        q = 3 * mu * shear_strain(logs, trial)
        excess = q + m * bulk * volume - k
        if excess > (3 * mu + m * bulk) * ROUNDOFF:
            b = 0.0 if opening[p] > 0 else dilation
            step = excess / (3 * mu + m * bulk * b)
            if 3 * mu * step < q:
                new_volume = volume - b * step
                ratio = 1 - 3 * mu * step / q
            else:
                step, ratio, new_volume = q / (3 * mu), 0.0, apex
                gap += max(volume - apex, 0.0)
        if new_volume != trial or step > 0:
            plastic_strain[p] += step
            dissipation[p] += ratio * q * step + bulk * new_volume * (volume - new_volume)
            plastic_volume[p] += trial - new_volume
            opening[p] = gap
            move(f, p, work, trial, new_volume, ratio, lateral)
        write_stress(logs, axes, new_volume, lam, mu, out, p)
    return bad
