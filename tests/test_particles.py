"""Bodies and ways to fill them: volumes, moments, messages."""

import numpy as np
import pytest
from mesh_factory import cube, graded_interval, rectangle

from fempm import Body, NeoHookean, Simulation, WeaklyCompressibleFluid, fill_box, fill_cells
from fempm.locate import find_cells
from fempm.particles import join_bodies
from fempm.simplex import simplex_points

MESHES = {1: graded_interval(0.1, 1.0), 2: rectangle(5, 4, 1.0, 2.0), 3: cube(2)}
ROUND_OFF = 1e-13
SOFT = NeoHookean(density=3.0, young=1.0)


@pytest.mark.smoke
def test_box():
    """Spacing 0.24 in a 1 x 0.5 box gives 4 x 2 squares of side 0.25, with their centres as particles."""
    x, volume = fill_box((1, 2), (2, 2.5), 0.24)
    centres = [(1.125 + 0.25 * i, 2.125 + 0.25 * j) for i in range(4) for j in range(2)]
    np.testing.assert_allclose(x, centres, rtol=ROUND_OFF)
    np.testing.assert_allclose(volume, 0.0625, rtol=ROUND_OFF)


def test_box_in_one_and_three_dimensions():
    """Scalars are corners in 1D; the box is filled even where it is thinner than the spacing."""
    x, volume = fill_box(0, 1, 0.5)
    np.testing.assert_allclose(x, [[0.25], [0.75]], rtol=ROUND_OFF)
    x, volume = fill_box((0, 0, 0), (1, 2, 0.01), 0.5)
    assert x.shape == (8, 3) and np.all(x[:, 2] == 0.005)
    assert volume.sum() == pytest.approx(0.02, rel=ROUND_OFF)


@pytest.mark.parametrize("d", [1, 2, 3])
@pytest.mark.parametrize("per_cell", [1, 3, 5, 6, 7, "2^d", "4^d"])
def test_cells(d, per_cell):
    """Volumes add up; particles are distinct and inside their cells; first moments for powers of 2^d."""
    power = per_cell in (1, "2^d", "4^d")
    n = {"2^d": 2**d, "4^d": 4**d}.get(per_cell, per_cell)
    mesh = MESHES[d]
    x, volume = fill_cells(mesh, n)
    corners = mesh.points[mesh.cells]
    assert len(x) == n * len(corners)
    assert volume.sum() == pytest.approx(mesh.volumes.sum(), rel=ROUND_OFF)
    assert len(np.unique(x.round(12), axis=0)) == len(x)
    b = np.einsum("cij,cnj->cni", mesh.inverse, x.reshape(-1, n, d) - corners[:, :1])
    assert b.min() > 1e-3 and b.sum(axis=2).max() < 1 - 1e-3
    if power or d == 1:
        moments = mesh.volumes @ corners.mean(axis=1)
        np.testing.assert_allclose(volume @ x, moments, rtol=ROUND_OFF)
        np.testing.assert_allclose(x.reshape(-1, n, d).mean(axis=1), corners.mean(axis=1), atol=ROUND_OFF)


@pytest.mark.parametrize("d", [2, 3])
def test_quasi_random_points_are_spread_evenly(d):
    """The mean of 1000 is within 3 log(n) / n of the centroid: low discrepancy, random ones reach 1 / 30."""
    n = 1000
    mean = simplex_points(d, n).mean(axis=0)
    assert np.abs(mean - 1 / (d + 1)).max() < 3 * np.log(n) / n


@pytest.mark.parametrize("count", [0, -3, 2.5])
def test_number_per_cell(count):
    with pytest.raises(ValueError, match=f"{count} particles per cell: give a positive whole number"):
        fill_cells(MESHES[2], count)


def test_predicate_volume_of_a_circle():
    """Only parts that the circle cuts are wrong: the error is below perimeter times their diameter."""
    radius, errors = 0.4, []
    for n in (8, 16, 32):
        mesh = rectangle(n, n)
        longest = np.linalg.norm(np.diff(mesh.points[mesh.cells[:, [0, 1, 2, 0]]], axis=1), axis=2).max()
        x, volume = fill_cells(mesh, 16, lambda x: np.linalg.norm(x - 0.5, axis=1) < radius)
        errors.append(abs(volume.sum() - np.pi * radius**2))
        assert np.linalg.norm(x - 0.5, axis=1).max() < radius
        assert errors[-1] < 2 * np.pi * radius * longest / 4
    assert errors[-1] < 2e-3 * np.pi * radius**2


