"""A slope of sensitive clay fails under its suddenly applied weight, slice after slice (thesis 2.3.4).

Undrained clay hardly changes its volume: F-bar keeps it from locking, and sound at 1400 m/s sets the step.
Shear bands are as wide as cells: softening goes with h, so that a band takes as much energy on all meshes."""

from pathlib import Path

import h5py
import numpy as np

import fempm
from fempm.cli import print_files, run_options, scene_arguments
from fempm.picture import snapshot, snapshot_strip

MESHES = Path(__file__).parent.parent / "meshes"


def main(argv=None):
    options = {
        "h": (1.0, "mesh size in m"),
        "width": (5.0, "distance of the smooth sides in m"),
        "poisson": (0.499, "Poisson's ratio; 0.49 is three times as fast"),
        "locking": (False, "leave F-bar out"),
        "full": (False, "as in the thesis: h = 0.2 m, 311,250 particles, more than a day"),
    }
    args = scene_arguments(__doc__, argv, until=2.5, **options)
    h, width = (0.2, 5.0) if args.full else (args.h, args.width)
    mesh = fempm.read_mesh(MESHES / "slope.geo", h=h, B=width)
    x, volume = fempm.fill_box([0, 0, 0], [15, width, 5], h / 2)
    inside = x[:, 0] + x[:, 2] < 15 - 1e-6  # crest 10 m long, 45 degrees
    strength = {"peak": 40.82e3, "residual": 2.45e3, "softening": 5 * h / 0.2}
    clay = fempm.J2Softening(density=2150.0, young=25e6, poisson=args.poisson, **strength)
    slope = fempm.Body(x[inside], volume[inside], clay, name="slope", f_bar=not args.locking)
    walls = [fempm.Wall("bottom", "sticky"), fempm.Wall("back", "slip"), fempm.Wall("sides", "slip")]
    scene = fempm.Simulation(mesh, [slope], walls, [0, 0, -9.81], transfer="flip", threads=args.threads)
    first = x[inside, 0].max()
    record = fempm.run(
        scene, **run_options(args), watch=lambda s: {"run_out": s.gather("position")[:, 0].max() - first}
    )
    time, run_out = record.log["time"], record.log["run_out"]
    with h5py.File(record.files[0].with_suffix(".h5"), "r") as file:
        strains = [file[f"{k}/Node/plastic_strain"][:].ravel() for k in range(len(record.frames))]
    side = [(t, x[:, ::2], np.minimum(e, 1)) for (t, x, _), e in zip(record.frames, strains, strict=True)]
    label = "plastic strain, 1 or more"
    pictures = [
        snapshot(f"{args.output}.png", record.frames[-1][1], side[-1][2], label=label),
        snapshot_strip(f"{args.output}_side.png", side[len(side) // 3 :: len(side) // 3], label=label),
        snapshot(f"{args.output}_run_out.png", time[:, None], run_out, label="run-out (m), over time (s)"),
    ]
    print("run-out, of the foremost particle beyond the place of the foremost one at the start:")
    for t in np.linspace(0.2, 1, 5) * scene.time:
        print(f"  {t:.2f} s: {np.interp(t, time, run_out):7.3f} m")
    print(f"{np.mean(strains[-1] > 0.2):.1%} of the slope has strained plastically by more than 0.2")
    print_files([*record.files, *pictures])
    return {"run_out": run_out, "strain": strains[-1], "record": record}


if __name__ == "__main__":
    main()
