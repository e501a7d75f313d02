"""Regular meshes of boxes."""

import numpy as np
import pytest

import fempm
from fempm.boxes import SIDES


@pytest.mark.smoke
@pytest.mark.parametrize("upper", [(1.0,), (1.0, 0.4), (1.0, 0.4, 0.6)])
def test_box(upper):
    """Equal cells that fill the box, d! in each cube, and every side is named."""
    d = len(upper)
    mesh = fempm.box_mesh((0.0,) * d, upper, 0.2)
    cubes = np.prod(np.round(np.array(upper) / 0.2))
    assert len(mesh.cells) == cubes * [1, 1, 2, 6][d]
    np.testing.assert_allclose(mesh.volumes, np.prod(upper) / len(mesh.cells), rtol=1e-12)
    sides = [name for pair in SIDES[:d] for name in pair]
    assert sum(len(mesh.boundaries[name]) for name in sides) == len(mesh.exterior_facets)
    for axis, (low, high) in enumerate(SIDES[:d]):
        assert np.all(mesh.points[mesh.boundaries[low], axis] == 0)
        assert np.allclose(mesh.points[mesh.boundaries[high], axis], upper[axis])


def test_diagonals_mirror_each_other():
    """Around every inner vertex of a square mesh four or eight triangles meet, half of the vertices each."""
    mesh = fempm.box_mesh((0, 0), (1, 1), 0.125)
    count = np.bincount(mesh.cells.ravel())
    inner = np.setdiff1d(np.arange(len(count)), np.unique(mesh.exterior_facets))
    assert set(count[inner]) == {4, 8}


def test_bad_boxes():
    for lower, upper, h in (((0, 0), (1, 0), 0.1), ((0,), (1,), 0.0), ((0, 0), (1,), 0.1)):
        with pytest.raises(ValueError, match="must be positive"):
            fempm.box_mesh(lower, upper, h)
