"""Posterior of a logistic regression (breast cancer, three parameters) by a gas, beside SVGD (MPM-ParVI)."""

from pathlib import Path

import numpy as np
from parvi_posteriors import Logistic, gas_and_svgd

from fempm.cli import print_files, scene_arguments
from fempm.parvi_picture import draw_marginals
from fempm.parvi_score import normal_start

NAMES = ("bias", "component 1", "component 2")
MCMC = np.array([[0.431, 7.948, 2.895], [0.220, 0.923, 0.412]])  # |mean| and deviation of a long emcee run


def main(argv=None):
    args = scene_arguments(
        __doc__, argv, until=20.0, n=(1000, "particles"), steps=(300, "steps of SVGD, 0 to leave it out")
    )
    posterior, start = Logistic(), normal_start((0.0, 5.0, 2.0), (0.5, 1.5, 1.0))
    found, results = gas_and_svgd(posterior.score, start, args, 0.05)
    print("           deviation of |mean| in sd, of the sd in %, accuracy, CPU s")
    out = {}
    for name, (x, seconds) in results.items():
        off = (np.abs(x.mean(axis=0)) - MCMC[0]) / MCMC[1], 100 * (x.std(axis=0) / MCMC[1] - 1)
        accuracy = posterior.accuracy(x.mean(axis=0))
        print(f"{name:10} {off[0].round(3)} {off[1].round(1)} {accuracy:.3f} {seconds:.1f}")
        out[name] = {"mean": off[0], "deviation": off[1]}
    print(f"net force {found.diagnostics['net_force']:.3f}, mesh size {found.size.round(3)}")
    Path(args.output).parent.mkdir(parents=True, exist_ok=True)
    other = results.get("SVGD", (None,))[0]
    print_files([draw_marginals(f"{args.output}.png", found.positions, NAMES, other)])
    return out


if __name__ == "__main__":
    main()
