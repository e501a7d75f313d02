"""Waves in one dimension: the suite of Kwatra et al. 2009 against exact solutions, orders, sound."""

from functools import cache

import numpy as np
import pytest
from gas_scenes import PAIRS, order, run, table

from coupling.cases import acoustic_step, tube
from coupling.riemann import State, solution

# Bounds of the project at 400 cells. Explicit schemes of second order there: Sod 1.2e-3 (HLLC) or 9.3e-4
# (Roe), Lax 3.8e-3, strong 2.3e-3, Mach 3 2.9e-3, two rarefactions 2.4e-3, blasts 9.3e-2; High Mach 0.97
# with first order.
BOUNDS = {
    "sod": 2.1e-3,
    "lax": 5.8e-3,
    "strong": 4.9e-3,
    "mach3": 6.5e-3,
    "two_rarefactions": 4e-3,
    "high_mach": 0.97,
    "blast": 9.3e-2,
}
SHOCKS = ("sod", "lax", "strong", "mach3", "high_mach", "blast")
# Left and right states once more, so that a slip in the table of the package cannot hide
STATES = {
    "sod": ((1, 0, 1), (0.125, 0, 0.1)),
    "lax": ((0.445, 0.698, 3.528), (0.5, 0, 0.571)),
    "strong": ((1, 0, 1e10), (0.125, 0, 0.1)),
    "mach3": ((3.857, 0.92, 10.333), (1, 3.55, 1)),
    "two_rarefactions": ((1, -2, 0.4), (1, 2, 0.4)),
    "high_mach": ((10, 2000, 500), (20, 0, 500)),
}
TIMES = {"sod": 0.15, "lax": 0.12, "strong": 2.5e-6, "mach3": 0.09, "two_rarefactions": 0.15}
TIMES |= {"high_mach": 1.75e-4, "blast": 0.038, "two_shocks": 0.15}
CELLS = (100, 200, 400, 800)


@cache
def result(name, cells, pair="B1-B0"):
    """Vertices, density, most iterations and repeated steps of a case at CFL 0.5, default options."""
    gas = tube(name, cells, pair=pair)
    log = run(gas, TIMES[name])
    return gas.mesh.points[:, 0], gas.vertex_fields()["density"], log["iterations"].max(), gas.repeated


def exact(name, x):
    """Exact density, or that of the fine reference."""
    if name == "blast":
        columns = table("woodward_colella_t0.038")
        return np.interp(x, *columns[:2])
    left, right = (State(*s) for s in STATES[name])
    return solution(left, right, (x - 0.5) / TIMES[name])[0]


def error(name, cells, pair="B1-B0"):
    """Mean over the vertices of |density - exact|."""
    x, density, *_ = result(name, cells, pair)
    return np.abs(density - exact(name, x)).mean()


@pytest.mark.parametrize("name", BOUNDS)
def test_density_at_400_cells(name):
    """Mean error of the density within the bound; at most 15 iterations a solve, no step repeated."""
    *_, iterations, repeated = result(name, 400)
    assert error(name, 400) <= BOUNDS[name]
    assert iterations <= 15
    assert repeated == 0


@pytest.mark.parametrize("name", SHOCKS)
def test_order_with_shocks(name):
    """Order of convergence from 100 to 800 cells: at most 1 for a jump, 0.78 is asked for."""
    assert order(CELLS, [error(name, n) for n in CELLS]) >= 0.78


def test_two_shocks():
    """Two Sod tubes face to face: exact where only one of them has been, self-convergent at the centre.

    The head of the other tube's rarefaction reaches the centre at 0.1 / 1.183 s; it then moves right at
    u* + c* = 1.925 at most, to 0.626 at the end. There the error may be Sod's. The whole has to converge
    towards 1600 cells, with at least the order of the tubes.
    """
    x, density, iterations, _ = result("two_shocks", 400)
    assert iterations <= 15
    assert np.abs(density - density[::-1]).max() < 1e-7  # iterations stop at 1e-6 of a change
    right = x > 0.63
    wanted = solution(State(1, 0, 1), State(0.125, 0, 0.1), (x[right] - 0.6) / 0.15)[0]
    assert np.abs(density[right] - wanted).sum() / len(x) <= 2.1e-3
    fine_x, fine, *_ = result("two_shocks", 1600)
    errors = []
    for n in (100, 200, 400):
        x, density, *_ = result("two_shocks", n)
        errors.append(np.abs(density - np.interp(x, fine_x, fine)).mean())
    assert order((100, 200, 400), errors) >= 0.78


