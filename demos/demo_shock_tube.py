"""Shock tubes of Kwatra et al. 2009, of a gas whose time step is not limited by the speed of sound.

Compared with the exact solution of the Riemann problem; two shocks that meet, blasts between walls and smooth
waves with a run on four times as many cells. --acoustic-cfl is for the smooth waves, which hardly move the
gas: the number of cells that sound crosses in a step."""

import numpy as np

import fempm
from coupling import cases
from coupling.limiters import NAMES
from coupling.picture import profiles
from fempm.cli import print_files, run_options, scene_arguments


def main(argv=None):
    options = {
        "case": (tuple(cases.CASES), "which tube"),
        "cells": (400, "number of cells"),
        "pair": (("B1-B0", "B2-B1"), "spaces of velocity and pressure"),
        "scheme": (("imex", "euler"), "two stages, or the one of the thesis"),
        "limiter": (NAMES[::-1], "limiter of the advection"),
        "cfl": (0.5, "Courant number of |u| and grad p"),
        "acoustic_cfl": (3.0, "Courant number of sound in the smooth waves"),
    }
    args = scene_arguments(__doc__, argv, until=None, threads=False, **options)
    case = cases.CASES[args.case]
    until = args.until or case.until
    scheme = {name: getattr(args, name) for name in ("pair", "scheme", "limiter", "cfl")}
    gas = cases.tube(case, args.cells, **scheme)
    dt = cases.acoustic_step(args.cells, args.acoustic_cfl) if case.ends == "periodic" else None
    run = run_options(args) | {"until": until, "every": args.every or until}
    record = fempm.run(gas, **run, dt=dt, log_every=1)
    x, fields = gas.mesh.points[:, 0], record.frames[-1][1]
    if case.has_exact:
        fine = np.linspace(0, 1, 2001)
        curve = dict(zip(("density", "velocity", "pressure"), case.exact(fine, until)))
        exact = cases.exact_density(case, x, until)
    else:
        courant = min(args.acoustic_cfl, 3.0)
        fine, curve = cases.reference(case, 4 * args.cells, courant, until=until, **scheme)
        exact = curve["density"][::4]
    error = cases.mean_error(x, fields["density"], exact)
    against = "the exact solution" if case.has_exact else f"{4 * args.cells} cells"
    title = f"{case.title}, {args.cells} cells, {args.pair}, t = {until:g} s"
    picture = profiles(f"{args.output}.png", x, fields, (fine, curve), title=title)
    print(f"{title}: mean error of the density {error:.3e}, against {against}")
    iterations = record.log["iterations"]
    print(f"{gas.steps} steps, {gas.repeated} repeated in halves; iterations of a solve: at most", end=" ")
    print(f"{iterations.max():.0f}, {iterations[1:].mean():.1f} on average")
    print_files([*record.files, picture])
    return {"error": error, "steps": gas.steps, "iterations": iterations.max(), "record": record}


if __name__ == "__main__":
    main()
