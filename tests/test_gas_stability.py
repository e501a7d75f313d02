"""Gas under stress: each case ends well, positive and conservative, or stops with a clear error."""

import numpy as np
import pytest
from gas_scenes import AIR, PAIRS, advance, box, even_box, jump, positive, run, totals, walls

import fempm
from coupling import Flow, IdealGas, Outflow
from coupling.cases import CASES, tube
from coupling.riemann import State, star_state
from fempm import SimulationError


@pytest.fixture(autouse=True)
def elsewhere(tmp_path, monkeypatch):
    """Runs that fail write their last state to the present folder."""
    monkeypatch.chdir(tmp_path)


def ends_well(gas, until):
    """Run to a time or to a clear error; True if it got there, with positive states and what it had."""
    before = totals(gas)
    try:
        fempm.run(gas, until, frames=1, progress=False)
    except SimulationError as error:
        text = str(error)
        assert "could not go on from time" in text
        return False
    assert positive(gas)
    change = totals(gas) - before
    assert np.abs(change[[0, -1]] / before[[0, -1]]).max() < 1e-11
    return True


def closed(mesh, initial, **options):
    """Gas between slip walls on all sides."""
    return Flow(mesh, AIR, initial, walls(mesh.dim), **options)


@pytest.mark.parametrize("pair", PAIRS)
@pytest.mark.parametrize("cfl", [0.1, 0.5, 1.0, 2.0])
def test_courant_numbers(cfl, pair):
    """Sod's tube: at 0.1 to 1 it ends well, with less error than the thesis's stage at 0.5 (design note)."""
    gas = closed(even_box(1, 200), jump((1, 0, 1), (0.125, 0, 0.1)), cfl=cfl, pair=pair)
    assert ends_well(gas, 0.15) or cfl > 1
    if cfl <= 1:
        exact = CASES["sod"].exact(gas.mesh.points[:, 0], 0.15)[0]
        error = np.abs(gas.vertex_fields()["density"] - exact).mean()
        print(cfl, pair, error, gas.steps)
        assert error < 8.6e-3


@pytest.mark.parametrize("pair", PAIRS)
@pytest.mark.parametrize("d", [1, 2, 3])
def test_density_ratio(d, pair):
    """10^4 at equal pressure: nothing moves, in no dimension."""
    gas = closed(
        box(d, (50, 8, 3)[d - 1]), lambda x: (np.where(x[:, 0] < 0.5, 1.0, 1e-4), 0.0, 1.0), pair=pair
    )
    density = gas.vertex_fields()["density"]
    advance(gas, 10)
    fields = gas.vertex_fields()
    assert np.abs(fields["velocity"]).max() < 1e-6  # speeds of sound are 1.2 and 118
    np.testing.assert_allclose(fields["density"], density, rtol=1e-5)
    np.testing.assert_allclose(fields["pressure"], 1.0, rtol=1e-7)


def test_density_ratio_in_motion():
    """A slug of 10^4 times the density of the gas around it moves on at its speed, with the gas."""
    gas = Flow(
        even_box(1, 200),
        AIR,
        lambda x: (np.where(np.abs(x[:, 0] - 0.3) < 0.1, 1.0, 1e-4), np.ones_like(x), 1.0),
        [Outflow("left"), Outflow("right")],
    )
    run(gas, 0.3)
    fields, x = gas.vertex_fields(), gas.mesh.points[:, 0]
    assert positive(gas)
    assert np.abs(fields["pressure"] - 1).max() < 0.01
    assert fields["density"] @ x / fields["density"].sum() == pytest.approx(0.6, abs=0.005)


def test_pressure_ratio():
    """10^11, the strong tube of Kwatra et al., between walls: exact states behind the shock to 1 %."""
    gas = closed(even_box(1, 400), CASES["strong"].initial)
    assert ends_well(gas, 2.5e-6)
    fields, x = gas.vertex_fields(), gas.mesh.points[:, 0]
    behind = np.abs(x - 0.5 - 118278.7787 * 2.5e-6 + 0.03) < 0.02
    assert fields["velocity"][behind].mean() == pytest.approx(118278.7787, rel=0.01)
    assert fields["pressure"][behind].mean() == pytest.approx(2098480425, rel=0.01)


def test_pressure_ratio_in_two_dimensions():
    """The same states in a circle, on irregular triangles: well, or an error that says where."""

    def initial(x):
        inside = np.linalg.norm(x - 0.5, axis=1) < 0.2
        return np.where(inside, 1.0, 0.125), 0.0, np.where(inside, 1e10, 0.1)

    ends_well(closed(box(2, 20), initial), 2e-6)


