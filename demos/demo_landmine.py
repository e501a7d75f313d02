"""A charge in the ground goes off under the rear axle of a truck (thesis 3.8).

The rear and its wheels, soft and elastic, are thrown up by 0.4 of the truck's length, the front follows
slowly. The chassis yields: it stays bent, with plastic strains of a third above the charge."""

import numpy as np

import fempm
from coupling import Coupled, IdealGas, Outflow, SlipWall
from coupling.scenes import burst, play
from fempm.cli import print_files, scene_arguments

SIZE, GRAVITY, REAR, FRONT = np.array([1.2, 0.6, 0.6]), 0.5, 0.35, 0.75  # the axles' x
WHEEL, BALL = 0.075, 0.07  # radii
PARTS = ((0.25, 0.85, 0.13, 0.23), (0.65, 0.85, 0.23, 0.35))  # x and y of chassis and cab
OPEN = ("left", "right", "top", "back", "front")


def truck(spacing, body, rubber):
    """Its bodies, from a lattice: chassis with cab, and wheels beside it."""
    x, volume = fempm.fill_box([0.25, 0.02, 0.12], [0.85, 0.36, 0.48], spacing)
    a, b, c = x.T
    inner = abs(c - 0.3) < 0.14
    metal = inner & np.any([(a > p) & (a < q) & (b > r) & (b < s) for p, q, r, s in PARTS], axis=0)
    bodies = [fempm.Body(x[metal], volume[metal], body, name="truck")]
    for axle, name in ((REAR, "rear"), (FRONT, "front")):
        wheels = ~metal & (np.hypot(a - axle, b - 0.02 - WHEEL) < WHEEL) & (abs(c - 0.3) > 0.1)
        bodies.append(fempm.Body(x[wheels], volume[wheels], rubber, name=f"{name} wheels"))
    return bodies


def main(argv=None):
    options = {"h": (0.04, "mesh size in m"), "charge": (4000.0, "pressure of the charge in Pa")}
    options |= {"full": (False, "h = 0.005 m, near that of the thesis")}
    args = scene_arguments(__doc__, argv, until=0.2, threads=False, **options)
    h = 0.005 if args.full else args.h
    metal = fempm.VonMises(12.0, 2e4, 0.22, yield_stress=150.0)
    bodies = truck(h / 2, metal, fempm.NeoHookean(6.0, 1.5e3, 0.22))
    ground, gravity = fempm.Wall("bottom", "contact", friction=0.5), [0, -GRAVITY, 0]
    mesh = fempm.box_mesh([0, 0, 0], SIZE, h)
    solid = fempm.Simulation(mesh, bodies, [ground], gravity, transfer="flip", outlets=OPEN)
    charge = burst([REAR, 0, 0.3], BALL, 20.0, args.charge)
    scene = Coupled(solid, IdealGas(1.4), charge, [SlipWall("bottom"), *map(Outflow, OPEN)])
    record, pictures = play(scene, args, plane=(2, 0.18))
    first = np.concatenate([body.position for body in bodies])
    number, now, strain = (scene.gather(name) for name in ("id", "position", "state/plastic_strain"))
    truck_is, move, x = number < len(bodies[0].position), now - first[number], first[number, 0]
    parts = {"truck": truck_is, "rear end": truck_is & (x < REAR), "front end": truck_is & (x > FRONT)}
    parts |= {"rear wheels": ~truck_is & (x < 0.5), "front wheels": ~truck_is & (x > 0.5)}
    moved = {name: move[mine].mean(axis=0) for name, mine in parts.items()}
    for name, by in moved.items():
        print(f"{name}: moved by {np.round(by, 3)} m")
    print(f"plastic strain of the truck: at most {strain.max():.2f}, mean {strain[truck_is].mean():.3f}")
    print_files([*record.files, *pictures])
    return {"moved": moved, "plastic_strain": strain.max(), "record": record}


if __name__ == "__main__":
    main()
