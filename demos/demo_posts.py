"""The wind behind a shock at Mach 4 snaps plants near their roots (thesis 3.17).

They stick to the ground and soften as they yield, so that one slice takes most of the strain.
Snapped are those with a slice where the mean plastic strain leaves less than a quarter of the strength."""

import numpy as np

import fempm
from coupling import Coupled, IdealGas, Inflow, Outflow, SlipWall
from coupling.scenes import planar_shock, play, shocked
from fempm.cli import print_files, scene_arguments

SIZE, RADIUS, BROKEN = np.array([0.9, 0.42, 0.36]), 0.036, 0.1  # the box, of the trunks, that plastic strain
PLANTS = ((0.25, 0.09, 0.24), (0.37, 0.27, 0.3), (0.5, 0.12, 0.27))  # x, z and height


def plant(x, z, height, spacing, material):
    """A round trunk, and an arm towards larger z that leaves it at half its height."""
    p, volume = fempm.fill_box([x - RADIUS, 0, z - RADIUS], [x + RADIUS, height, z + 0.09], spacing)
    trunk = np.hypot(p[:, 0] - x, p[:, 2] - z) < RADIUS
    arm = (np.hypot(p[:, 0] - x, p[:, 1] - 0.6 * height) < 0.8 * RADIUS) & (p[:, 2] > z)
    return fempm.Body(p[trunk | arm], volume[trunk | arm], material, name=f"plant {x}")


def main(argv=None):
    options = {"h": (0.03, "mesh size in m"), "mach": (4.0, "of the shock")}
    options |= {"density": (40.0, "of the plants"), "strength": (800.0, "their yield stress in Pa")}
    options |= {"full": (False, "h = 0.003 m, as in the thesis")}
    args = scene_arguments(__doc__, argv, until=0.2, threads=False, **options)
    h = 0.003 if args.full else args.h
    wood = fempm.J2Softening(args.density, 3e4, 0.25, args.strength, args.strength / 10, softening=20.0)
    bodies = [plant(*p, h / 2.5, wood) for p in PLANTS]
    mesh, (density, speed, pressure) = fempm.box_mesh([0, 0, 0], SIZE, h), shocked(args.mach, 1.0, 1.0)
    walls = [fempm.Wall("bottom", "sticky"), *(fempm.Wall(name, "slip") for name in ("top", "back", "front"))]
    solid = fempm.Simulation(mesh, bodies, walls, transfer="flip", outlets=["right"])
    wind = Inflow("left", density, pressure, velocity=[speed, 0, 0])
    ends = [wind, Outflow("right"), *(SlipWall(wall.boundary) for wall in walls)]
    scene = Coupled(solid, IdealGas(1.4), planar_shock(args.mach, 0.1), ends)
    record, pictures = play(scene, args, plane=(2, 0.1))
    number, x, strain = (scene.gather(name) for name in ("id", "position", "state/plastic_strain"))
    start = np.concatenate([body.position for body in bodies])[number]
    owner = np.repeat(np.arange(len(bodies)), [len(body.position) for body in bodies])[number]
    weakest, snapped = [], 0
    for k, (at, _, height) in enumerate(PLANTS):
        mine, level = owner == k, np.round(np.arange(0.5 * h, height, h), 3)
        slices = [mine & (abs(start[:, 1] - y) < h / 2) for y in level]
        mean = np.array([strain[s].mean() if s.any() else 0 for s in slices])
        tip = (x - start)[slices[-1]].mean(axis=0) if slices[-1].any() else np.full(3, np.nan)
        weakest.append(level[mean.argmax()] / height)
        snapped += mean.max() > BROKEN
        print(f"plant at {at}: plastic strain {mean.max():.2f} at {weakest[-1]:.2f} of its height,")
        print(f"  its tip moved by {np.round(tip, 3)} m")
    print(f"{snapped} of {len(bodies)} snapped; {len(x)} of {len(owner)} particles are still there")
    print_files([*record.files, *pictures])
    return {"snapped": snapped, "weakest": weakest, "record": record}


if __name__ == "__main__":
    main()