def slivers():
    """A box whose middle row is squeezed to a hundredth: angles of one degree."""
    mesh = even_box(2, 12)
    y = mesh.points[:, 1]
    y[:] = np.interp(y, [0, 5 / 12, 6 / 12, 1], [0, 0.4993, 0.5007, 1])
    return fempm.SimplexMesh(mesh.points, mesh.cells, boundaries=mesh.boundaries)


@pytest.mark.parametrize("pair", PAIRS)
def test_slivers(pair):
    """Sod's tube along cells 60 times as long as high ends well, the quadratic pair perhaps in an error."""
    mesh = slivers()
    corners = mesh.points[mesh.cells]
    sides = np.roll(corners, -1, axis=1) - corners
    sides /= np.linalg.norm(sides, axis=2, keepdims=True)
    cosines = -np.sum(sides * np.roll(sides, 1, axis=1), axis=2)
    assert np.degrees(np.arccos(cosines.max())) < 1.05
    gas = closed(mesh, jump((1, 0, 1), (0.125, 0, 0.1)), pair=pair)
    if not ends_well(gas, 0.15):
        assert pair == "B2-B1"
        return
    exact = CASES["sod"].exact(mesh.points[:, 0], 0.15)[0]
    error = np.abs(gas.vertex_fields()["density"] - exact).mean()
    print(pair, error, gas.steps, gas.repeated)
    assert error < 0.06  # first order from 8.7e-3 at 200 cells to 12 would be 0.14


@pytest.mark.parametrize("pair", PAIRS)
@pytest.mark.parametrize("share", [0.5, 0.9, 0.99])
def test_near_vacuum(share, pair):
    """States that part at a share of the speed at which a vacuum opens."""
    speed = share * 2 / 0.4 * np.sqrt(1.4 * 0.4)
    left, right = (1.0, -speed, 0.4), (1.0, speed, 0.4)
    gas = Flow(even_box(1, 200), AIR, jump(left, right), [Outflow("left"), Outflow("right")], pair=pair)
    run(gas, 0.3 / (speed + 0.75))
    assert positive(gas)
    wanted = star_state(State(*left), State(*right))[0]
    least = gas.vertex_fields()["pressure"].min()
    print(share, pair, wanted, least, gas.repeated)
    assert least < 0.1 * 0.4
    assert np.abs(gas.vertex_fields()["velocity"]).max() < 1.01 * speed


def test_beyond_vacuum():
    """A vacuum opens: the gas stays positive, or it stops and says so."""
    gas = closed(even_box(1, 100), jump((1, -8, 0.4), (1, 8, 0.4)))
    ends_well(gas, 0.03)


@pytest.mark.parametrize("gamma", [1.01, 1.1, 5 / 3, 3.0])
def test_other_gases(gamma):
    """Sod's states with other ratios of specific heats: the star pressure of the exact solution to 1 %."""
    gas = Flow(even_box(1, 200), IdealGas(gamma), jump((1, 0, 1), (0.125, 0, 0.1)), walls(1))
    run(gas, 0.12)
    wanted, speed = star_state(State(1, 0, 1), State(0.125, 0, 0.1), gamma)
    fields, x = gas.vertex_fields(), gas.mesh.points[:, 0]
    near = np.abs(x - 0.5 - 0.12 * speed) < 0.02
    assert fields["pressure"][near].mean() == pytest.approx(wanted, rel=0.01)
    assert fields["velocity"][near].mean() == pytest.approx(speed, rel=0.01)


@pytest.mark.parametrize("courant", [1, 10])
def test_reflection(courant):
    """A weak pulse leaves through an open end; the wave that comes back is less than 1 % of it.

    That is (p' - rho c u') / 2 when sound has crossed the tube once and all of the pulse has arrived there.
    """
    sound, height = np.sqrt(1.4), 1e-4

    def initial(x):
        p = height * np.exp(-(((x[:, 0] - 0.5) / 0.1) ** 2))
        return 1 + p / sound**2, (p / sound)[:, None], 1 + p

    gas = Flow(even_box(1, 100), AIR, initial, [Outflow("left"), Outflow("right")])
    for _ in range(int(100 / courant)):
        gas.step(courant / 100 / sound)
    fields = gas.vertex_fields()
    back = (fields["pressure"] - 1 - sound * fields["velocity"][:, 0]) / (2 * height)
    print(courant, np.abs(back).max())
    assert np.abs(back).max() < 0.01


@pytest.mark.parametrize("name", ["lax", "mach3", "two_rarefactions", "high_mach", "blast"])
def test_one_stage(name):
    """The thesis's one stage runs the suite as well; it reports fewer than 80 iterations a solve."""
    gas = tube(name, 200, scheme="euler")
    log = run(gas, CASES[name].until)
    print(name, log["iterations"].max())
    assert positive(gas)
    assert log["iterations"].max() < 80