def sound(x, t):
    """Pressure less 1e9 Pa of the linear waves: p'' = c^2 p_xx with p' = 0 at the start."""
    c, k = np.sqrt(1.4e9), 2 * np.pi
    return 6e4 * np.cos(k * x) * np.cos(k * c * t) + 1e5 * np.sin(2 * k * x) * np.cos(2 * k * c * t)


@pytest.mark.parametrize("pair", PAIRS)
def test_smooth_waves(pair):
    """Second order at acoustic CFL 3 against linear waves, whose own error is some 2e-4 of the amplitude.

    The errors compared (7e-2 to 1e-3 of the amplitude) are far above it.
    """
    errors, cells = [], CELLS if pair == "B1-B0" else CELLS[:-1]
    for n in cells:
        gas = tube("smooth", n, pair=pair)
        run(gas, 5e-5, dt=acoustic_step(n, 3))
        x, p = gas.mesh.points[:, 0], gas.vertex_fields()["pressure"] - 1e9
        errors.append(np.abs(p - sound(x, 5e-5)).mean() / 1.6e5)
        density = gas.vertex_fields()["density"]
        # isentropic: what second order leaves of the entropy is far smaller than the wave
        assert np.abs(density - (1 + p / 1e9) ** (1 / 1.4)).max() < 0.01 * 1.6e5 / 1.4e9
    assert order(cells, errors) >= 1.8
    assert errors[-1] < (2e-3 if pair == "B1-B0" else 1e-2)


@pytest.mark.parametrize("pair", PAIRS)
@pytest.mark.parametrize("courant", [30, 300])
def test_sound_far_beyond_its_limit(courant, pair):
    """Waves that are not resolved in time decay: no growth over 50 steps, mass kept."""
    gas = tube("smooth", 200, pair=pair)
    x, dt = gas.mesh.points[:, 0], acoustic_step(200, courant)
    start = np.abs(sound(x, 0)).max()
    mass = gas.summary()["mass"]
    for _ in range(50):
        gas.step(dt)
        fields = gas.vertex_fields()
        assert np.abs(fields["pressure"] - 1e9).max() <= 1.01 * start
        # sound of amplitude p' moves the gas at p' / (rho c)
        assert np.abs(fields["velocity"]).max() <= 1.01 * start / np.sqrt(1.4e9)
    assert gas.summary()["mass"] == pytest.approx(mass, rel=1e-12)


def metric(name, cells, pair):
    """Thesis equation 3.38, e = sum (rho - rho_b)^2 / (sum rho_b)^2, against the exact density rho_b."""
    x, density, *_ = result(name, cells, pair)
    wanted = exact(name, x)
    return np.sum((density - wanted) ** 2) / np.sum(wanted) ** 2


@pytest.mark.parametrize("name", ["sod", "lax", "mach3"])
def test_pairs_side_by_side(name):
    """Prints N e, which does not fall with N by its definition as e does; L1 errors of the quadratic pair.

    It has to beat the pressure-based codes at hand there, Kwatra's scheme and sonicFoam (the better of
    both), and to reach the order asked of the default pair.
    N e is the mean square error: a discontinuity smeared over a width w makes it proportional to w, which
    a scheme of first order has fall as N^(-1/2) at contacts. It has to fall faster than that.
    """
    cells = CELLS[:-1]
    for pair in PAIRS:
        scaled = [n * metric(name, n, pair) for n in cells]
        values = ", ".join(f"{n}: {v:.2e}" for n, v in zip(cells, scaled))
        print(
            f"{name} {pair} N e {values}, order {order(cells, scaled):.2f}, L1 {error(name, 400, pair):.2e}"
        )
        assert order(cells, scaled) > 0.5
        assert error(name, 400, pair) <= {"sod": 4.19e-3, "lax": 8.1e-3, "mach3": 1.4e-2}[name]
        assert order(cells, [error(name, n, pair) for n in cells]) >= 0.78
        assert result(name, 400, pair)[2] <= 15
