"""Circular shock on irregular triangles: the radial solution, its symmetry, the order."""

from functools import cache

import numpy as np
import pytest
from gas_scenes import AIR, order, run, table
from mesh_factory import MESHES

import fempm
from coupling import Flow, Outflow


def initial(x):
    """Dense gas of high pressure in a circle of radius 0.4."""
    inside = np.linalg.norm(x, axis=1) < 0.4
    return np.where(inside, 1.0, 0.125), 0.0, np.where(inside, 1.0, 0.1)


@cache
def result(h, pair="B1-B0", **options):
    """The gas and the log of its run."""
    mesh = fempm.read_mesh(MESHES / "tank.geo", h=h, W=2, H=2, x0=-1, y0=-1)
    ends = [Outflow(name) for name in ("left", "right", "bottom", "top")]
    gas = Flow(mesh, AIR, initial, ends, pair=pair, **options)
    return gas, run(gas, 0.25)


def areas(mesh):
    """(nv,) share of each vertex in the area."""
    return np.bincount(mesh.cells.ravel(), np.repeat(mesh.volumes / 3, 3))


def error(gas):
    """Mean over the domain of |density - radial solution|."""
    radius, density = table("circular_shock_t0.25")[:2]
    wanted = np.interp(np.linalg.norm(gas.mesh.points, axis=1), radius, density)
    weight = areas(gas.mesh)
    return weight @ np.abs(gas.vertex_fields()["density"] - wanted) / weight.sum()


@pytest.mark.parametrize("pair, bound", [("B1-B0", 1.68e-2), ("B2-B1", 2.4e-2)])
def test_circular_shock(pair, bound):
    """The error at h = 0.04. Asked for are 4.2e-3 at 47,000 vertices, h = 0.01, and first order.

    Of the quadratic pair nothing is asked: twice the 1.2e-2 that the one-stage prototype has at h = 0.02.
    """
    gas, log = result(0.04, pair)
    print("error", error(gas), "iterations", log["iterations"].max())
    assert error(gas) <= bound
    assert log["iterations"].max() <= 15
    assert gas.repeated == 0


def test_order():
    """At least 0.78 as in one dimension, fitted to h = 0.08, 0.04, 0.02, and twice 4.2e-3 at 0.02."""
    sizes = (0.08, 0.04, 0.02)
    errors = [error(result(h)[0]) for h in sizes]
    print("errors", errors, "order", -order(sizes, errors))
    assert -order(sizes, errors) >= 0.78
    assert errors[-1] <= 8.4e-3
    assert result(0.02)[1]["iterations"].max() <= 15


def spread(gas):
    """Within the rarefaction: scatter of the density around a function of r, mean flow across the radius.

    Both over what they belong to, the density and the flow along the radius.
    """
    x, fields = gas.mesh.points, gas.vertex_fields()
    r = np.linalg.norm(x, axis=1)
    ring = (r > 0.2) & (r < 0.35)
    x, r, density, velocity = x[ring], r[ring], fields["density"][ring], fields["velocity"][ring]
    profile = np.poly1d(np.polyfit(r, density, 4))(r)
    along, across = (
        np.sum(velocity * x, axis=1) / r,
        (velocity[:, 0] * x[:, 1] - velocity[:, 1] * x[:, 0]) / r,
    )
    return np.std(density / profile), np.abs(across).mean() / along.mean()


def test_radial_symmetry():
    """Density at equal radius scatters by less than 1 %, a tenth of its change from cell to cell at h = 0.04.

    Flow across the radius: less than 2 % of that along it. Both fall at least in proportion to h.
    """
    coarse, fine = spread(result(0.04)[0]), spread(result(0.02)[0])
    print("density", coarse[0], fine[0], "flow across", coarse[1], fine[1])
    assert coarse[0] < 0.01
    assert coarse[1] < 0.02
    assert fine[0] < 0.5 * coarse[0]
    assert fine[1] < 0.5 * coarse[1]


def test_momentum_cancels():
    """No wave has reached the ends: the momentum is zero as at the start, far below the solver's 1e-6."""
    gas, _ = result(0.04)
    total = np.array([gas.summary()[f"momentum_{a}"] for a in "xy"])
    fields = gas.vertex_fields()
    size = areas(gas.mesh) * fields["density"] @ np.linalg.norm(fields["velocity"], axis=1)
    print("momentum", total / size)
    assert np.abs(total).max() < 1e-9 * size
