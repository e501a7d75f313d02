"""A shock at Mach 3 runs down a channel and lifts a cylinder that lies on its floor (thesis 3.7).

Gas that is caught under the cylinder pushes harder than that above: it rises, and comes near the upper wall
by the end of the channel (Forrer and Berger 1999)."""

import numpy as np

import fempm
from coupling import Coupled, IdealGas, Inflow, Outflow, SlipWall
from coupling.scenes import centres, planar_shock, play, shocked
from fempm.cli import print_files, scene_arguments

MACH, REST = 3.0, (1.4, 1.0)  # density and pressure of the gas at rest, where sound has speed 1
CENTRE, RADIUS, DENSITY = np.array([0.15, 0.05]), 0.05, 10.77
SIDES, MOMENTS = ("bottom", "top"), (0.15, 0.30)  # walls; when the place of the cylinder is told


def channel(h, young):
    """The scene with squares of width h, cut in two, and four particles in each."""
    mesh = fempm.box_mesh([0, 0], [1, 0.2], h)
    x, volume = fempm.fill_box(CENTRE - RADIUS, CENTRE + RADIUS, h / 2)
    inside = np.linalg.norm(x - CENTRE, axis=1) < RADIUS
    body = fempm.Body(x[inside], volume[inside], fempm.NeoHookean(DENSITY, young, 0.3), name="cylinder")
    walls = [fempm.Wall(name, "contact", reach=h / 5) for name in SIDES]  # less than the gap
    solid = fempm.Simulation(mesh, [body], walls, transfer="flip", outlets=["right"])
    density, speed, pressure = shocked(MACH, *REST)
    ends = [Inflow("left", density, pressure, [speed, 0.0]), Outflow("right"), *map(SlipWall, SIDES)]
    return Coupled(solid, IdealGas(1.4), planar_shock(MACH, 0.08, *REST), ends)


def places(log):
    """(4,) x and y of the cylinder at the first moment, then at the second; NaN after the end of the run."""
    columns = log["cylinder_x"], log["cylinder_y"]
    return np.array([np.interp(t, log["time"], c, right=np.nan) for t in MOMENTS for c in columns])


def main(argv=None):
    options = {
        "h": (0.01, "mesh size in m"),
        "young": (1e4, "Young's modulus of the cylinder in Pa"),
        "refine": (False, "before that, run 2 h and sqrt(2) h, and compare the places of the cylinder"),
        "full": (False, "h = 1/400"),
    }
    args = scene_arguments(__doc__, argv, until=0.35, every=0.0125, threads=False, **options)
    h, rows = 1 / 400 if args.full else args.h, []
    for size in (2 * h, np.sqrt(2) * h) if args.refine else ():
        log = fempm.run(channel(size, args.young), args.until, watch=centres).log
        rows.append([0.2 / size, *places(log)])
    record, pictures = play(channel(h, args.young), args)
    rows.append([0.2 / h, *places(record.log)])
    print(f"cells across the channel; x and y of the cylinder at {MOMENTS[0]} s and at {MOMENTS[1]} s")
    for row, before in zip(rows, [rows[0], *rows]):
        print(f"{row[0]:5.1f}: {np.round(row[1:], 4)}, moved by {np.round(np.subtract(row, before)[1:], 4)}")
    print_files([*record.files, *pictures])
    return {"places": np.array(rows)[:, 1:].reshape(-1, 2, 2), "record": record}


if __name__ == "__main__":
    main()
