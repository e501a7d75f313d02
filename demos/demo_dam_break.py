"""A column of water twice as high as wide collapses along a dry tank (Martin and Moyce, Phil. Trans. R.
Soc. Lond. A 244 (1952), table 2: a = 2.25 in, height 2 a), as a liquid that is slightly compressible."""

from pathlib import Path

import numpy as np

import fempm
from fempm.cli import print_files, run_options, scene_arguments
from fempm.picture import snapshot_strip

MESHES = Path(__file__).parent.parent / "meshes"
A, G = 0.05715, 9.81
# front Z = x / a over T = t sqrt(2 g / a), measured
TIMES = np.array([0.41, 0.84, 1.19, 1.43, 1.63, 1.83, 1.98, 2.20, 2.32, 2.51, 2.65, 2.83, 2.98, 3.11, 3.33])
FRONT = np.array([1.11, 1.22, 1.44, 1.67, 1.89, 2.11, 2.33, 2.56, 2.78, 3.00, 3.22, 3.44, 3.67, 3.89, 4.11])


def main(argv=None):
    options = {
        "cells": (8, "cells across the column"),
        "wall": (("slip", "contact"), "kind of the walls"),
        "sound": (10.0, "speed of sound over sqrt(2 g height), about the speed of the front"),
        "noisy": (False, "leave out F-bar, which averages volume changes and so the pressure"),
        "transfer": (("flip", "apic"), "transfer scheme"),
    }
    args = scene_arguments(__doc__, argv, until=3.4 / np.sqrt(2 * G / A), **options)
    h = A / args.cells
    mesh = fempm.read_mesh(MESHES / "tank.geo", h=h, W=6 * A, H=2.5 * A)
    water = fempm.WeaklyCompressibleFluid(density=1000.0, bulk=1000.0 * args.sound**2 * 4 * G * A)
    column = fempm.Body(*fempm.fill_box([0, 0], [A, 2 * A], h / 2), water, name="water", f_bar=not args.noisy)
    reach = h / 4 if args.wall == "contact" else None
    walls = [fempm.Wall(name, args.wall, reach=reach) for name in ("bottom", "left", "right")]
    scene = fempm.Simulation(
        mesh, [column], walls, gravity=[0, -G], transfer=args.transfer, threads=args.threads
    )
    record = fempm.run(
        scene, **run_options(args), watch=lambda s: {"front": s.gather("position")[:, 0].max() / A}
    )
    time, front = record.log["time"] * np.sqrt(2 * G / A), record.log["front"]
    seen = time[-1] > TIMES
    ours = np.interp(TIMES[seen], time, front)
    print("T = t sqrt(2 g / a), front Z = x / a; measured; shallow water without friction, a bound (Ritter)")
    for t, z, measured in zip(TIMES[seen], ours, FRONT[seen], strict=True):
        print(f"  {t:.2f}  {z:.2f}  {measured:.2f}  {1 + 2 * t:.2f}")
    error = np.sqrt(np.mean((ours - FRONT[seen]) ** 2))
    pressure = np.percentile(-scene.gather("cauchy_stress")[:, 0, 0] / (2000 * G * A), [1, 99])
    print(f"off by {error:.2f} a (RMS); pressure of 98 % of the particles at the end, over that at the")
    print(f"bottom of the column at rest: {pressure[0]:.2f} to {pressure[1]:.2f}")
    moments = [(t, x, np.linalg.norm(v, axis=1)) for t, x, v in record.frames[5::5]]
    print_files([*record.files, snapshot_strip(f"{args.output}.png", moments, label="speed (m/s)")])
    out = {"error": error, "front": ours, "measured": FRONT[seen]}
    return {**out, "pressure": pressure, "record": record}


if __name__ == "__main__":
    main()
