"""A wind tunnel at Mach 3 with a step in its floor (Woodward and Colella 1984, thesis figure 3.6).

A bow shock stands off the step and meets the ceiling in a Mach stem. Exact, once it stands still: the gas
along the floor is stopped at the foot of the step, behind a normal shock, by 12.06 times its pressure."""

from pathlib import Path

import numpy as np

import fempm
from coupling import Flow, IdealGas, Inflow, Outflow, SlipWall
from coupling.picture import schlieren_strip, spread
from coupling.probes import probe, stopped_pressure
from fempm.cli import print_files, run_options, scene_arguments

MESHES = Path(__file__).parent.parent / "meshes"


def shock_places(mesh, pressure, heights):
    """Where the pressure first passes 3 along lines x at given heights, from the left."""
    x = np.linspace(0, 3, 3001)
    lines = probe(mesh, np.stack(np.broadcast_arrays(x, heights[:, None]), axis=-1), pressure)
    return x[np.argmax(lines.reshape(len(heights), -1) > 3, axis=1)]


def main(argv=None):
    options = {"h": (0.015, "mesh size in m"), "cfl": (0.5, "Courant number of |u| and grad p")}
    args = scene_arguments(__doc__, argv, until=4.0, every=0.5, threads=False, **options)
    mesh = fempm.read_mesh(MESHES / "step.geo", h=args.h)
    wind = Inflow("left", density=1.4, velocity=[3.0, 0.0], pressure=1.0)
    ends = [wind, Outflow("right"), SlipWall("bottom"), SlipWall("top")]
    gas = Flow(mesh, IdealGas(1.4), lambda x: (1.4, [3.0, 0.0], 1.0), ends, cfl=args.cfl)
    record = fempm.run(gas, **run_options(args))
    pressure = record.frames[-1][1]["pressure"]
    heights = np.linspace(0.01, 0.99, 99)
    place = shock_places(mesh, pressure, heights)
    stand_off = 0.6 - place[0]
    # the stem is as good as upright: the shock below it leans by more than half
    upright = np.abs(np.gradient(place, heights)) < 0.5
    stem = 1 - heights[np.flatnonzero(~upright)[-1]] if not upright.all() else 1.0
    foot = [probe(mesh, [[0.6 - 1e-9, 0.0]], f["pressure"])[0] for t, f in record.frames if 2 * t >= gas.time]
    foot, exact = np.mean(foot), stopped_pressure(3.0)
    picture = schlieren_strip(f"{args.output}.png", mesh, spread(record.frames, 4))
    print(f"{len(mesh.points)} vertices, {gas.steps} steps, {gas.repeated} repeated in halves")
    print(f"the bow shock stands {stand_off:.3f} m off the step; mean pressure at the foot")
    print(f"over the second half {foot:.2f} (exact: {exact:.2f})")
    print(f"Mach stem at the ceiling: x = {place[-1]:.3f} m, {stem:.2f} m high")
    print_files([*record.files, picture])
    return {"stand_off": stand_off, "foot": foot / exact, "stem": stem, "record": record}


if __name__ == "__main__":
    main()
