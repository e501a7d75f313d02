"""A jet at Mach 3 and half the pressure of the still air enters through an eighth of the floor (thesis 3.18).

Shocks from the lips of the nozzle cross on the axis and return from the jet's edge as rarefactions: diamonds.
Exact: a shock that doubles the pressure at Mach 3 leans by 27.0 degrees (oblique shock relations) and reaches
the axis 0.98 widths of the nozzle above it."""

from pathlib import Path

import numpy as np

import fempm
from coupling import Flow, IdealGas, Inflow, Outflow, SlipWall
from coupling.picture import colour_strip, schlieren_strip, spread
from coupling.probes import probe
from fempm.cli import print_files, run_options, scene_arguments

MESHES = Path(__file__).parent.parent / "meshes"
WIDTH = 0.125  # of the nozzle


def main(argv=None):
    options = {
        "h": (0.008, "mesh size in the jet in m"),
        "mach": (3.0, "Mach number of the jet"),
        "pressure": (0.5, "its pressure over that of the air"),
    }
    args = scene_arguments(__doc__, argv, until=2.0, every=0.1, threads=False, **options)
    mesh = fempm.read_mesh(MESHES / "nozzle_box.geo", h=args.h, D=WIDTH)
    state = {"density": args.pressure, "pressure": args.pressure}  # as warm as the air
    ends = [Inflow("nozzle", mach=args.mach, **state), Outflow("open", attenuation=20.0), SlipWall("floor")]
    gas = Flow(mesh, IdealGas(1.4), lambda x: (1.0, 0.0, 1.0), ends)
    record = fempm.run(gas, **run_options(args))
    # mean of the last third: the edge of the jet waves
    late = record.frames[-max(1, len(record.frames) // 3) :]
    mean = {name: np.mean([f[name] for _, f in late], axis=0) for name in ("pressure", "mach")}
    axis = np.stack([np.zeros(1001), np.linspace(0, 1, 1001)], axis=1)
    pressure, mach = (probe(mesh, axis, mean[name]) for name in ("pressure", "mach"))
    rise = (pressure[:-1] < 1.1) & (pressure[1:] >= 1.1)  # where it passes 1.1 times the pressure of the air
    diamonds = axis[1:, 1][rise]
    crossing = diamonds[0] / WIDTH if len(diamonds) else np.nan
    moments = spread(record.frames, 5)
    pictures = [
        schlieren_strip(f"{args.output}.png", mesh, moments),
        colour_strip(f"{args.output}_density.png", mesh, moments, "density", "density in kg/m³"),
    ]
    print(f"{len(mesh.points)} vertices, {gas.steps} steps, {gas.repeated} repeated in halves")
    print(f"the shocks cross {crossing:.2f} widths above the nozzle (exact for the defaults: 0.98)")
    print(f"diamonds at {np.round(diamonds / WIDTH, 2)} widths; on the axis Mach {mach.min():.2f} to")
    print(f"{mach.max():.2f} and at most {pressure.max():.2f} times the pressure of the air")
    print_files([*record.files, *pictures])
    return {"crossing": crossing, "diamonds": diamonds, "record": record}


if __name__ == "__main__":
    main()
