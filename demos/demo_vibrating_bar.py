"""Axial vibration of an elastic bar, crossing many cells, against the exact solution (thesis 2.3.1)."""

from pathlib import Path

import numpy as np
from dolfinx.mesh import create_interval
from mpi4py import MPI

import fempm
from fempm.cli import print_files, scene_arguments
from fempm.picture import snapshot

LENGTH, SPEED, YOUNG, PERIOD = 25.0, 0.75, 100.0, 10.0
WAVE = np.pi / (2 * LENGTH)
OMEGA = WAVE * np.sqrt(YOUNG)


def background(kind, h):
    """Mesh from the fixed end to beyond the free one: uniform or graded intervals, or triangles."""
    left = {"left": lambda x: np.isclose(x[0], 0)}
    if kind == "uniform":
        mesh = create_interval(MPI.COMM_WORLD, round(30 / h), [0.0, 30.0])
        return fempm.from_dolfinx(mesh, boundaries=left)
    if kind == "graded":
        cycle = np.tile([1, 1.3, 1.69, 1.3], round(8 / h))
        mesh = fempm.interval_mesh(np.append(0, np.cumsum(cycle) * h / 1.3225))
        return fempm.mark_boundary(mesh, "left", left["left"])
    return fempm.read_mesh(Path(__file__).parent.parent / "meshes/bar.geo", h=h, H=max(1.0, 3 * h))


def main(argv=None):
    options = {
        "mesh": (("uniform", "graded", "delaunay"), "cells: 1D uniform, 1D graded by 1.3, 2D triangles"),
        "h": (0.5, "mean cell size in m"),
        "gradient": (("consistent", "plain"), "gradient of the kernel"),
    }
    args = scene_arguments(__doc__, argv, **options)
    mesh = background(args.mesh, args.h)
    upper = [LENGTH, *mesh.points.max(axis=0)[1:]]
    particles = fempm.fill_box(np.zeros(mesh.dim), upper, args.h / (4 if mesh.dim == 1 else 3))
    steel = fempm.LinearElastic(density=1.0, young=YOUNG)
    bar = fempm.Body(*particles, steel, lambda x: SPEED * np.sin(WAVE * x[:, :1]) * np.eye(mesh.dim)[0])
    walls = [fempm.Wall(name, "slip") for name in ("left", "sides") if name in mesh.boundaries]
    scene = fempm.Simulation(
        mesh, [bar], walls, transfer="flip", gradient=args.gradient, threads=args.threads
    )
    middle = np.argmin(np.abs(bar.position[:, 0] - 12.75))

    def watch(simulation):
        exact = SPEED / OMEGA * np.sin(OMEGA * simulation.time) * np.sin(WAVE * bar.position[:, 0])
        off = simulation.particles.position[:, 0] - bar.position[:, 0] - exact
        return {
            "rms_error": np.sqrt(np.mean(off**2)),
            "stress": simulation.particles.cauchy_stress[middle, 0, 0],
        }

    record = fempm.run(scene, PERIOD, args.output, log_every=1, dt=0.1 * args.h / np.sqrt(YOUNG), watch=watch)
    log = record.log
    error = 100 * log["rms_error"].max() / (SPEED / OMEGA)
    picture = snapshot(
        f"{args.output}.png", log["time"][:, None], log["stress"], label="stress at 12.75 m (Pa)"
    )
    print(
        f"largest RMS displacement error {error:.3f} % of the amplitude (thesis: at most 0.554 % for h <= 1)"
    )
    print_files([*record.files, picture])
    return {"error": error, "record": record}


if __name__ == "__main__":
    main()
