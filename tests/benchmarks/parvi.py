"""Sampling by a gas: error against run time beside SVGD, and the numbers beside independent samples."""

import sys
import time
from pathlib import Path

import numpy as np

from fempm.parvi import sample
from fempm.parvi_diagnostics import compare, sliced_wasserstein, stationary_residual

from .drawing import error_over_time

sys.path.insert(0, str(Path(__file__).resolve().parent.parent.parent / "demos"))

from parvi_targets import targets  # noqa: E402
from svgd import svgd  # noqa: E402

SHOWN = ("banana", "double banana", "U1", "U2", "U3", "U4")
CROSSINGS = (4, 8, 16, 30)
STEPS = (30, 60, 125, 250, 500)


def flow(target, n, seed=0, **options):
    """Positions and CPU seconds of the gas, compiled beforehand; the sampler's result."""
    options = target.options() | {"n": n, "seed": seed, "progress": False} | options
    start = time.process_time()
    found = sample(target.score, target.start, **options)
    return found, time.process_time() - start


def descend(target, n, steps, scale, seed=0):
    """Positions and CPU seconds of SVGD from the same start."""
    x, start = target.start(n, np.random.default_rng(seed)), time.process_time()
    return svgd(x, target.score, steps, 0.05 * max(1.0, scale)), time.process_time() - start


def error_against_time(names, n, crossings, steps, seeds):
    """Rows: target, sampler, amount of work, sliced W2, CPU seconds, means over seeds."""
    rows = []
    for name in names:
        target, rng = targets()[name], np.random.default_rng(1)
        exact = target.draw(20_000, rng)
        flow(target, n, until=4)  # compiles

        def add(sampler, work, found, name=name, exact=exact):
            w2 = np.mean([sliced_wasserstein(x, exact) for x, _ in found])
            row = {"target": name, "sampler": sampler, "n": n, "work": work, "SW2": w2}
            rows.append(row | {"cpu_s": np.mean([seconds for _, seconds in found])})

        add("i.i.d.", 0, [(target.draw(n, rng), 0.0) for _ in range(10)])
        for until in crossings:
            found = [flow(target, n, seed, until=until, tolerance=0) for seed in range(seeds)]
            add("MPM-ParVI", until, [(f.positions, seconds) for f, seconds in found])
        for number in steps:
            add("SVGD", number, [descend(target, n, number, exact.std(), seed) for seed in range(seeds)])
    return rows


def beside_independent(names, n, seeds):
    """Rows: target, n, MMD^2, sliced W2 and KSD of the gas and of independent samples, worst mode weights."""
    rows = []
    for name in names:
        target, rng = targets()[name], np.random.default_rng(2)
        exact = target.draw(20_000, rng)

        def numbers(x, target=target, exact=exact):
            return compare(x, exact, None if target.window else target.score(x))

        drawn = [numbers(target.draw(n, rng)) for _ in range(10)]
        found = [flow(target, n, seed)[0] for seed in range(seeds)]
        mine = [numbers(f.positions) for f in found]
        row = {"target": name, "n": n}
        for key in drawn[0]:
            row[key] = np.mean([m[key] for m in mine])
            row[f"{key} i.i.d."] = np.mean([m[key] for m in drawn])
        if target.modes is not None:
            shares = np.array([target.shares(f.positions) for f in found]) * len(target.modes)
            row |= {"least": shares.min(), "largest": shares.max()}
        else:
            row |= {"least": np.nan, "largest": np.nan}
        walls = target.options().get("walls", ())
        row["residual"] = stationary_residual(found[0].mesh, target.log_density, target.score, walls)
        rows.append(row)
    return rows


def parvi_benchmarks(folder, quick, table, write_csv):
    """All of the above: print tables, write CSV files and a picture into a folder."""
    print(
        "\nMPM-ParVI beside independent samples, means over seeds; least and largest mode over an equal share"
    )
    seeds = 1 if quick else 3
    rows = [
        *beside_independent(("mild banana", "three"), 500, seeds),
        *([] if quick else beside_independent(("mild banana", "three"), 2000, seeds)),
        *beside_independent(("ring", "star"), 500 if quick else 1000, seeds),
        *([] if quick else beside_independent(SHOWN, 1000, seeds)),
    ]
    print(table(rows), flush=True)
    write_csv(folder / "parvi_samples.csv", rows)
    print("\nsliced Wasserstein-2 against CPU time, SVGD from the same starts")
    if quick:
        rows = error_against_time(("U1", "banana"), 200, (4, 8), (30, 125), 1)
    else:
        rows = error_against_time(SHOWN, 1000, CROSSINGS, STEPS, 1)
    print(table(rows), flush=True)
    write_csv(folder / "parvi_error_against_time.csv", rows)
    path, names = folder / "parvi_error_against_time.png", dict.fromkeys((r["target"] for r in rows), "SW2")
    labels = dict.fromkeys(names, "sliced W2")
    error_over_time(path, rows, "target", "sampler", names, labels, columns=3)
