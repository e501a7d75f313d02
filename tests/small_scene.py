"""A small scene that tests of runs share; as a program, a run of it on any number of ranks."""

import os
import shutil
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from mesh_factory import rectangle

import fempm
from fempm.cli import run_options, scene_arguments
from fempm.parallel import Ranks


class Alone(Ranks):
    """Ranks of a program that runs without MPI."""

    def __init__(self):
        self.comm, self.rank, self.size = None, 0, 1


@dataclass(frozen=True)
class Fatigue(fempm.NeoHookean):
    """Loses stiffness with the largest change of volume so far: a law with an internal variable."""

    state = {"worst": ()}

    def kirchhoff_stress(self, deformation_gradient, out, worst):
        bad = super().kirchhoff_stress(deformation_gradient, out)
        np.maximum(worst, np.abs(np.linalg.det(deformation_gradient) - 1), out=worst)
        out *= (1 - 0.5 * np.minimum(worst, 1))[:, None, None]
        return bad

    def energy(self, deformation_gradient, worst):
        return super().energy(deformation_gradient)


def scene(transfer="apic", cells=10, **options):
    """Two blocks of different materials that fly apart, turn and hit the walls of a box."""
    mesh = rectangle(cells, cells)
    first = fempm.Body(
        *fempm.fill_box((0.15, 0.3), (0.5, 0.7), 0.4 / cells),
        Fatigue(1.0, 20.0, 0.3),
        velocity=lambda x: np.stack([-2 * (x[:, 1] - 0.3), x[:, 0]], axis=1),
        name="first",
    )
    second = fempm.Body(
        *fempm.fill_box((0.5, 0.2), (0.85, 0.8), 0.4 / cells),
        fempm.NeoHookean(1.0, 10.0),
        velocity=(1.0, -0.5),
        name="second",
    )
    options = {"walls": [fempm.Wall("boundary", "slip")], "gravity": (0.0, -1.0), **options}
    return fempm.Simulation(mesh, options.pop("bodies", [first, second]), transfer=transfer, **options)


def state(simulation):
    """Copies of all that a simulation goes on from, of this rank, in the order in memory."""
    s = simulation
    numbers = (s.time, s.dt, s.steps, s.dropped_vertices, s.lost_momentum, s.wall_hits, s.particles.counts)
    return {name: array.copy() for name, array in s.particles.arrays.items()} | {
        "numbers": np.hstack(numbers),
        "owner": s.owner.copy(),
        "order": s.order[: len(s.particles)].copy(),
        "vertices": s.vertices[: s.num_vertices].copy(),
    }


def advance(simulation, steps):
    """Steps of stable length."""
    for _ in range(steps):
        simulation.dt = simulation.stable_step()
        simulation.step(simulation.dt)


def command(ranks):
    """The start of a command line that runs Python on so many ranks, and its environment."""
    env = {k: v for k, v in os.environ.items() if not k.startswith(("PMI", "OMPI_COMM", "PMIX"))}
    env |= {"OMP_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1"}
    if ranks == 1:
        return [sys.executable], env
    env |= {"OMPI_ALLOW_RUN_AS_ROOT": "1", "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1"}
    env |= {"OMPI_MCA_rmaps_base_oversubscribe": "1", "OMPI_MCA_hwloc_base_binding_policy": "none"}
    env |= {"OMPI_MCA_mpi_yield_when_idle": "1"}
    own = Path(sys.executable).parent / "mpirun"
    mpirun = str(own) if own.exists() else shutil.which("mpirun")
    return [mpirun, "-n", str(ranks), sys.executable, "-m", "mpi4py"], env


def main(argv=None):
    args = scene_arguments(__doc__, argv, until=0.3, every=0.03, cells=(10, "cells along a side"))
    simulation = scene(cells=args.cells)
    fempm.run(simulation, **run_options(args), log_every=5, progress=False)
    print(simulation.steps, "steps")


if __name__ == "__main__":
    main()
