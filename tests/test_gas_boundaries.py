"""Gas: inflows, outflows, corners and an oblique shock against the exact relations."""

import numpy as np
import pytest
from gas_scenes import AIR, PAIRS, SIDES, advance, at_rest, box, walls
from mesh_factory import rectangle

import fempm
from coupling import Flow, Inflow, Outflow, SlipWall

WEDGE = """
DefineConstant[h = 0.05];
DefineConstant[lift = 0.1763];
Point(1) = {0, 0, 0, h}; Point(2) = {0.25, 0, 0, h}; Point(3) = {1, 0.75 * lift, 0, h};
Point(4) = {1, 1, 0, h}; Point(5) = {0, 1, 0, h};
Line(1) = {1, 2}; Line(2) = {2, 3}; Line(3) = {3, 4}; Line(4) = {4, 5}; Line(5) = {5, 1};
Curve Loop(1) = {1, 2, 3, 4, 5}; Plane Surface(1) = {1};
Physical Curve("floor") = {1}; Physical Curve("ramp") = {2}; Physical Curve("right") = {3};
Physical Curve("top") = {4}; Physical Curve("left") = {5}; Physical Surface("gas") = {1};
Mesh.Algorithm = 5;
"""


def turning(beta, mach):
    """Angle theta by which an oblique shock at angle beta turns the flow (Anderson, equation 4.17)."""
    normal = (mach * np.sin(beta)) ** 2
    return np.arctan(2 / np.tan(beta) * (normal - 1) / (mach**2 * (1.4 + np.cos(2 * beta)) + 2))


def shock_angle(theta, mach):
    """The weak solution beta for a wedge of angle theta, between the Mach angle and that of most turning."""
    betas = np.linspace(np.arcsin(1 / mach), np.pi / 2, 2001)
    low, high = betas[0], betas[np.argmax(turning(betas, mach))]
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if turning(middle, mach) < theta else (low, middle)
    return low


def test_the_relations():
    """Anderson's chart and table: Mach 2, 10 degrees: 39.3 degrees, pressure ratio 1.707."""
    beta = shock_angle(np.radians(10), 2.0)
    assert np.degrees(beta) == pytest.approx(39.31, abs=0.01)
    assert 1 + 2.8 / 2.4 * ((2 * np.sin(beta)) ** 2 - 1) == pytest.approx(1.7066, abs=1e-3)


@pytest.mark.parametrize("mach, degrees", [(2.0, 10), (3.0, 15)])
def test_oblique_shock(tmp_path, mach, degrees):
    """Flow over a wedge: angle of the shock to 2 degrees, pressure behind it and along the ramp to 3 %.

    The shock is some three cells of 0.03 thick and is followed over 0.5: 2 degrees are half a cell's height.
    """
    pytest.importorskip("gmsh")
    (tmp_path / "wedge.geo").write_text(WEDGE)
    theta = np.radians(degrees)
    mesh = fempm.read_mesh(tmp_path / "wedge.geo", h=0.03, lift=np.tan(theta))
    speed = mach * np.sqrt(1.4)
    ends = [
        Inflow("left", 1.0, 1.0, mach=mach),
        Outflow("right"),
        *(SlipWall(n) for n in ("floor", "ramp", "top")),
    ]
    gas = Flow(mesh, AIR, lambda x: (1.0, [speed, 0.0], 1.0), ends)
    advance(gas, until=2.5 / speed)
    beta = shock_angle(theta, mach)
    ratio = 1 + 2.8 / 2.4 * ((mach * np.sin(beta)) ** 2 - 1)
    fields, x = gas.vertex_fields(), mesh.points
    # where the pressure along vertical lines is half way up
    places = []
    from matplotlib.tri import LinearTriInterpolator, Triangulation

    pressure = LinearTriInterpolator(Triangulation(*x.T, mesh.cells), fields["pressure"])
    lines = np.linspace(0.45, 0.9, 10)
    for at in lines:
        y = np.linspace((at - 0.25) * np.tan(theta) + 1e-6, 0.98, 400)
        p = pressure(np.full(400, at), y).filled(1.0)
        places.append(y[np.flatnonzero(p > (1 + ratio) / 2)[-1]])
    found = np.arctan(np.polyfit(lines, places, 1)[0])
    ramp = (x[:, 0] > 0.5) & (x[:, 0] < 0.9) & (np.abs(x[:, 1] - (x[:, 0] - 0.25) * np.tan(theta)) < 1e-9)
    print(mach, np.degrees([beta, found]), ratio, fields["pressure"][ramp].mean(), gas.steps)
    assert np.degrees(found) == pytest.approx(np.degrees(beta), abs=2)
    assert fields["pressure"][ramp].mean() == pytest.approx(ratio, rel=0.03)
    # along the ramp, not through it
    normal = np.array([-np.sin(theta), np.cos(theta)])
    assert np.abs(fields["velocity"][ramp] @ normal).max() < 1e-12 * speed
    direction = fields["velocity"][ramp].mean(axis=0)
    assert np.arctan2(*direction[::-1]) == pytest.approx(theta, abs=1e-9)
    # ahead of the shock nothing has changed
    ahead = x[:, 1] > x[:, 0] * np.tan(beta) + 0.15
    assert np.abs(fields["pressure"][ahead] - 1).max() < 0.05


