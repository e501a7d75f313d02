"""Wind at Mach 3 past a cylinder clamped between two walls, in 3D (thesis 3.15).

A stiff elastic cylinder bends in the middle and springs back, a stiff plastic one stays bent. Soft ones tear
off at the walls and are carried away, out of the open end."""

import numpy as np

import fempm
from coupling import Coupled, IdealGas, Inflow, Outflow, SlipWall
from coupling.scenes import play
from fempm.cli import print_files, scene_arguments

SIZE, AXIS, RADIUS = np.array([2.0, 0.4, 0.24]), np.array([0.4, 0.2]), 0.06  # box, and cylinder along z
ENDS, SIDES = ("back", "front"), ("bottom", "top")  # walls
LAWS = {
    "stiff_elastic": fempm.NeoHookean(20.0, 1e3, 0.35),
    "soft_elastic": fempm.NeoHookean(20.0, 2e2, 0.35),
    "stiff_plastic": fempm.VonMises(20.0, 1e4, 0.35, 150.0),
    "soft_plastic": fempm.VonMises(20.0, 5e3, 0.35, 75.0),
}


def main(argv=None):
    options = {"h": (0.03, "mesh size in m"), "material": (tuple(LAWS), "of the cylinder")}
    options |= {"pressure": (15.0, "of the wind in Pa"), "full": (False, "h = 0.01 as in the thesis")}
    args = scene_arguments(__doc__, argv, until=0.3, every=0.02, threads=False, **options)
    h = 0.01 if args.full else args.h
    x, volume = fempm.fill_box([*(AXIS - RADIUS), 0], [*(AXIS + RADIUS), SIZE[2]], h / 2)
    inside = np.linalg.norm(x[:, :2] - AXIS, axis=1) < RADIUS
    cylinder = fempm.Body(x[inside], volume[inside], LAWS[args.material], name="cylinder")
    walls = [*(fempm.Wall(n, "sticky") for n in ENDS), *(fempm.Wall(n, "slip") for n in SIDES)]
    mesh, speed = fempm.box_mesh([0, 0, 0], SIZE, h), 3 * np.sqrt(args.pressure)
    solid = fempm.Simulation(mesh, [cylinder], walls, transfer="flip", outlets=["right"])
    wind = Inflow("left", mach=3.0, density=1.4, pressure=args.pressure)

    def initial(x):
        """The wind has not yet reached the cylinder: air at rest there."""
        return 1.4, np.where(x[:, :1] < 0.25, speed, 0) * np.eye(3)[0], args.pressure

    scene = Coupled(solid, IdealGas(1.4), initial, [wind, Outflow("right"), *map(SlipWall, ENDS + SIDES)])

    def watch(s):
        """Columns for the log: how far the middle and the ends of the cylinder are behind its place."""
        p, middle = s.particles, abs(s.particles.position[:, 2] / SIZE[2] - 0.5) < 0.17
        moved = np.stack([p.mass, p.mass * (p.position[:, 0] - AXIS[0])], axis=1)
        sums = s.ranks.sum(np.array([moved[middle].sum(axis=0), moved[~middle].sum(axis=0)]))
        a, b = sums[:, 1] / np.where(sums[:, 0] > 0, sums[:, 0], np.nan)
        return {"middle": a, "ends": b, "remaining": s.solid.num_particles}

    record, pictures = play(scene, args, plane=(1, AXIS[1]), watch=watch)
    log, k = record.log, np.nanargmax(record.log["middle"])
    print(f"its middle moves by {log['middle'][k]:.3f} m until {log['time'][k]:.2f} s, at the end by")
    print(f"{log['middle'][-1]:.3f} m, its ends by {log['ends'][-1]:.3f} m; {log['remaining'][-1]} particles")
    print_files([*record.files, *pictures])
    return {"record": record}


if __name__ == "__main__":
    main()
