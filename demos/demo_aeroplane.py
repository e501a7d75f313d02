"""An aeroplane from a surface mesh in a wind tunnel: a shock at Mach 6, and the wind after it (thesis 3.16).

meshes/aeroplane.geo fills the closed surface of an STL file, put your own in its place. The metal softens
as it yields and has no strength beyond a strain of 0.2: seen from above, the wind sweeps the plane along and
folds its wings back by 0.13 m, with half of the metal at their roots broken."""

from pathlib import Path

import numpy as np

import fempm
from coupling import Coupled, IdealGas, Inflow, Outflow, SlipWall
from coupling.scenes import planar_shock, play, shocked
from fempm.cli import print_files, scene_arguments

MESHES = Path(__file__).parent.parent / "meshes"
SIZE, NOSE = np.array([1.28, 0.4, 0.72]), np.array([0.2, 0.2, 0.36])
THICK = 1.4  # by which it is thicker than the surface, for wings of two cells
SIDES = ("bottom", "top", "back", "front")


def main(argv=None):
    options = {"h": (0.0267, "mesh size in m"), "body_h": (0.03, "that of the aeroplane, a particle a cell")}
    options |= {"mach": (6.0, "of the shock"), "pitch": (10.0, "of the aeroplane in degrees")}
    options |= {"density": (6.0, "of the aeroplane"), "strength": (120.0, "its yield stress in Pa")}
    options |= {"full": (False, "h = 0.004 m, as in the thesis")}
    args = scene_arguments(__doc__, argv, until=0.16, threads=False, **options)
    h, body_h = (0.004, 0.008) if args.full else (args.h, args.body_h)
    x, volume = fempm.fill_cells(fempm.read_mesh(MESHES / "aeroplane.geo", h=body_h), 1)
    x[:, 1], volume = THICK * x[:, 1], THICK * volume
    c, s = np.cos(np.radians(args.pitch)), np.sin(np.radians(args.pitch))
    start = x @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]) + NOSE
    metal = fempm.VonMises(args.density, 2e3, 0.25, args.strength, hardening=-5 * args.strength)
    mesh, (density, speed, pressure) = fempm.box_mesh([0, 0, 0], SIZE, h), shocked(args.mach, 1.0, 1.0)
    walls = [fempm.Wall(name, "slip") for name in SIDES]
    plane = fempm.Body(start, volume, metal, name="aeroplane")
    solid = fempm.Simulation(mesh, [plane], walls, transfer="flip", outlets=["right"])
    wind = Inflow("left", density, pressure, velocity=[speed, 0, 0])
    ends = [wind, Outflow("right"), *map(SlipWall, SIDES)]
    scene = Coupled(solid, IdealGas(1.4), planar_shock(args.mach, 0.12), ends)
    record, pictures = play(scene, args, plane=(1, 0.18))
    number, now, strain = (scene.gather(name) for name in ("id", "position", "state/plastic_strain"))
    x, move, broken = x[number], now - start[number], strain > 0.2  # where nothing is left of the strength
    parts = {"fuselage": np.hypot(x[:, 1], x[:, 2]) < 0.05, "fin": x[:, 1] > 0.1 * THICK}
    for side, z in (("left", -x[:, 2]), ("right", x[:, 2])):
        parts |= {f"{side} root": (abs(z - 0.07) < 0.03) & (x[:, 0] < 0.4), f"{side} tip": z > 0.25}
    for name, mine in parts.items():
        print(f"{name}: moved by {np.round(move[mine].mean(axis=0), 3)} m, {broken[mine].mean():.0%} broken")
    for name in ("left tip", "right tip"):
        by = move[parts[name]].mean(axis=0) - move[parts["fuselage"]].mean(axis=0)
        print(f"{name} against the fuselage: {np.round(by, 3)} m")
    print(f"plastic strain: at most {strain.max():.2f}, mean {strain.mean():.3f}")
    print(f"{len(x)} of {len(start)} particles are in the tunnel, of {len(volume)}")
    print_files([*record.files, *pictures])
    return {"parts": {name: move[mine].mean(axis=0) for name, mine in parts.items()}, "record": record}


if __name__ == "__main__":
    main()
