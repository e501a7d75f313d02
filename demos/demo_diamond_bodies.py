"""Three balls over three jets at Mach 3 and half the pressure of the still air, in 3D (thesis 3.19).

Densities as 1:4:9: the light one is thrown up, the middle one nearly floats, the heavy one sinks."""

import numpy as np

import fempm
from coupling import Coupled, IdealGas, Inflow, Outflow, SlipWall
from coupling.scenes import play
from fempm.cli import print_files, scene_arguments

BALLS = {"light": (-0.65, 1), "middle": (0.0, 4), "heavy": (0.65, 9)}  # x, also of the nozzles, and density
WIDTH, RADIUS, HEIGHT = 0.2, 0.16, 0.42  # of the nozzles, squares in the floor, and of the balls
OPEN = ("left", "right", "top", "back", "front")


def name_floor(mesh):
    """Name the parts of the bottom "nozzles" and "floor"; the mesh has to have lines at their edges."""
    bottom = mesh.facets("bottom")
    x, _, z = mesh.points[bottom].mean(axis=1).T
    inside = np.any([np.maximum(abs(x - a), abs(z)) < WIDTH / 2 for a, _ in BALLS.values()], axis=0)
    mesh.boundaries |= {"nozzles": bottom[inside], "floor": bottom[~inside]}


def main(argv=None):
    options = {"h": (0.05, "mesh size in m, 0.05 over a whole number"), "mach": (3.0, "of the jets")}
    options |= {"density": (6.0, "of the lightest ball, 1 of the air"), "gravity": (0.3, "in m/s2")}
    options |= {"full": (False, "h = 0.00833 m, near that of the thesis")}
    args = scene_arguments(__doc__, argv, until=0.8, every=0.05, threads=False, **options)
    h = 0.05 / 6 if args.full else args.h
    mesh, bodies = fempm.box_mesh([-1.0, 0.0, -0.25], [1.0, 1.0, 0.25], h), []
    name_floor(mesh)
    for name, (place, ratio) in BALLS.items():
        centre = np.array([place, HEIGHT, 0.0])
        x, volume = fempm.fill_box(centre - RADIUS, centre + RADIUS, h / 2)
        inside = np.linalg.norm(x - centre, axis=1) < RADIUS
        rubber = fempm.NeoHookean(args.density * ratio, 1e3, 0.22)
        bodies.append(fempm.Body(x[inside], volume[inside], rubber, name=name))
    walls, gravity = [fempm.Wall("bottom", "contact")], [0.0, -args.gravity, 0.0]
    solid = fempm.Simulation(mesh, bodies, walls, gravity, transfer="flip", cfl=0.5, outlets=OPEN)

    def initial(x):
        """Air at rest under its own weight, as warm everywhere; it has a height of 1 / gravity."""
        return np.exp(-args.gravity * x[:, 1]), 0.0, np.exp(-args.gravity * x[:, 1])

    jet = Inflow("nozzles", mach=args.mach, density=0.5, pressure=0.5)
    ends = [jet, SlipWall("floor"), *(Outflow(name, attenuation=20.0) for name in OPEN)]
    scene = Coupled(solid, IdealGas(1.4), initial, ends)
    record, pictures = play(scene, args, plane=(2, 0.0))
    height = {name: record.log[f"{name}_y"] - record.log[f"{name}_y"][0] for name in BALLS}
    for name, y in height.items():
        print(f"{name}: {y[-1]:+.3f} m up, at most {np.nanmax(y):+.3f} m")
    print(f"free fall would be {-0.5 * args.gravity * scene.time**2:.3f} m")
    print_files([*record.files, *pictures])
    return {"rise": {name: y[-1] for name, y in height.items()}, "record": record}


if __name__ == "__main__":
    main()