@pytest.mark.parametrize("pair", PAIRS)
@pytest.mark.parametrize("d", [1, 2, 3])
def test_supersonic_inflow_keeps_its_state(d, pair):
    """The nodes at the inflow have the state that was given, to the last digits, whatever happens inside."""
    velocity = np.array([3.0, 0.1, 0.0])[:d]
    ends = [Inflow("left", 1.3, 0.9, velocity), *(Outflow(n) for p in SIDES[:d] for n in p if n != "left")]
    gas = Flow(box(d, (60, 10, 4)[d - 1]), AIR, at_rest(1.0, 1.0), ends, pair=pair)
    advance(gas, 15)
    at = np.unique(gas.mesh.facets("left"))
    fields = gas.vertex_fields()
    np.testing.assert_allclose(fields["density"][at], 1.3, rtol=1e-14)
    np.testing.assert_allclose(fields["pressure"][at], 0.9, rtol=1e-12)
    np.testing.assert_allclose(
        fields["velocity"][at], np.tile(velocity, (len(at), 1)), rtol=1e-13, atol=1e-15
    )
    assert fields["velocity"][:, 0].max() > 0.5


def test_mach_number_and_velocity_are_the_same():
    """An inflow given by its Mach number goes straight in, at that many times the speed of sound."""
    fields = []
    for given in ({"mach": 2.0}, {"velocity": [2 * np.sqrt(1.4 * 0.9 / 1.3), 0.0]}):
        ends = [Inflow("left", 1.3, 0.9, **given), Outflow("right"), *walls(2)[2:]]
        fields.append(advance(Flow(box(2, 8), AIR, at_rest(), ends), 10).vertex_fields())
    for name in fields[0]:
        np.testing.assert_allclose(fields[0][name], fields[1][name], rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("pair", PAIRS)
@pytest.mark.parametrize("d", [2, 3])
def test_no_flow_through_walls_of_a_box(d, pair):
    """Normal velocities vanish on all faces, so that nothing moves in the corners; one name for all walls."""
    gas = Flow(box(d, (10, 4)[d - 2]), AIR, swirl, [SlipWall("boundary")], pair=pair)
    advance(gas, 15)
    x, velocity = gas.mesh.points, gas.vertex_fields()["velocity"]
    for k in range(d):
        on = (x[:, k] < 1e-9) | (x[:, k] > 1 - 1e-9)
        assert np.abs(velocity[on, k]).max() < 1e-14
    inside = np.all((x > 0.1) & (x < 0.9), axis=1)
    assert np.abs(velocity[inside]).max() > 0.1


def swirl(x):
    """Gas that turns in the first two directions."""
    velocity = np.zeros_like(x)
    velocity[:, 0], velocity[:, 1] = -(x[:, 1] - 0.5), x[:, 0] - 0.5
    return 1.0, velocity, 1.0


@pytest.mark.parametrize("tilt", [0, 20, 45])
def test_walls_of_any_direction(tilt):
    """A turned box has the flow of the straight one, turned, to the tolerance of the solver.

    With first order: limiters look at components, so that the others depend on the axes.
    """
    c, s = np.cos(np.radians(tilt)), np.sin(np.radians(tilt))
    turn = np.array([[c, -s], [s, c]])
    straight = rectangle(8, 8)

    def state(x):
        inside = np.linalg.norm(x - 0.4, axis=1) < 0.25
        return np.where(inside, 1.0, 0.5), 0.0, np.where(inside, 1.0, 0.5)

    turned = fempm.SimplexMesh(straight.points @ turn.T, straight.cells)
    one = Flow(straight, AIR, state, [SlipWall("boundary")], limiter="first_order")
    other = Flow(turned, AIR, lambda x: state(x @ turn), [SlipWall("boundary")], limiter="first_order")
    for _ in range(10):
        dt = one.stable_step()
        one.step(dt)
        other.step(dt)
        one.dt = other.dt = dt
    a, b = one.vertex_fields(), other.vertex_fields()
    np.testing.assert_allclose(b["velocity"] @ turn, a["velocity"], rtol=0, atol=1e-7)
    np.testing.assert_allclose(b["density"], a["density"], rtol=0, atol=1e-7)
