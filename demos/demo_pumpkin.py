"""A hollow pumpkin, full of gas under high pressure, is blown up in a closed box, in 3D (thesis 3.13).

An elastic shell stores the work of the gas and swings back, a plastic one loses it in plastic strain and
flies on, stretched and thin. Pieces part late: bodies tear where particles are some cells apart."""

import numpy as np

import fempm
from coupling import Coupled, IdealGas, SlipWall
from coupling.scenes import centres, play
from fempm.cli import print_files, scene_arguments

SIDES = ("left", "right", "bottom", "top", "back", "front")
CENTRE, INNER, THIN = np.full(3, 0.6), np.array([0.16, 0.13, 0.16]), 1.7  # of the gas, shell between ribs
LAWS = {"elastic": fempm.NeoHookean(50.0, 1.5e3, 0.25), "plastic": fempm.VonMises(50.0, 2e4, 0.25, 600.0)}


def in_shell(x):
    """Between the gas and an outer surface with eight ribs around the y axis."""
    y, radius = x - CENTRE, np.linalg.norm((x - CENTRE) / INNER, axis=1)
    return (radius > 1) & (radius < THIN + 0.15 * abs(np.cos(4 * np.arctan2(y[:, 2], y[:, 0]))))


def watch(scene):
    """Columns for the log: mean distance from the centre and speed away from it."""
    p = scene.particles
    y, r = p.position - CENTRE, np.linalg.norm(p.position - CENTRE, axis=1)
    sums = scene.ranks.sum(p.mass @ np.stack([r, np.sum(y * p.velocity, axis=1) / r, 0 * r + 1], axis=1))
    return centres(scene) | {"distance": sums[0] / sums[2], "outward": sums[1] / sums[2]}


def main(argv=None):
    options = {"h": (1 / 20, "mesh size in m"), "full": (False, "128 cells a side as in the thesis")}
    options |= {"material": (tuple(LAWS), "of the shell"), "pressure": (12000.0, "in it in Pa, 50 outside")}
    args = scene_arguments(__doc__, argv, until=0.06, every=0.005, threads=False, **options)
    h = 1.2 / 128 if args.full else args.h
    x, volume = fempm.fill_box(CENTRE - 0.4, CENTRE + 0.4, h / 2)
    shell = fempm.Body(x[in_shell(x)], volume[in_shell(x)], LAWS[args.material], name="shell")
    mesh, walls = fempm.box_mesh([0, 0, 0], 2 * CENTRE, h), [fempm.Wall(name, "slip") for name in SIDES]
    solid = fempm.Simulation(mesh, [shell], walls, transfer="apic")

    def initial(x):
        """From the gas to the air, linear across the shell."""
        share = np.clip((THIN - np.linalg.norm((x - CENTRE) / INNER, axis=1)) / (THIN - 1), 0, 1)
        return 1 + 49 * share, 0.0, 50 + (args.pressure - 50) * share

    scene = Coupled(solid, IdealGas(1.4), initial, [*map(SlipWall, SIDES)])
    record, pictures = play(scene, args, plane=(1, CENTRE[1]), watch=watch)
    log, drift = record.log, np.ptp(record.log["mass"]) / record.log["mass"][0]
    top, end, lost = log["elastic"].max(), log["elastic"][-1], log.get("dissipated", [0.0])[-1]
    print(f"the shell moves outward at {log['outward'].max():.1f} m/s, to {log['distance'].max():.2f} m")
    print(f"elastic energy at most {top:.1f} J, {end:.1f} J at the end; {lost:.1f} J lost in plastic strain")
    print(f"mass off by {drift:.1e} of its start")
    print_files([*record.files, *pictures])
    return {"mass": drift, "record": record}


if __name__ == "__main__":
    main()