def test_messages_of_bodies():
    x = np.zeros((3, 2))
    for nothing in (np.zeros((0, 2)), []):
        with pytest.raises(ValueError, match="body 'ball' has no particles"):
            Body(nothing, 1.0, SOFT, name="ball")
    with pytest.raises(ValueError, match=r"body 'ball': particle 1 has volume -2\.0, it must be positive"):
        Body(x, [1.0, -2.0, 1.0], SOFT, name="ball")
    with pytest.raises(ValueError, match=r"particle 2 has volume nan"):
        Body(x, [1.0, 2.0, np.nan], SOFT)
    f = np.tile(np.eye(2), (3, 1, 1))
    f[2, 0, 0] = -1
    with pytest.raises(ValueError, match=r"body 'ball': particle 2 starts inverted, det F = -1"):
        Body(x, 1.0, SOFT, deformation_gradient=f, name="ball")
    with pytest.raises(ValueError, match=r"body 'ball': particle 1 at \[0\. 0\.\] has velocity \[ 0\. nan\]"):
        Body(x, 1.0, SOFT, velocity=lambda x: [[0, 0], [0, np.nan], [np.inf, 0]], name="ball")
    with pytest.raises(ValueError, match="body 'ball' has 2 coordinates, the mesh 3"):
        join_bodies([Body(x, 1.0, SOFT, name="ball")], 3, False)
    with pytest.raises(ValueError, match="at least one body"):
        join_bodies([], 2, False)


def test_several_bodies():
    """Ranges, masses V rho / det F, rotating and uniform velocities, and V0 = V / det F."""
    water = WeaklyCompressibleFluid(density=5.0, bulk=1.0)
    x, volume = fill_box((0.1, 0.1), (0.4, 0.4), 0.05)
    squeezed = np.array([[0.5, 0.2], [0.0, 0.8]])
    bodies = [
        Body(x, volume, SOFT, velocity=lambda x: np.stack([-x[:, 1], x[:, 0]], axis=1), name="a"),
        Body(x + 0.5, 0.0025, water, velocity=(1.0, 2.0), deformation_gradient=squeezed, name="b"),
    ]
    s = Simulation(rectangle(8, 8), bodies)
    p = s.particles
    n = len(x)
    assert p.ranges == [slice(0, n), slice(n, 2 * n)]
    np.testing.assert_array_equal(p.body, np.repeat([0, 1], n))
    assert np.all(np.diff(p.cell[:n]) >= 0) and np.all(np.diff(p.cell[n:]) >= 0)
    np.testing.assert_array_equal(s.gather("position"), np.concatenate([x, x + 0.5]))
    np.testing.assert_array_equal(p.id[:n], np.argsort(find_cells(s.mesh, x), kind="stable"))
    np.testing.assert_array_equal(s.gather("velocity")[:n], np.stack([-x[:, 1], x[:, 0]], axis=1))
    np.testing.assert_array_equal(p.velocity[n:], np.tile([1.0, 2.0], (n, 1)))
    np.testing.assert_allclose(p.volume[n:], 0.0025 / 0.4, rtol=ROUND_OFF)
    np.testing.assert_allclose(p.mass[p.ranges[0]].sum(), 3.0 * 0.09, rtol=ROUND_OFF)
    np.testing.assert_allclose(p.mass[p.ranges[1]].sum(), 5.0 * 0.09 / 0.4, rtol=ROUND_OFF)
    pressure = 1.0 / 7.0 * (0.4**-7 - 1)
    np.testing.assert_allclose(p.cauchy_stress[n:], np.tile(-pressure * np.eye(2), (n, 1, 1)), rtol=1e-12)
    assert np.all(p.stress[:n] == 0)


@pytest.mark.parametrize("velocity", [0.0, (1.0, 2.0), lambda x: x], ids=["zero", "uniform", "function"])
def test_arrays_are_contiguous(velocity):
    """Whatever a body was given: otherwise loops are compiled once more and stride through memory."""
    body = Body(*fill_box((0, 0), (1, 1), 0.25), SOFT, velocity)
    for bodies in ([body], [body, body]):
        p = join_bodies(bodies, 2, True)
        arrays = (p.position, p.velocity, p.mass, p.volume, p.deformation_gradient, p.stress, p.affine)
        assert all(a.flags.c_contiguous and a.flags.writeable for a in arrays)


def test_simulation_leaves_the_body_alone():
    """A body is a starting state: running a simulation with it does not move it."""
    body = Body(*fill_box((0.2, 0.2), (0.8, 0.8), 0.1), SOFT, velocity=(0.1, 0.0))
    before = body.position.copy()
    s = Simulation(rectangle(5, 5), [body])
    s.step(0.1)
    assert np.abs(s.gather("position") - before).max() == pytest.approx(0.01, rel=1e-9)
    np.testing.assert_array_equal(body.position, before)
