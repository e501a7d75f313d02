"""The preconditioner of the coupled pressure, against dense matrices."""

import numpy as np
import pytest
from coupled_scenes import block_in_blast

from fempm.parallel import Ranks

pytestmark = pytest.mark.skipif(Ranks().size > 1, reason="looks at all unknowns")


def dense(apply, like):
    """The matrix of a function (x, y) of PETSc vectors."""
    columns = []
    for k in range(like.size):
        x, y = like.duplicate(), like.duplicate()
        x.array[:] = np.arange(like.size) == k
        apply(x, y)
        columns.append(y.array_r.copy())
    return np.array(columns).T


@pytest.mark.smoke
@pytest.mark.parametrize("dim, h, longer", [(2, 0.1, 1.0), (2, 0.1, 100.0), (3, 0.25, 30.0)])
def test_second_sweep(dim, h, longer):
    """It is the formula of `SolidSweep`, positive definite also when sound crosses many cells in a step."""
    scene = block_in_blast(dim, h)
    for _ in range(3):
        scene.dt = scene.stable_step()
        scene.step(scene.dt)
    system, sweep = scene.stages.system, scene.stages.sweep
    system.dt, system.stiffness = longer * system.dt, system.stiffness / longer
    sweep.setUp(None)
    _, special, tensors = system.mass
    system.mass = system.effective, special[:0], tensors[:0]  # walls apart, as the sweep is
    A = dense(lambda x, y: system.mult(None, x, y), system.right)
    P = dense(lambda x, y: sweep.apply(None, x, y), system.right)
    D, inside = np.diag(np.diag(A)), np.zeros(len(A))
    inside[sweep.dofs] = 1
    B = A * np.outer(inside, inside)
    inverse = np.linalg.inv(D)
    exact = inverse + sweep.relaxation * inverse @ (np.diag(inside) @ D - B) @ inverse
    np.testing.assert_allclose(P, exact, atol=1e-12 * np.abs(exact).max())
    assert np.linalg.eigvalsh(P).min() > 0
    assert (sweep.relaxation == 1) == (longer == 1)


def test_fewer_iterations():
    """In a quiet blast the ghost matrix costs Jacobi's method iterations that a second sweep saves."""
    found = []
    for jacobi in (False, True):
        scene = block_in_blast(2, 0.05)
        if jacobi:
            scene.stages.system.ksp.getPC().setType("jacobi")
        for _ in range(10):
            scene.dt = scene.stable_step()
            scene.step(scene.dt)
        found.append(sum(scene.stages.iterations))
    assert found[0] < found[1]
