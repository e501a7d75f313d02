"""Exact Riemann solutions: published star states, jump conditions, invariants, conservation."""

import numpy as np
import pytest

from coupling.riemann import State, solution, star_density, star_state

CASES = {  # states left and right, p* and u* of the Kwatra suite with ten digits
    "sod": ((1, 0, 1), (0.125, 0, 0.1), 0.3031301781, 0.92745262),
    "lax": ((0.445, 0.698, 3.528), (0.5, 0, 0.571), 2.466097919, 1.528723027),
    "strong": ((1, 0, 1e10), (0.125, 0, 0.1), 2098480425, 118278.7787),
    "mach3": ((3.857, 0.92, 10.333), (1, 3.55, 1), 1.065429906, 3.603810038),
    "high_mach": ((10, 2000, 500), (20, 0, 500), 16472079.34, 828.4271247),
    "two_rarefactions": ((1, -2, 0.4), (1, 2, 0.4), 0.00189387342, 0),
}


@pytest.mark.parametrize("name", CASES)
def test_star_states(name):
    """To the digits given: 5e-9 relative to the pressure and to the speed of sound."""
    left, right, p, u = CASES[name]
    left, right = State(*left), State(*right)
    pressure, velocity = star_state(left, right)
    assert pressure == pytest.approx(p, rel=5e-9)
    assert abs(velocity - u) < 5e-9 * max(abs(u), left.sound_speed(1.4))
    mirrored = star_state(
        State(right.density, -right.velocity, right.pressure),
        State(left.density, -left.velocity, left.pressure),
    )
    assert mirrored == pytest.approx((pressure, -velocity), rel=1e-13, abs=1e-13 * left.sound_speed(1.4))


def test_density_between_rarefactions():
    assert star_density(0.00189387342, State(1, -2, 0.4)) == pytest.approx(0.02185211821, rel=1e-8)


@pytest.mark.parametrize("name", CASES)
def test_conservation(name):
    """Mass, momentum and energy in a fixed interval change by the flux through its ends.

    Midpoint sums over 200,000 cells err by a jump times a cell: 1e-5 of the largest density, density
    times speed, and energy.
    """
    left, right, _, _ = CASES[name]
    left, right = State(*left), State(*right)
    p, _ = star_state(left, right)
    speed = 3 * max(abs(s.velocity) + np.sqrt(1.4 * max(p, s.pressure) / s.density) for s in (left, right))
    n = 200_000
    xi = (np.arange(n) + 0.5) / n * 2 * speed - speed

    def conserved(rho, u, p):
        return np.array([rho, rho * u, p / 0.4 + 0.5 * rho * u**2])

    def flux(s):
        energy = s.pressure / 0.4 + 0.5 * s.density * s.velocity**2
        momentum = s.density * s.velocity
        return np.array([momentum, momentum * s.velocity + s.pressure, s.velocity * (energy + s.pressure)])

    ends = [conserved(s.density, s.velocity, s.pressure) for s in (left, right)]
    now = conserved(*solution(left, right, xi))
    gained = now.sum(axis=1) * 2 * speed / n - speed * (ends[0] + ends[1])
    scale = np.array([1.0, speed, 1.0]) * np.abs(now[[0, 0, 2]]).max(axis=1)
    assert np.all(np.abs(gained - flux(left) + flux(right)) < 1e-5 * speed * scale)


def test_equal_states_stay():
    rho, u, p = solution(State(1.2, 0.3, 0.9), State(1.2, 0.3, 0.9), np.linspace(-3, 3, 11))
    for values, given in ((rho, 1.2), (u, 0.3), (p, 0.9)):
        np.testing.assert_allclose(values, given, rtol=1e-15)


def test_errors():
    with pytest.raises(ValueError, match="vacuum: the states part at 40 m/s"):
        star_state(State(1, -20, 0.4), State(1, 20, 0.4))
    with pytest.raises(ValueError, match="density must be positive, got -1"):
        State(-1, 0, 1)
    with pytest.raises(ValueError, match="gamma 1"):
        star_state(State(1, 0, 1), State(1, 0, 1), gamma=1)
