"""Error against run time: the bar of demos/demo_vibrating_bar.py, without its files and pictures."""

import time

import numpy as np
from mesh_factory import graded_interval, rectangle

import fempm

LENGTH, SPEED, YOUNG, PERIOD = 25.0, 0.75, 100.0, 10.0
WAVE = np.pi / (2 * LENGTH)
OMEGA = WAVE * np.sqrt(YOUNG)


def background(kind, h):
    """Intervals "graded" by 1.3, or triangles "jittered" by 0.2 h, from 0 to 30, with their walls."""
    if kind == "graded":
        mesh = graded_interval(h, 30.0)
    else:
        height = max(1.0, 3 * h)
        mesh = rectangle(round(30 / h), round(height / h), 30.0, height)
        fempm.mark_boundary(mesh, "sides", lambda x: np.isclose(x[1], 0) | np.isclose(x[1], height))
    fempm.mark_boundary(mesh, "left", lambda x: np.isclose(x[0], 0))
    return mesh


def vibrate(kind, gradient, h, periods=1.0):
    """Run the bar, measuring its error after every step.

    Returns
    -------
    dict : particles, steps, CPU seconds of the setup (mesh, kernel, correction) and of the steps, and
    the largest RMS displacement error in percent of the amplitude
    """
    begin = time.process_time()
    mesh = background(kind, h)
    upper = [LENGTH, *mesh.points.max(axis=0)[1:]]
    position, volume = fempm.fill_box(np.zeros(mesh.dim), upper, h / (4 if mesh.dim == 1 else 3))
    shape, along = np.sin(WAVE * position[:, 0]), np.eye(mesh.dim)[0]
    steel = fempm.LinearElastic(density=1.0, young=YOUNG)
    bar = fempm.Body(position, volume, steel, SPEED * shape[:, None] * along)
    walls = [fempm.Wall(name, "slip") for name in ("left", "sides") if name in mesh.boundaries]
    scene = fempm.Simulation(mesh, [bar], walls, transfer="flip", gradient=gradient)
    setup = time.process_time() - begin
    steps = int(np.ceil(periods * PERIOD / (0.1 * h / np.sqrt(YOUNG))))
    error = seconds = 0.0
    for _ in range(steps):
        begin = time.process_time()
        scene.step(periods * PERIOD / steps)
        seconds += time.process_time() - begin
        exact = SPEED / OMEGA * np.sin(OMEGA * scene.time) * shape
        off = scene.particles.position[:, 0] - (position[:, 0] + exact)[scene.particles.id]
        error = max(error, np.sqrt(np.mean(off**2)))
    return {
        "mesh": kind,
        "gradient": gradient,
        "h": h,
        "particles": len(position),
        "steps": steps,
        "setup_s": setup,
        "steps_s": seconds,
        "error_%": 100 * error / (SPEED / OMEGA),
    }


def error_against_time(sizes):
    """Rows of `vibrate` for both gradients and `sizes`, a dict mesh kind -> mesh sizes."""
    for kind, values in sizes.items():
        vibrate(kind, "consistent", values[0], periods=0.01)  # compiles
    return [
        vibrate(kind, gradient, h)
        for kind, values in sizes.items()
        for gradient in ("plain", "consistent")
        for h in values
    ]
