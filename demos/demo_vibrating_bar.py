"""Axial vibration of an elastic bar, crossing many cells, against the exact solution (thesis 2.3.1)."""

from pathlib import Path

import numpy as np

import fempm
from fempm.cli import print_files, run_options, scene_arguments
from fempm.picture import snapshot

LENGTH, SPEED, WAVE, OMEGA = 25.0, 0.75, np.pi / 50, np.pi / 5  # E = 100 Pa, rho = 1: c = 10 m/s


def background(kind, h):
    """Mesh from the fixed end to beyond the free one: uniform or graded intervals, or triangles."""
    if kind == "delaunay":
        return fempm.read_mesh(Path(__file__).parent.parent / "meshes/bar.geo", h=h, H=max(1.0, 3 * h))
    cycle = [1, 1.3, 1.69, 1.3] if kind == "graded" else [1]
    cells = np.resize(cycle, round(30 / h)) * h / np.mean(cycle)
    return fempm.mark_boundary(
        fempm.interval_mesh(np.append(0, np.cumsum(cells))), "left", lambda x: np.isclose(x[0], 0)
    )


def main(argv=None):
    options = {
        "mesh": (("uniform", "graded", "delaunay"), "cells: 1D uniform, 1D graded by 1.3, 2D triangles"),
        "h": (0.5, "mean cell size in m"),
        "gradient": (("consistent", "plain"), "gradient of the kernel"),
    }
    args = scene_arguments(__doc__, argv, until=10.0, **options)
    mesh = background(args.mesh, args.h)
    upper = [LENGTH, *mesh.points.max(axis=0)[1:]]
    x, volume = fempm.fill_box(np.zeros(mesh.dim), upper, args.h / (4 if mesh.dim == 1 else 3))
    velocity = SPEED * np.sin(WAVE * x[:, :1]) * np.eye(mesh.dim)[0]
    bar = fempm.Body(x, volume, fempm.LinearElastic(density=1.0, young=100.0), lambda x: velocity)
    walls = [fempm.Wall(name, "slip") for name in ("left", "sides") if name in mesh.boundaries]
    scene = fempm.Simulation(
        mesh, [bar], walls, transfer="flip", gradient=args.gradient, threads=args.threads
    )
    middle = np.argmin(np.abs(x[:, 0] - 12.75))

    def watch(scene):
        exact = SPEED / OMEGA * np.sin(OMEGA * scene.time) * np.sin(WAVE * x[:, 0])
        off = scene.gather("position")[:, 0] - x[:, 0] - exact
        stress = scene.gather("cauchy_stress")[middle, 0, 0]
        return {"rms_error": np.sqrt(np.mean(off**2)), "stress": stress}

    record = fempm.run(scene, **run_options(args), log_every=1, dt=0.01 * args.h, watch=watch)
    time, stress = record.log["time"], record.log["stress"]
    error = 100 * record.log["rms_error"].max() / (SPEED / OMEGA)
    picture = snapshot(f"{args.output}.png", time[:, None], stress, label="stress at 12.75 m (Pa)")
    print(f"largest RMS displacement error {error:.3f} % of the amplitude (thesis: 0.554 % for h <= 1)")
    print_files([*record.files, picture])
    return {"error": error, "record": record}


if __name__ == "__main__":
    main()
