"""Constitutive laws against finite differences of their energy, Hooke's law and rotations."""

import numpy as np
import pytest

from fempm import Hencky, LinearElastic, NeoHookean, StVenantKirchhoff, WeaklyCompressibleFluid

KINDS = (LinearElastic, NeoHookean, StVenantKirchhoff, Hencky)
SOLIDS = [cls(density=2.0, young=3.0, poisson=0.3) for cls in KINDS]
LAWS = [*SOLIDS, WeaklyCompressibleFluid(density=2.0, bulk=3.0, gamma=7.0)]
DIMENSIONS = [1, 2, 3]
all_laws = pytest.mark.parametrize("law", LAWS, ids=lambda law: type(law).__name__)
all_dimensions = pytest.mark.parametrize("d", DIMENSIONS)


def random_gradients(d, n=50, size=0.2, seed=0):
    """Deformation gradients with 0.3 < det F, far from symmetric."""
    f = np.eye(d) + size * np.random.default_rng(seed).uniform(-1, 1, (n, d, d))
    return f[np.linalg.det(f) > 0.3]


def random_rotations(d, n, seed=1):
    """Orthogonal matrices of determinant 1: QR factors of Gaussian ones."""
    q = np.linalg.qr(np.random.default_rng(seed).normal(size=(n, d, d)))[0]
    q[:, 0] *= np.sign(np.linalg.det(q))[:, None]
    return q


def stress(law, f):
    out = np.full_like(f, np.nan)
    assert law.kirchhoff_stress(f, out) == -1
    return out


@pytest.mark.smoke
@all_laws
@all_dimensions
def test_stress_is_the_derivative_of_the_energy(law, d):
    """P = tau F^-T = d psi / d F. Central differences err by h^2 psi''' / 6 < 1e-7 at h = 1e-5."""
    f, h = random_gradients(d), 1e-5
    p = stress(law, f) @ np.linalg.inv(f).transpose(0, 2, 1)
    for a in range(d):
        for b in range(d):
            e = np.zeros((d, d))
            e[a, b] = h
            slope = (law.energy(f + e) - law.energy(f - e)) / (2 * h)
            np.testing.assert_allclose(p[:, a, b], slope, atol=1e-6 * np.abs(p).max())


@all_laws
@all_dimensions
def test_objective_and_symmetric(law, d):
    """psi(Q F) = psi(F), tau(Q F) = Q tau Q^T, tau = tau^T to round-off; LinearElastic is not objective."""
    f = random_gradients(d)
    q = random_rotations(d, len(f))
    energy, tau = law.energy(f), stress(law, f)
    turned_energy, turned = law.energy(q @ f), q @ tau @ q.transpose(0, 2, 1)
    if isinstance(law, LinearElastic) and d > 1:
        assert np.abs(turned_energy - energy).max() > 0.1 * energy.max()
        assert np.abs(tau - tau.transpose(0, 2, 1)).max() > 0.01 * np.abs(tau).max()
        return
    np.testing.assert_allclose(turned_energy, energy, atol=1e-12)
    np.testing.assert_allclose(stress(law, q @ f), turned, atol=1e-12 * np.abs(tau).max())
    np.testing.assert_allclose(tau, tau.transpose(0, 2, 1), atol=1e-13 * np.abs(tau).max())


@all_laws
@all_dimensions
def test_undeformed_state(law, d):
    """No energy and no stress at F = I, and the least energy there (random F, some of it stretched)."""
    eye = np.eye(d)[None]
    np.testing.assert_allclose(law.energy(eye), 0, atol=1e-15)
    np.testing.assert_allclose(stress(law, eye), 0, atol=1e-15)
    assert np.all(law.energy(random_gradients(d)) > 0)


@all_laws
@all_dimensions
def test_small_strains_obey_hooke(law, d):
    """sigma = lambda tr(eps) I + 2 mu eps; the largest term left out is K gamma tr^2 / 2 < 95 e^2."""
    e = 1e-6
    if isinstance(law, WeaklyCompressibleFluid):
        lam, mu = 3.0, 0.0
    else:
        lam, mu = 3.0 * 0.3 / (1.3 * 0.4), 3.0 / 2.6
    gradient = random_gradients(d, size=1.0) - np.eye(d)
    eps = 0.5 * (gradient + gradient.transpose(0, 2, 1))
    hooke = lam * np.trace(eps, axis1=1, axis2=2)[:, None, None] * np.eye(d) + 2 * mu * eps
    np.testing.assert_allclose(stress(law, np.eye(d) + e * gradient) / e, hooke, atol=100 * e)


@all_laws
@all_dimensions
def test_wave_speed(law, d):
    """rho c^2 = d^2 psi / d F_11^2 at I; second differences err by h^2 psi'''' / 12 < 1e-6 at h = 1e-4."""
    h = 1e-4
    f = np.tile(np.eye(d), (3, 1, 1))
    f[:, 0, 0] += [-h, 0, h]
    stiffness = law.energy(f) @ [1, -2, 1] / h**2
    assert law.density * law.wave_speed() ** 2 == pytest.approx(stiffness, rel=1e-5)


