"""A hollow pumpkin, full of gas under high pressure, is blown up in a closed box, in 3D (thesis 3.13).

An elastic shell stores the work of the gas and swings back, a plastic one loses it in plastic strain, flies
on and stays stretched and thin. A shell below two cells, or one with gaps between its particles, would let
the gas through. On the default mesh pieces part late: bodies tear where particles are some cells apart."""

import numpy as np

import fempm
from coupling import IdealGas, SlipWall
from coupling.coupled import Coupled
from coupling.scenes import centres, finish, play
from fempm.boxes import SIDES, box_mesh
from fempm.cli import scene_arguments

CENTRE, INNER = np.full(3, 0.6), np.array([0.16, 0.13, 0.16])  # of the ellipsoid of gas
THIN = 1.7  # outer radius over the inner one between the ribs
LAWS = {"elastic": fempm.NeoHookean(50.0, 1.5e3, 0.25), "plastic": fempm.VonMises(50.0, 2e4, 0.25, 600.0)}


def in_shell(x):
    """Between the gas and an outer surface with eight ribs around the y axis."""
    y = x - CENTRE
    rib = abs(np.cos(4 * np.arctan2(y[:, 2], y[:, 0])))
    radius = np.linalg.norm(y / INNER, axis=1)
    return (radius > 1) & (radius < THIN + 0.15 * rib)


def watch(scene):
    """Columns for the log: mean distance from the centre and speed away from it."""
    p = scene.particles
    y = p.position - CENTRE
    r = np.linalg.norm(y, axis=1)
    sums = p.mass @ np.stack([np.ones(len(r)), r, np.sum(y * p.velocity, axis=1) / np.maximum(r, 1e-9)], 1)
    mass, distance, speed = scene.ranks.sum(sums)
    return centres(scene) | {"distance": distance / mass, "outward": speed / mass}


def main(argv=None):
    options = {
        "h": (1 / 20, "mesh size in m"),
        "material": (tuple(LAWS), "of the shell"),
        "pressure": (12000.0, "of the gas inside in Pa, 50 outside"),
        "full": (False, "the thesis's resolution, 128 cells a side"),
    }
    args = scene_arguments(__doc__, argv, until=0.06, every=0.005, threads=False, **options)
    h = 1.2 / 128 if args.full else args.h
    mesh = box_mesh(np.zeros(3), 2 * CENTRE, h)
    position, volume = fempm.fill_box(CENTRE - 0.4, CENTRE + 0.4, h / 2)
    chosen = in_shell(position)
    shell = fempm.Body(position[chosen], volume[chosen], LAWS[args.material], name="shell")
    names = [name for side in SIDES for name in side]
    solid = fempm.Simulation(mesh, [shell], [fempm.Wall(name, "slip") for name in names], transfer="apic")

    def initial(x):
        """From the gas to the air, linear across the shell."""
        level = np.linalg.norm((x - CENTRE) / INNER, axis=1)
        inner = np.clip((THIN - level) / (THIN - 1), 0, 1)
        return 1 + 49 * inner, 0.0, 50 + (args.pressure - 50) * inner

    scene = Coupled(solid, IdealGas(1.4), initial, [SlipWall(name) for name in names])
    record, pictures = play(scene, args, plane=(1, CENTRE[1]), watch=watch)
    log = record.log
    elastic, k = log["elastic"], np.argmax(log["elastic"])
    print(f"the shell moves outward at {log['outward'].max():.1f} m/s, to {log['distance'].max():.2f} m")
    print(f"elastic energy {elastic[k]:.1f} J at {log['time'][k]:.3f} s, {elastic[-1]:.1f} J at the end")
    if "dissipated" in log:
        print(f"{log['dissipated'][-1]:.1f} J lost in plastic strain")
    print(f"mass off by {np.ptp(log['mass']) / log['mass'][0]:.1e} of its start")
    finish(record, pictures)
    return {"record": record}


if __name__ == "__main__":
    main()
