"""Several threads give the results of one."""

import numpy as np
import pytest
from mesh_factory import cube, rectangle

from fempm import Body, NeoHookean, Simulation, Wall, WeaklyCompressibleFluid, fill_cells, run


def scene(d, transfer, threads):
    """A turning elastic ball and a falling drop (two bodies, walls, gravity, a body force)."""
    mesh = rectangle(12, 12) if d == 2 else cube(4)
    ball = fill_cells(mesh, 2**d, lambda x: np.linalg.norm(x - 0.35, axis=1) < 0.2)
    drop = fill_cells(mesh, 2**d, lambda x: np.linalg.norm(x - 0.75, axis=1) < 0.15)

    def turning(x):
        out = np.zeros_like(x)
        out[:, 0], out[:, 1] = 0.35 - x[:, 1], x[:, 0] - 0.35
        return out

    bodies = [
        Body(*ball, NeoHookean(1.0, 10.0, 0.3), velocity=turning),
        Body(*drop, WeaklyCompressibleFluid(1.0, 10.0)),
    ]
    gradient = "consistent" if d == 2 else "plain"
    options = {"gravity": -np.eye(d)[-1], "transfer": transfer, "gradient": gradient, "threads": threads}
    return Simulation(mesh, bodies, [Wall("boundary", "slip")], body_force=lambda x, t: 0.5 - x, **options)


@pytest.mark.parametrize("d, transfer", [(2, "apic"), (3, "flip")])
def test_steps(d, transfer):
    """After 50 steps 1e-12 relative: only the order of sums on the vertices differs (1e-16 a step)."""
    results = []
    for threads in (1, 2):
        s = scene(d, transfer, threads)
        start = s.particles.position.copy()
        for _ in range(50):
            s.step(5e-3)
        assert np.abs(s.particles.position - start).max() > 0.01
        assert s.active_parts()["threads"] == (threads == 2)
        results.append(s)
    one, two = (s.particles for s in results)
    for name in ("position", "velocity", "deformation_gradient", "stress", "affine"):
        a, b = getattr(one, name), getattr(two, name)
        np.testing.assert_allclose(b, a, rtol=0, atol=1e-12 * np.abs(a).max(initial=1.0), err_msg=name)
    np.testing.assert_array_equal(two.cell, one.cell)
    for part in (one, two):
        assert len(part.affine) == (len(part) if transfer == "apic" else 0)


def test_run():
    """Logs and frames of whole runs, three threads against one, to the same 1e-12."""
    one, three = (run(scene(2, "apic", threads), 0.05, frames=2, progress=False) for threads in (1, 3))
    assert list(one.log) == list(three.log) and len(one.frames) == len(three.frames) == 3
    for name, column in one.log.items():
        np.testing.assert_allclose(three.log[name], column, rtol=1e-12, atol=1e-12, err_msg=name)
    for a, b in zip(one.frames, three.frames):
        for x, y in zip(a, b):
            np.testing.assert_allclose(y, x, rtol=0, atol=1e-12)


def test_more_threads_than_cells():
    """Threads without a share do nothing: one particle, four threads, free flight at constant velocity."""
    body = Body([[0.3, 0.3]], 1e-4, NeoHookean(1.0, 1e-9), velocity=(1.0, 0.5))
    s = Simulation(rectangle(12, 12), [body], threads=4)
    for _ in range(10):
        s.step(0.01)
    np.testing.assert_allclose(s.particles.position, [[0.4, 0.35]], rtol=1e-6)