def test_one_dimensional_laws_in_closed_form():
    """With nu = 0: P = E (F - 1), tau = E ln F, tau = E F^2 (F^2 - 1) / 2, tau = E (F^2 - 1) / 2."""
    x = np.array([0.4, 0.9, 1.0, 1.3, 2.5])
    f = x.reshape(-1, 1, 1)
    expected = {
        LinearElastic: (x - 1) * x,
        Hencky: np.log(x),
        StVenantKirchhoff: x**2 * (x**2 - 1) / 2,
        NeoHookean: (x**2 - 1) / 2,
    }
    for cls, tau in expected.items():
        np.testing.assert_allclose(stress(cls(1.0, 7.0), f).ravel(), 7.0 * tau, rtol=1e-14, atol=1e-14)


def log_strain(f):
    """ln(F F^T) / 2 for small H = F - I, as artanh(A (2 I + A)^-1), A = H + H^T + H H^T, in long double."""
    eye = np.eye(len(f), dtype=np.longdouble)
    h = f.astype(np.longdouble) - eye
    a = h + h.T + h @ h.T
    inverse, term, out = eye / 2, eye, 0 * eye
    for _ in range(6):  # Newton, squaring an error below |A| / 2
        inverse = inverse @ (2 * eye - (2 * eye + a) @ inverse)
    z = a @ inverse
    for k in range(30):
        term = term @ z if k == 0 else term @ z @ z
        out = out + term / (2 * k + 1)
    return out


@all_dimensions
@pytest.mark.parametrize("size", [1e-14, 1e-10, 1e-6, 1e-3, 0.05])
@pytest.mark.parametrize("kind", ["any", "repeated", "nearly equal"])
def test_hencky_strain_to_round_off(d, size, kind):
    """mu = 1/2 and lambda = 0 make tau the logarithmic strain: 1e-14 of its own size, however small it is."""
    rng = np.random.default_rng(3)
    h = rng.uniform(-1, 1, (50, d, d))
    if kind == "repeated":  # two equal principal values, in 2D both
        q = random_rotations(d, 50)
        h = q @ np.diag([1.0, 1.0, -0.5][:d]) @ q.transpose(0, 2, 1)
    elif kind == "nearly equal":
        h = np.eye(d) + 1e-7 * h
    f = np.eye(d) + size * h
    expected = np.array([log_strain(one) for one in f])
    error = np.abs(stress(Hencky(1.0, 1.0, 0.0), f) - expected).max(axis=(1, 2))
    assert np.all(error < 1e-14 * np.abs(expected).max(axis=(1, 2)))


@all_dimensions
def test_hencky_strain_of_large_stretches(d):
    """F = Q diag(s) R, s from 1/10 to 10: round-off times the ratio of the squares of the stretches, 1e4."""
    s = np.exp(np.random.default_rng(4).uniform(-2.3, 2.3, (200, d)))
    q, r = random_rotations(d, 200, 5), random_rotations(d, 200, 6)
    expected = np.einsum("nai,ni,nbi->nab", q, np.log(s), q)
    law = Hencky(1.0, 1.0, 0.0)
    np.testing.assert_allclose(stress(law, q * s[:, None] @ r), expected, atol=1e-12 if d > 1 else 1e-15)
    energy = 0.5 * np.sum(np.log(s) ** 2, axis=1)
    np.testing.assert_allclose(law.energy(q * s[:, None] @ r), energy, rtol=1e-12)


def test_fluid_pressure():
    """p = K / gamma (J^-gamma - 1) in a compressed and an expanded liquid, whatever the shear."""
    f = np.array([[[0.5, 0.3], [0.0, 1.6]], [[1.2, 0.0], [5.0, 1.0]]])
    sigma = stress(WeaklyCompressibleFluid(1.0, 2.0, 3.0), f) / np.array([0.8, 1.2])[:, None, None]
    for part, j in zip(sigma, (0.8, 1.2)):
        np.testing.assert_allclose(part, -2 / 3 * (j**-3 - 1) * np.eye(2), rtol=1e-14, atol=1e-15)


@all_laws
@all_dimensions
@pytest.mark.parametrize("value", [-1.0, 0.0, np.nan, np.inf])
def test_inverted_particles_are_reported(law, d, value):
    """The first particle without a positive finite volume is named, whatever else is in the batch."""
    f = np.tile(np.eye(d), (6, 1, 1))
    f[[2, 4], 0, 0] = value
    with np.errstate(all="ignore"):
        found = law.kirchhoff_stress(f, np.empty_like(f))
    assert found == 2


@pytest.mark.parametrize("cls", KINDS)
def test_messages_of_solids(cls):
    """Parameters out of range are refused by name and value."""
    for density in (0.0, -1.0, np.nan):
        with pytest.raises(ValueError, match=f"{cls.__name__}: density must be positive, got {density}"):
            cls(density, 1.0)
    for young in (0.0, -5.0):
        with pytest.raises(ValueError, match=f"{cls.__name__}: Young's modulus must.*, got {young}"):
            cls(1.0, young)
    for poisson in (0.5, -1.0, 0.7, np.nan):
        with pytest.raises(ValueError, match=f"{cls.__name__}: singular for Poisson's ratio {poisson}"):
            cls(1.0, 1.0, poisson)


def test_messages_of_the_fluid():
    with pytest.raises(ValueError, match="density must be positive, got 0"):
        WeaklyCompressibleFluid(0.0, 1.0)
    with pytest.raises(ValueError, match="bulk must be positive, got -2"):
        WeaklyCompressibleFluid(1.0, -2.0)
    with pytest.raises(ValueError, match="singular for gamma 1.0, it must exceed 1"):
        WeaklyCompressibleFluid(1.0, 1.0, 1.0)
