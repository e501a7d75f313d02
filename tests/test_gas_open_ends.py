"""Inflows and outflows keep what passes evenly, at any step; steps that are not possible are made smaller."""

import numpy as np
import pytest
from gas_scenes import AIR, PAIRS, advance, at_rest, box, even_box, jump, positive, run, walls
from test_gas_conservation import KINDS, SIZES

import fempm
from coupling import Flow, Inflow, Outflow, SubsonicInflow


@pytest.mark.parametrize("speed", [0.4, 3.0])
@pytest.mark.parametrize("pair", PAIRS)
@pytest.mark.parametrize("d", [1, 2, 3])
def test_uniform_flow_stays(d, pair, speed):
    """Uniform flow along walls, in at one end and out at the other, slower and faster than sound (1.70)."""
    velocity = [speed, 0.0, 0.0][:d]
    kind = Inflow if speed > 1.7 else SubsonicInflow
    ends = [kind("left", 1.3, 2.7, velocity), Outflow("right"), *walls(d)[2:]]
    gas = Flow(box(d, SIZES[d]), AIR, lambda x: (1.3, velocity, 2.7), ends, pair=pair)
    advance(gas, 30)
    fields = gas.vertex_fields()
    np.testing.assert_allclose(fields["velocity"], [velocity] * len(fields["velocity"]), rtol=0, atol=1e-11)
    np.testing.assert_allclose(fields["density"], 1.3, rtol=1e-11)
    np.testing.assert_allclose(fields["pressure"], 2.7, rtol=1e-11)


@pytest.mark.parametrize("pair", PAIRS)
def test_subsonic_inflow_drives_the_flow(pair):
    """Gas at rest in a tube, pushed from the left at 0.5 like by a piston: the exact shock of that piston.

    Pressure 1.9408215 and a shock at 1.3440307 from (1.4, 0, 1). The gas that comes in has the density behind
    the shock, so that no contact is seen; 1 % and one cell of 1 / 200.
    """
    p, shock = 1.9408215, 1.3440307
    density = 1.4 * shock / (shock - 0.5)
    mesh = fempm.interval_mesh(np.linspace(0, 1, 201))
    gas = Flow(
        mesh, AIR, at_rest(1.4, 1.0), [SubsonicInflow("left", density, p, [0.5]), Outflow("right")], pair=pair
    )
    advance(gas, until=0.5)
    x, fields = mesh.points[:, 0], gas.vertex_fields()
    behind = (x > 0.1) & (x < 0.55)
    assert fields["pressure"][behind].mean() == pytest.approx(p, rel=0.01)
    assert fields["velocity"][behind].mean() == pytest.approx(0.5, rel=0.01)
    front = np.interp(-(1 + p) / 2, -fields["pressure"][behind.argmax() :], x[behind.argmax() :])
    assert front == pytest.approx(0.5 * shock, abs=1.5 / 200)


@pytest.mark.parametrize("kind", ["outflow", "mixed"])
@pytest.mark.parametrize("pair", PAIRS)
@pytest.mark.parametrize("d", [1, 2, 3])
def test_rest_stays_with_open_ends(d, pair, kind):
    """Sound crosses ten cells in a step: noise of the solver's tolerance does not grow."""
    gas = Flow(box(d, SIZES[d]), AIR, at_rest(1.3, 2.7), KINDS[kind](d), pair=pair)
    for _ in range(100):
        gas.step(10 / SIZES[d] / np.sqrt(1.4 * 2.7 / 1.3))
    assert np.abs(gas.vertex_fields()["velocity"]).max() < 1e-8


@pytest.mark.parametrize("d", [1, 2, 3])
def test_rest_stays_with_free_steps(d):
    """The step doubles for ever where nothing moves; noise of the solver's tolerance stays what it is."""
    gas = Flow(box(d, SIZES[d]), AIR, at_rest(1.3, 2.7), KINDS["outflow"](d))
    advance(gas, 40)
    assert np.abs(gas.vertex_fields()["velocity"]).max() < 1e-6


@pytest.mark.parametrize("make", [box, even_box])
def test_mild_blast_in_3d(make):
    """Moving hot gas on a coarse mesh, whose pressure wave is thinner than a cell."""

    def initial(x):
        inside = np.linalg.norm(x - 0.4, axis=1) < 0.25
        velocity = np.where(inside[:, None], 0.3, 0.0) * np.ones_like(x)
        return np.where(inside, 1.0, 0.125), velocity, np.where(inside, 1.0, 0.1)

    gas = Flow(make(3, 5), AIR, initial, walls(3))
    advance(gas, until=0.3)
    assert positive(gas)


@pytest.mark.parametrize("ends", ["walls", "open"])
def test_vacuum_at_cfl_2(ends):
    """Gas parts at Mach 5.3 on both sides, twice the usual step: it ends well or says where it does not."""
    e = walls(1) if ends == "walls" else [Outflow("left"), Outflow("right")]
    gas = Flow(even_box(1, 100), AIR, jump((1, -4, 0.4), (1, 4, 0.4)), e, cfl=2.0)
    run(gas, 0.05)
