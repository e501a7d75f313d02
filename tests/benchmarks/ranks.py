"""Wall time of a step on several ranks or threads, in 3D: run by mpirun, or with a number of threads.

./run mpirun 2 tests/benchmarks/ranks.py
./run python tests/benchmarks/ranks.py --threads 2
"""

import argparse
import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent))
from benchmarks.throughput import box, full_box


def wall_time(h, threads, repetitions):
    """Particles, ranks, and wall time of a step (best of some repetitions of three steps)."""
    scene = full_box(box(3, h), "apic", "consistent", threads=threads)
    dt = scene.stable_step()
    scene.step(dt)  # compiles
    best = float("inf")
    for _ in range(repetitions):
        scene.ranks.max(0)  # all ranks start together
        begin = time.perf_counter()
        for _ in range(3):
            scene.step(dt)
        best = min(best, scene.ranks.max(time.perf_counter() - begin) / 3)
    return scene.num_particles, scene.ranks, best


def main(argv=None):
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--h", type=float, default=0.058, help="mesh size of the unit cube")
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--repetitions", type=int, default=10)
    args = parser.parse_args(argv)
    n, ranks, seconds = wall_time(args.h, args.threads, args.repetitions)
    if ranks.rank == 0:
        print(
            f"{ranks.size} rank(s), {args.threads} thread(s): {n} particles, {1e3 * seconds:.1f} ms a step, "
            f"{1e-6 * n / seconds:.2f} M particle-steps per second of wall time"
        )
    return n / seconds


if __name__ == "__main__":
    main()
