"""A small elastic scene over a million steps: does its total energy ever rise?"""

import argparse
import sys
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent.parent))
from mesh_factory import rectangle

import fempm
from fempm.diagnostics import energies

MATERIAL = fempm.NeoHookean(density=1000.0, young=1e5, poisson=0.3)


def scene(transfer):
    """A square that is stretched and turning, falls and rebounds in a box with contact and friction."""
    x, volume = fempm.fill_box((0.3, 0.3), (0.7, 0.7), 0.4 / 6)
    body = fempm.Body(
        x,
        volume,
        MATERIAL,
        velocity=lambda x: np.stack([1 - 2 * (x[:, 1] - 0.5), 2 * (x[:, 0] - 0.5)], axis=1),
        deformation_gradient=np.diag([1.1, 0.95]),
    )
    walls = [fempm.Wall("boundary", "contact", friction=0.2)]
    return fempm.Simulation(rectangle(8, 8), [body], walls, gravity=[0.0, -9.81], transfer=transfer)


def long_run(transfer, steps):
    """Largest and last total energy over the first one, and steps per second.

    The reference of gravity's energy is the floor, so that all parts are positive.
    """
    s = scene(transfer)
    start, largest = sum(energies(s).values()), 1.0
    begin = time.perf_counter()
    for step in range(steps):
        s.step(s.stable_step())
        if step < 1000 or step % 20 == 0 or step == steps - 1:
            total = sum(energies(s).values())
            largest = max(largest, total / start)
    return {
        "transfer": transfer,
        "particles": s.num_particles,
        "steps": steps,
        "time": s.time,
        "largest": largest,
        "last": total / start,
        "steps/s": steps / (time.perf_counter() - begin),
        "put back": s.wall_hits,
    }


def main(argv=None):
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=1_000_000, help="time steps (default: %(default)s)")
    parser.add_argument("--transfer", nargs="+", default=["flip", "apic"], choices=["flip", "apic", "pic"])
    args = parser.parse_args(argv)
    for transfer in args.transfer:
        print(
            ", ".join(
                f"{k} {v:.6g}" if k != "transfer" else v for k, v in long_run(transfer, args.steps).items()
            )
        )


if __name__ == "__main__":
    main()
