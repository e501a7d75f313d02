"""A gas flows into densities of two variables, beside independent samples and SVGD (MPM-ParVI)."""

import time
from pathlib import Path

import numpy as np
from parvi_targets import chosen
from svgd import svgd

from fempm.cli import print_files, scene_arguments
from fempm.parvi import sample
from fempm.parvi_diagnostics import compare, stationary_residual
from fempm.parvi_picture import draw_samples

HEAD = "sampler     MMD^2    sliced W2   KSD     s"


def row(name, x, target, exact, seconds):
    """Numbers of a sample, printed."""
    found = compare(x, exact, None if target.window else target.score(x)) | {"s": seconds}
    print(f"  {name:9} {found['MMD2']:8.1e} {found['SW2']:9.3f} {found['KSD']:9.3f} {seconds:6.2f}")
    return found


def main(argv=None):
    args = scene_arguments(
        __doc__,
        argv,
        until=30.0,
        n=(1000, "particles"),
        steps=(500, "steps of SVGD, 0 to leave it out"),
        only=("", "names of targets, separated by commas; all when empty"),
        seed=(0, "seed of the starts and of independent samples"),
    )
    rows, pictures, rng = {}, [], np.random.default_rng(args.seed)
    for name, target in chosen(args.only).items():
        exact = target.draw(4000, rng)
        draws = [compare(x, exact, None) for x in (target.draw(args.n, rng) for _ in range(10))]
        began, options = time.process_time(), target.options() | {"threads": args.threads, "seed": args.seed}
        found = sample(target.score, target.start, n=args.n, until=args.until, progress=False, **options)
        took = time.process_time() - began
        error = stationary_residual(found.mesh, target.log_density, target.score, options.get("walls", ()))
        mean = ", ".join(f"{k} {np.mean([d[k] for d in draws]):.2g}" for k in ("MMD2", "SW2"))
        print(f"{name}: stationary residual {error:.3f}; ten independent samples: {mean}\n  {HEAD}")
        rows[name] = {"iid": row("i.i.d.", target.draw(args.n, rng), target, exact, 0.0)}
        rows[name]["parvi"] = row("MPM-ParVI", found.positions, target, exact, took)
        if args.steps:
            began, rate = time.process_time(), 0.05 * max(1.0, exact.std())
            x = svgd(target.start(args.n, np.random.default_rng(args.seed)), target.score, args.steps, rate)
            rows[name]["svgd"] = row("SVGD", x, target, exact, time.process_time() - began)
        pictures.append((name, found.positions, target.log_density))
    Path(args.output).parent.mkdir(parents=True, exist_ok=True)
    print_files([draw_samples(f"{args.output}.png", pictures)])
    return rows


if __name__ == "__main__":
    main()
