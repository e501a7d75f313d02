"""Wind at Mach 3 past a cylinder clamped between two walls, in 3D (thesis 3.15).

A stiff elastic cylinder bends in the middle and springs back, a stiff plastic one stays bent. Soft ones tear
off at the walls and are carried away, out of the open end."""

import numpy as np

import fempm
from coupling import IdealGas, Inflow, Outflow, SlipWall
from coupling.coupled import Coupled
from coupling.scenes import finish, play
from fempm.boxes import box_mesh
from fempm.cli import scene_arguments

AXIS, RADIUS = np.array([0.4, 0.2]), 0.06  # of the cylinder along z
LAWS = {
    "stiff_elastic": fempm.NeoHookean(20.0, 1e3, 0.35),
    "soft_elastic": fempm.NeoHookean(20.0, 2e2, 0.35),
    "stiff_plastic": fempm.VonMises(20.0, 1e4, 0.35, 150.0),
    "soft_plastic": fempm.VonMises(20.0, 5e3, 0.35, 75.0),
}


def main(argv=None):
    options = {
        "h": (0.03, "mesh size in m"),
        "material": (tuple(LAWS), "of the cylinder"),
        "pressure": (15.0, "of the wind in Pa"),
        "full": (False, "the thesis's resolution, h = 0.01"),
    }
    args = scene_arguments(__doc__, argv, until=0.3, every=0.02, threads=False, **options)
    h = 0.01 if args.full else args.h
    length, height, width = 2.0, 0.4, 0.24
    mesh = box_mesh(np.zeros(3), [length, height, width], h)
    box = [*(AXIS - RADIUS), 0], [*(AXIS + RADIUS), width]
    position, volume = fempm.fill_box(*box, h / 2)
    chosen = np.linalg.norm(position[:, :2] - AXIS, axis=1) < RADIUS
    cylinder = fempm.Body(position[chosen], volume[chosen], LAWS[args.material], name="cylinder")
    walls = [fempm.Wall(name, "sticky") for name in ("back", "front")]
    walls += [fempm.Wall(name, "slip") for name in ("bottom", "top")]
    solid = fempm.Simulation(mesh, [cylinder], walls, transfer="flip", outlets=["right"])
    wind = {"density": 1.4, "pressure": args.pressure}
    speed = 3 * np.sqrt(args.pressure)
    ends = [Inflow("left", mach=3.0, **wind), Outflow("right")]
    ends += [SlipWall(name) for name in ("bottom", "top", "back", "front")]

    def initial(x):
        """The wind has not yet reached the cylinder: air at rest there."""
        return 1.4, np.where(x[:, :1] < 0.25, speed, 0) * np.eye(3)[0], args.pressure

    scene = Coupled(solid, IdealGas(1.4), initial, ends)

    def watch(s):
        """Columns for the log: how far the middle and the ends of the cylinder are behind its place."""
        p = s.particles
        middle = abs(p.position[:, 2] - 0.5 * width) < 0.17 * width
        moved = np.stack([p.mass, p.mass * (p.position[:, 0] - AXIS[0])], axis=1)
        sums = [moved[middle].sum(axis=0), moved[~middle].sum(axis=0)]
        sums = s.ranks.sum(np.array(sums))
        with np.errstate(invalid="ignore"):
            a, b = sums[:, 1] / sums[:, 0]
        return {"middle": a, "ends": b, "remaining": s.solid.num_particles}

    record, pictures = play(scene, args, plane=(1, AXIS[1]), watch=watch)
    log = record.log
    k = np.nanargmax(log["middle"])
    print(f"its middle moves by {log['middle'][k]:.3f} m until {log['time'][k]:.2f} s,")
    print(f"at the end by {log['middle'][-1]:.3f} m, its ends by {log['ends'][-1]:.3f} m;")
    print(f"{log['remaining'][-1]:.0f} particles are still there")
    finish(record, pictures)
    return {"record": record}


if __name__ == "__main__":
    main()
