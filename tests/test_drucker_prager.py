"""Drucker-Prager: Mohr and Coulomb's law, dilation, the apex, and what opens and closes.

Tolerances as in test_plasticity: 1e-12 of the stress scale, unless said otherwise.
"""

import numpy as np
import pytest
from specimen import MU, NU, E, K, Specimen, exponentials, invariants, run

from fempm import DruckerPrager

PHI, PSI, COHESION = np.radians(32.0), np.radians(10.0), 3.0


def law(**options):
    return DruckerPrager(1.0, E, NU, 32.0, **options)


def log_volume(s):
    return np.log(np.linalg.det(s.total[0]))


@pytest.mark.parametrize("d, steps", [(3, 1), (3, 9)])
@pytest.mark.parametrize("dilation, cohesion", [(0.0, 0.0), (10.0, 0.0), (0.0, COHESION), (10.0, COHESION)])
def test_triaxial_compression(d, steps, dilation, cohesion):
    """Straight strain path to failure: Mohr and Coulomb's law, flow -dv / de_1 = 2 sin psi / (1 - sin psi).

    As the direction of shear stays, the sum of the steps is that of one: 3 mu eps + M K B eps takes the
    elastic excess q - M p - k of the whole path back, with M = 6 sin phi / (3 - sin phi).
    """
    strains = np.array([-0.05, 0.015, 0.015])
    s = run(
        law(dilation_angle=dilation, cohesion=cohesion),
        exponentials(strains, np.linspace(0, 1, steps + 1)[1:]),
    )
    minor, major = -s.tau[0, 1, 1], -s.tau[0, 0, 0]
    mohr_coulomb = (major + minor) * np.sin(PHI) + 2 * cohesion * np.cos(PHI)
    assert major - minor == pytest.approx(mohr_coulomb, rel=1e-12)
    sine = np.sin(np.radians(dilation))
    m, b = 6 * np.sin(PHI) / (3 - np.sin(PHI)), 6 * sine / (3 - sine)
    excess = 2 * MU * 0.065 - m * (K * 0.02 + cohesion / np.tan(PHI))
    assert s.plastic_strain[0] == pytest.approx(excess / (3 * MU + m * K * b), rel=1e-12)
    axial = strains[0] - np.log(s.elastic[0, 0, 0])
    assert -s.plastic_volume[0] / axial == pytest.approx(2 * sine / (1 - sine), rel=1e-12)


@pytest.mark.parametrize("dilation", [0.0, 10.0, 32.0])
@pytest.mark.parametrize("cohesion", [0.0, COHESION])
def test_mohr_coulomb_in_plane_strain(dilation, cohesion):
    """fit="plane_strain": steady flow has radius = centre sin phi + c cos phi, dv = sin psi |de_1 - de_3|.

    Compressed, then strained at the rate that dilates by sin psi, so that p stays; the stress across
    settles as exp(-3 mu eps / q), which is 1e-12 at the end.
    """
    sine = np.sin(np.radians(dilation))
    material = law(dilation_angle=dilation, cohesion=cohesion, fit="plane_strain")
    s = Specimen(material, 1, 2).to(np.exp(-0.01) * np.eye(2))
    last = None
    for t in np.linspace(0, 1.0, 2001):
        s.to(np.exp(-0.01) * exponentials([t * (sine + 1) / 2, t * (sine - 1) / 2], [1.0])[0])
        before, last = last, (s.plastic_volume[0], t)
    one, two = -s.tau[0, 0, 0], -s.tau[0, 1, 1]
    assert two - one == pytest.approx((two + one) * np.sin(PHI) + 2 * cohesion * np.cos(PHI), rel=1e-9)
    assert (last[0] - before[0]) / (last[1] - before[1]) == pytest.approx(sine, rel=1e-9, abs=1e-12)


def test_pressure_at_rest_is_limited_by_the_cone():
    """Uniaxial compression with nu = 0.1: tau_h / tau_v = (3 - M) / (3 + 2 M), more than nu / (1 - nu)."""
    m = 6 * np.sin(PHI) / (3 - np.sin(PHI))
    for d in (2, 3):
        s = run(DruckerPrager(1.0, E, 0.1, 32.0), exponentials([-1.0] + [0.0] * (d - 1), [0.01, 0.02, 0.05]))
        assert s.tau[0, 1, 1] / s.tau[0, 0, 0] == pytest.approx((3 - m) / (3 + 2 * m), rel=1e-12)


