"""A slope of sensitive clay fails under its suddenly applied weight, slice after slice (thesis 2.3.4).

Undrained clay hardly changes its volume: F-bar keeps it from locking, and sound at 1400 m/s sets the step.
Shear bands are as wide as cells: softening goes with h, so that a band takes as much energy on all meshes."""

from pathlib import Path

import h5py
import numpy as np

import fempm
from fempm.cli import print_files, run_options, scene_arguments
from fempm.picture import curves, snapshot, snapshot_strip

MESHES = Path(__file__).parent.parent / "meshes"


def main(argv=None):
    options = {
        "h": (1.0, "mesh size in m"),
        "width": (5.0, "distance of the smooth sides in m"),
        "poisson": (0.499, "Poisson's ratio; 0.49 is three times as fast"),
        "locking": (False, "leave F-bar out"),
        "full": (False, "as in the thesis: h = 0.2 m, 311,250 particles, more than a day"),
    }
    args = scene_arguments(__doc__, argv, until=3.0, **options)
    h, width = (0.2, 5.0) if args.full else (args.h, args.width)
    mesh = fempm.read_mesh(MESHES / "slope.geo", h=h, B=width)
    x, volume = fempm.fill_box([0, 0, 0], [15, width, 5], h / 2)
    inside = x[:, 0] + x[:, 2] < 15 - 1e-6  # crest 10 m long, 45 degrees
    strength = {"peak": 40.82e3, "residual": 2.45e3, "softening": 5 * h / 0.2}
    clay = fempm.J2Softening(density=2150.0, young=25e6, poisson=args.poisson, **strength)
    slope = fempm.Body(x[inside], volume[inside], clay, name="slope", f_bar=not args.locking)
    walls = [fempm.Wall("bottom", "sticky"), fempm.Wall("back", "slip"), fempm.Wall("sides", "slip")]
    scene = fempm.Simulation(mesh, [slope], walls, [0, 0, -9.81], transfer="flip", threads=args.threads)
    record = fempm.run(
        scene, **run_options(args), watch=lambda s: {"front": s.gather("position")[:, 0].max()}
    )
    time, run_out = record.log["time"], record.log["front"] - record.log["front"][0]
    with h5py.File(record.files[0].with_suffix(".h5"), "r") as file:
        strains = [file[f"{k}/Node/plastic_strain"][:].ravel() for k in range(len(record.frames))]
    near = x[inside, 1] < h / 2  # the particles along one side
    frames = [(t, x, np.minimum(e, 1)) for (t, x, _), e in zip(record.frames, strains, strict=True)]
    side = [(t, x[near][:, ::2], e[near]) for t, x, e in frames[2::6]]
    pictures = [
        snapshot(f"{args.output}.png", *frames[-1][1:], label="plastic strain"),
        snapshot_strip(f"{args.output}_side.png", side, label="plastic strain"),
        curves(f"{args.output}_run_out.png", time, {"": run_out}, "time in s", "run-out in m"),
    ]
    clock = scene.time * np.arange(1, 6) / 5
    print("time (s) and run-out (m), of the foremost particle beyond that at the start:")
    print(np.round(np.stack([clock, np.interp(clock, time, run_out)], axis=1), 3))
    print(f"{np.mean(strains[-1] > 0.2):.1%} of the slope has strained plastically by more than 0.2")
    print_files([*record.files, *pictures])
    return {"run_out": run_out, "strain": strains[-1], "record": record}


if __name__ == "__main__":
    main()
