"""An explosion between three bodies on a floor, in 3D: heavy rubber, light rubber and iron (thesis 3.9).

The light body is thrown up and away, the heavy one is pushed and springs back, the iron one hardly
moves and keeps its dents. These need a yield stress of 100 Pa: the thesis's 600 Pa are not reached here."""

import numpy as np

import fempm
from coupling import Coupled, IdealGas, Outflow, SlipWall
from coupling.scenes import burst, play
from fempm.cli import print_files, scene_arguments

LAWS = {"heavy": fempm.NeoHookean(80.0, 1600.0, 0.22), "light": fempm.NeoHookean(10.0, 200.0, 0.22)}
PLACES = {"heavy": (0, 0.02, 0.36), "light": (-0.42, 0.02, 0), "iron": (0.3, 0.02, 0)}
GRAVITY = 0.3  # in the units of a gas at density 1 and pressure 1: it has a height of 3.3 m
SIDES = ("left", "right", "top", "back", "front")


def statue(x, foot, size):
    """A body with a head on a trunk, in place of the thesis's bunny."""
    y = (x - foot) / size
    trunk = np.sum(((y - [0, 0.5, 0]) / [0.42, 0.5, 0.42]) ** 2, axis=1) < 1
    head = np.sum((y - [0, 1.15, 0]) ** 2, axis=1) < 0.33**2
    return (trunk | head) & (y[:, 1] > 0.06)


def main(argv=None):
    options = {"h": (1 / 20, "mesh size in m"), "full": (False, "the thesis's resolution, h = 1 / 64")}
    options |= {"pressure": (4000.0, "of the explosion in Pa, 1 outside")}
    options |= {"yield_stress": (100.0, "of the iron in Pa")}
    args = scene_arguments(__doc__, argv, until=0.16, every=0.02, threads=False, **options)
    h = 1 / 64 if args.full else args.h
    mesh = fempm.box_mesh([-1.0, 0.0, -0.6], [1.0, 1.0, 0.6], h)
    laws, bodies = LAWS | {"iron": fempm.VonMises(200.0, 2e4, 0.22, args.yield_stress)}, []
    for name, material in laws.items():
        foot = np.array(PLACES[name])
        x, volume = fempm.fill_box(foot - [0.2, 0, 0.2], foot + [0.2, 0.5, 0.2], h / 2)
        inside = statue(x, foot, 0.28)
        bodies.append(fempm.Body(x[inside], volume[inside], material, name=name))
    ground, gravity = fempm.Wall("bottom", "contact", friction=0.3), [0.0, -GRAVITY, 0.0]
    solid = fempm.Simulation(mesh, bodies, [ground], gravity, transfer="flip", outlets=SIDES)
    state = burst(np.array([0, 0.12, 0]), 0.14, 40.0, args.pressure)
    scene = Coupled(solid, IdealGas(1.4), state, [SlipWall("bottom"), *map(Outflow, SIDES)])
    record, pictures = play(scene, args, plane=(2, 0.0))
    log = record.log
    for name in laws:
        path = np.stack([log[f"{name}_{a}"] for a in "xyz"], axis=1)
        up = path[:, 1].max() - path[0, 1]
        print(f"{name}: moved by {np.round(path[-1] - path[0], 3)} m, {up:.3f} m up")
    print(f"{log['dissipated'][-1]:.2e} J lost in plastic strain of the iron")
    print_files([*record.files, *pictures])
    return {"record": record}


if __name__ == "__main__":
    main()
