"""Hot gas in a closed barrel drives a bullet out into still air, perhaps through a silencer (thesis 3.12).

The blast leaves the muzzle first; a light bullet catches up with its front, a heavy one stays behind. The
silencer is a chamber between muzzle and room. Bound for any bullet: all the work of a charge that expands
slowly up to the muzzle, with no air ahead. The other sides of the room are open, to the bullet as well."""

from pathlib import Path

import numpy as np

import fempm
from coupling import Coupled, IdealGas, Outflow, SlipWall
from coupling.probes import probe
from coupling.scenes import burst, centres, play
from fempm.cli import print_files, scene_arguments

MESHES = Path(__file__).parent.parent / "meshes"
BARREL, BORE, CHARGE, LENGTH = 1.0, 0.15, 0.3, 0.2  # of the barrel, its bore, the charge and the bullet
DENSITY = {"light": 20.0, "heavy": 50.0, "silenced": 20.0}  # of the bullets, air has 1


def main(argv=None):
    options = {"h": (0.025, "mesh size in m"), "full": (False, "h = 0.0025 as in the thesis")}
    options |= {"bullet": (tuple(DENSITY), "kind of shot"), "pressure": (40.0, "of the charge, air has 1")}
    options |= {"young": (1e3, "Young's modulus of the bullet in Pa; a stiffer one takes smaller steps")}
    args = scene_arguments(__doc__, argv, until=1.4, every=0.05, threads=False, **options)
    h, silencer = 0.0025 if args.full else args.h, 0.5 * (args.bullet == "silenced")
    mesh = fempm.read_mesh(MESHES / "gun.geo", h=h, B=BARREL, D=BORE, S=silencer, C=0.8)
    radius, base = 0.47 * BORE, CHARGE + LENGTH - 0.47 * BORE  # where its round nose begins
    x, volume = fempm.fill_box([CHARGE, -radius], [base + radius, radius], h / 2)
    inside = np.hypot(np.maximum(x[:, 0] - base, 0), x[:, 1]) < radius
    body = x[inside], volume[inside], fempm.NeoHookean(DENSITY[args.bullet], args.young, 0.25)
    walls = [fempm.Wall("barrel", "slip")]  # not the front: a slip wall holds on to what is around an edge
    bodies = [fempm.Body(*body, name="bullet")]
    solid = fempm.Simulation(mesh, bodies, walls, transfer="flip", outlets=["open"])
    mass = DENSITY[args.bullet] * volume[inside].sum()
    initial = burst(np.zeros(2), np.array([CHARGE, np.inf]), 4.0, args.pressure)  # at the closed end
    scene = Coupled(solid, IdealGas(1.4), initial, [SlipWall("barrel"), SlipWall("front"), Outflow("open")])
    ear = [[mesh.points[mesh.facets("front"), 0].max() + 0.3, 0.3]]

    def watch(scene):
        return centres(scene) | {"ear": probe(mesh, ear, scene.vertex_fields()["pressure"])[0]}

    record, pictures = play(scene, args, watch=watch)
    log, sound = record.log, np.sqrt(1.4)
    speed, out = log["solid_momentum_x"] / mass, np.flatnonzero(log["bullet_x"] > BARREL)
    work = args.pressure * CHARGE * BORE / 0.4 * (1 - (CHARGE / BARREL) ** 0.4)
    for when, k in [("at the muzzle", k) for k in out[:1]] + [("at the end", -1)]:
        print(f"{when}, {log['time'][k]:.3f} s: {speed[k]:.3f} m/s, Mach {speed[k] / sound:.2f} in still air")
    print(
        f"bound {np.sqrt(2 * work / mass):.2f} m/s; blast beside the way out {log['ear'].max():.2f} times air"
    )
    print_files([*record.files, *pictures])
    return {"speed": speed, "record": record}


if __name__ == "__main__":
    main()
