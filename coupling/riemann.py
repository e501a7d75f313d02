"""Exact solution of the Riemann problem of an ideal gas (Toro, Riemann Solvers, 3rd edition, chapter 4)."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class State:
    """Primitive state of a gas: density (kg/m^3), velocity (m/s), pressure (Pa)."""

    density: float
    velocity: float
    pressure: float

    def __post_init__(self):
        for name in ("density", "pressure"):
            if not getattr(self, name) > 0:
                raise ValueError(f"state of a gas: {name} must be positive, got {getattr(self, name)}")

    def sound_speed(self, gamma):
        """Speed of sound sqrt(gamma p / rho)."""
        return np.sqrt(gamma * self.pressure / self.density)


def star_state(left, right, gamma=1.4):
    """Pressure and velocity between the nonlinear waves.

    Parameters
    ----------
    left, right : State
    gamma : ratio of specific heats, above 1

    Returns
    -------
    pressure, velocity : floats

    Raises
    ------
    ValueError
        where the states part so fast that a vacuum opens
    """
    if not gamma > 1:
        raise ValueError(f"gamma {gamma}: the ratio of specific heats must exceed 1")
    c = left.sound_speed(gamma) + right.sound_speed(gamma)
    apart = right.velocity - left.velocity
    if not apart < 2 * c / (gamma - 1):
        raise ValueError(
            f"vacuum: the states part at {apart:.6g} m/s, below {2 * c / (gamma - 1):.6g} they keep in touch"
        )

    def excess(p):
        (f, df), (g, dg) = velocity_jump(p, left, gamma), velocity_jump(p, right, gamma)
        return f + g + apart, df + dg

    # two-rarefaction pressure: `excess` is concave and rises, so that Newton from the left does not overshoot
    z = (gamma - 1) / (2 * gamma)
    cl, cr = left.sound_speed(gamma), right.sound_speed(gamma)
    p = ((c - 0.5 * (gamma - 1) * apart) / (cl / left.pressure**z + cr / right.pressure**z)) ** (1 / z)
    low = min(p, left.pressure, right.pressure)
    if excess(p)[0] > 0:
        p = low if excess(low)[0] <= 0 else p
    for _ in range(200):
        value, slope = excess(p)
        new = max(p - value / slope, 0.1 * p)
        done = abs(new - p) <= 4e-16 * new
        p = new
        if done:
            break
    f, g = velocity_jump(p, left, gamma)[0], velocity_jump(p, right, gamma)[0]
    return float(p), float(0.5 * (left.velocity + right.velocity) + 0.5 * (g - f))


def velocity_jump(p, state, gamma):
    """Change of velocity across the wave from `state` to pressure p, and its slope (Toro 4.6, 4.37)."""
    if p > state.pressure:
        a, b = 2 / ((gamma + 1) * state.density), (gamma - 1) / (gamma + 1) * state.pressure
        root = np.sqrt(a / (p + b))
        return (p - state.pressure) * root, root * (1 - 0.5 * (p - state.pressure) / (p + b))
    c, ratio = state.sound_speed(gamma), p / state.pressure
    z = (gamma - 1) / (2 * gamma)
    # expm1: a weak wave would lose its digits in ratio^z - 1
    return 2 * c / (gamma - 1) * np.expm1(z * np.log(ratio)), ratio ** (z - 1) * c / (gamma * state.pressure)


def star_density(p, state, gamma=1.4):
    """Density behind the wave from `state` to pressure p."""
    ratio, mu = p / state.pressure, (gamma - 1) / (gamma + 1)
    if ratio > 1:
        return state.density * (ratio + mu) / (mu * ratio + 1)
    return state.density * ratio ** (1 / gamma)


def solution(left, right, xi, gamma=1.4):
    """Density, velocity and pressure (n,) each at the similarity variable xi = (x - x0) / t (n,)."""
    xi = np.asarray(xi, float)
    p, u = star_state(left, right, gamma)
    # the right half is the left half seen in a mirror
    sides = [
        half(left, p, u, xi, gamma),
        half(State(right.density, -right.velocity, right.pressure), p, -u, -xi, gamma),
    ]
    sides[1][1] *= -1
    return tuple(np.where(xi < u, a, b) for a, b in zip(*sides, strict=True))


def half(state, p, u, xi, gamma):
    """[density, velocity, pressure] left of the contact, for the wave that runs left into `state`."""
    c, star = state.sound_speed(gamma), star_density(p, state, gamma)
    if p > state.pressure:
        ahead = xi < state.velocity - c * np.sqrt(
            (gamma + 1) / (2 * gamma) * p / state.pressure + (gamma - 1) / (2 * gamma)
        )
        inside = np.zeros(xi.shape, bool)
    else:
        ahead = xi < state.velocity - c
        inside = ~ahead & (xi < u - np.sqrt(gamma * p / star))
    fan = (2 + (gamma - 1) * (state.velocity - xi) / c) / (gamma + 1)  # sound speed there over c
    fan = np.where(inside, fan, 1.0)
    values = [
        (state.density, state.density * fan ** (2 / (gamma - 1)), star),
        (state.velocity, (2 * (c + xi) + (gamma - 1) * state.velocity) / (gamma + 1), u),
        (state.pressure, state.pressure * fan ** (2 * gamma / (gamma - 1)), p),
    ]
    return [np.where(ahead, before, np.where(inside, among, after)) for before, among, after in values]
