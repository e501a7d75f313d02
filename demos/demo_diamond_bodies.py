"""Three balls over three jets at Mach 3 and half the pressure of the still air, in 3D (thesis 3.19).

Their densities are as 1:4:9. The lightest is thrown up, the middle one nearly floats, the heaviest sinks into
its jet and spreads it."""

import numpy as np

import fempm
from coupling import IdealGas, Inflow, Outflow, SlipWall
from coupling.coupled import Coupled
from coupling.scenes import finish, play
from fempm.boxes import box_mesh
from fempm.cli import scene_arguments

PLACES, WIDTH = (-0.65, 0.0, 0.65), 0.2  # of the nozzles, squares in the floor
RADIUS, HEIGHT = 0.16, 0.42
OPEN = ("left", "right", "top", "back", "front")


def in_nozzle(x):
    """Whether points x (3, n) are over a nozzle, with the edge."""
    over = np.any([abs(x[0] - place) < 0.501 * WIDTH for place in PLACES], axis=0)
    return over & (abs(x[2]) < 0.501 * WIDTH)


def name_floor(mesh):
    """Name the parts of the bottom "nozzles" and "floor"; the mesh has to have lines at their edges."""
    bottom = mesh.facets("bottom")
    inside = in_nozzle(mesh.points[bottom].mean(axis=1).T)
    mesh.boundaries |= {"nozzles": bottom[inside], "floor": bottom[~inside]}


def main(argv=None):
    options = {
        "h": (0.05, "mesh size in m, 0.05 over a whole number"),
        "mach": (3.0, "Mach number of the jets"),
        "density": (6.0, "of the lightest ball in kg/m3, 1 of the air"),
        "gravity": (0.3, "in m/s2: in it the air has a height of 3.3 m"),
        "full": (False, "near the thesis's resolution, h = 0.00833"),
    }
    args = scene_arguments(__doc__, argv, until=0.8, every=0.05, threads=False, **options)
    h = 0.05 / 6 if args.full else args.h
    mesh = box_mesh([-1.0, 0.0, -0.25], [1.0, 1.0, 0.25], h)
    name_floor(mesh)
    bodies = []
    for place, name, ratio in zip(PLACES, ("light", "middle", "heavy"), (1, 4, 9), strict=True):
        centre = np.array([place, HEIGHT, 0.0])
        position, volume = fempm.fill_box(centre - RADIUS, centre + RADIUS, h / 2)
        chosen = np.linalg.norm(position - centre, axis=1) < RADIUS
        material = fempm.NeoHookean(args.density * ratio, 1e3, 0.22)
        bodies.append(fempm.Body(position[chosen], volume[chosen], material, name=name))
    gravity = [0.0, -args.gravity, 0.0]
    walls = [fempm.Wall("bottom", "contact")]
    solid = fempm.Simulation(mesh, bodies, walls, gravity, transfer="flip", cfl=0.5, outlets=list(OPEN))

    def initial(x):
        """Air at rest under its own weight, as warm everywhere."""
        share = np.exp(-args.gravity * x[:, 1])
        return share, 0.0, share

    jet = Inflow("nozzles", mach=args.mach, density=0.5, pressure=0.5)
    ends = [jet, SlipWall("floor"), *(Outflow(name, attenuation=20.0) for name in OPEN)]
    scene = Coupled(solid, IdealGas(1.4), initial, ends)
    record, pictures = play(scene, args, plane=(2, 0.0))
    log, rise = record.log, {}
    for body in bodies:
        y = log[f"{body.name}_y"]
        rise[body.name] = y[-1] - y[0]
        print(f"{body.name}: {rise[body.name]:+.3f} m up, at most {np.nanmax(y) - y[0]:+.3f} m")
    print(f"free fall would be {-0.5 * args.gravity * scene.time**2:.3f} m")
    finish(record, pictures)
    return {"rise": rise, "record": record}


if __name__ == "__main__":
    main()