@pytest.mark.parametrize("d", [1, 2, 3])
@pytest.mark.parametrize("dilation", [0.0, 10.0])
def test_sand_that_opened_closes_before_it_presses(d, dilation):
    """Stretched by 20 % one way and let back, sheared while open: no stress until the volume is the old one.

    Then the stress is that of material that never opened: 1e-10, as closing ends at a volume with the
    round-off of 200 steps. Nothing is dissipated, for there is no stress.
    """
    steps = np.concatenate([np.linspace(0, 1, 101)[1:], np.linspace(1, 0, 101)[1:]])
    s = Specimen(law(dilation_angle=dilation), 1, d)
    shear = np.eye(d)
    for t in steps:
        if d > 1:
            shear[0, 1] = max(t - 0.2, 0)
        s.to(np.diag([1 + 0.2 * t] + [1.0] * (d - 1)) @ shear)
        np.testing.assert_allclose(s.tau, 0, atol=1e-11)
        assert s.opening[0] == pytest.approx(max(log_volume(s), 0), abs=1e-13)
    assert s.dissipation[0] == pytest.approx(0, abs=1e-12)
    path = exponentials([-1.0, -0.3, -0.1][:d], np.linspace(0, 0.01, 11)[1:])
    np.testing.assert_allclose(run(s.law, path).tau, [s.to(f) and s.tau for f in path][-1], atol=1e-10)
    assert s.opening[0] == 0


@pytest.mark.parametrize("jump", [0.1, 0.5])
def test_closing_in_one_step(jump):
    """Opened in one step and closed past the start in another: p = K times the compression left."""
    s = Specimen(law(dilation_angle=10.0), 1, 3)
    for strain in (jump, jump / 2, -0.02):
        s.to(np.exp(strain / 3) * np.eye(3))
    np.testing.assert_allclose(s.tau[0], -0.02 * K * np.eye(3), rtol=1e-12, atol=1e-11)
    assert s.plastic_volume[0] == pytest.approx(0, abs=1e-15) and s.opening[0] == 0


@pytest.mark.parametrize("fit", ["compression", "plane_strain"])
def test_cohesive_apex_in_closed_form(fit):
    """Pulled apart by v = 0.05 at tau = c cot phi, which dissipates; closing at tau = 0 gives nothing back.

    Let back, the stress falls elastically from the apex to zero and stays there until ln J = 0. 1e-10: K
    times the round-off in ln J of 110 steps.
    """
    apex = COHESION / np.tan(PHI)
    s = Specimen(law(cohesion=COHESION, dilation_angle=10.0, fit=fit), 1, 3)
    for v in np.linspace(0, 0.05, 51)[1:]:
        s.to(np.exp(v / 3) * np.eye(3))
        np.testing.assert_allclose(s.tau[0], min(K * v, apex) * np.eye(3), atol=1e-10)
    lost = apex * (0.05 - apex / K)
    assert s.dissipation[0] == pytest.approx(lost, rel=1e-12)
    for v in np.linspace(0.05, -0.01, 61)[1:]:
        s.to(np.exp(v / 3) * np.eye(3))
        expected = max(apex - K * (0.05 - v), 0.0) if v > 0 else K * v
        np.testing.assert_allclose(s.tau[0], expected * np.eye(3), atol=1e-10)
    assert s.dissipation[0] == pytest.approx(lost, rel=1e-12)


def test_open_material_shears_without_dilating():
    """Cohesive sand opened and half closed: q = k at p = 0, and no volume by shear until closed."""
    s = Specimen(law(cohesion=COHESION, dilation_angle=10.0), 1, 3)
    start = np.exp(0.01 / 3) * np.eye(3)
    s.to(np.exp(0.02 / 3) * np.eye(3)).to(start)
    opening = s.opening[0]
    for t in np.linspace(0, 0.1, 101)[1:]:
        shear = np.eye(3)
        shear[0, 1] = t
        s.to(shear @ start)
    q, p = invariants(s)
    k = 6 * COHESION * np.cos(PHI) / (3 - np.sin(PHI))
    assert q[0] == pytest.approx(k, rel=1e-12) and p[0] == pytest.approx(0, abs=1e-11)
    assert s.opening[0] == s.plastic_volume[0] == pytest.approx(opening, abs=1e-15)
