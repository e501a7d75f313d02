"""A blast wave at Mach 9 breaks balls of rubble into clouds of pieces, as a supernova planets (thesis 3.14).

The box is closed: mass stays to round-off. The rubble has hardly any cohesion and opens in tension, the
wind strews it. A piece is a group of particles within 1.5 of their first distance from one another."""

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

import fempm
from coupling import Coupled, IdealGas, SlipWall
from coupling.scenes import centres, planar_shock, play
from fempm.cli import print_files, scene_arguments

SIZE, FRONT = np.array([2.6, 0.48, 0.48]), 1.0  # the box, and how far the shock has come at the start
PLANETS = ((1.15, 0.24, 0.24, 0.1), (1.42, 0.12, 0.34, 0.06), (1.5, 0.36, 0.12, 0.05))  # centres and radii
SIDES = ("left", "right", "bottom", "top", "back", "front")


def planet(x, y, z, radius, spacing, material):
    """A ball of particles on a lattice."""
    centre = np.array([x, y, z])
    x, volume = fempm.fill_box(centre - radius, centre + radius, spacing)
    inside = np.linalg.norm(x - centre, axis=1) < radius
    return fempm.Body(x[inside], volume[inside], material, name=f"planet {radius}")


def pieces(scene, reach):
    """Column of the log: groups of particles that are nearer than `reach` to one of their own. Collective."""
    x = scene.gather("position")
    i, j = cKDTree(x).query_pairs(reach, output_type="ndarray").T
    number, label = connected_components(coo_matrix((np.ones(len(i)), (i, j)), shape=(len(x), len(x))))
    return {"pieces": number, "fragments": np.sum(np.bincount(label) >= 8)}


def main(argv=None):
    options = {"h": (0.04, "mesh size in m"), "mach": (9.0, "of the shock")}
    options |= {"density": (15.0, "of the planets"), "cohesion": (0.1, "of their rubble in Pa")}
    options |= {"full": (False, "h = 0.006 m, as in the thesis")}
    args = scene_arguments(__doc__, argv, until=0.22, threads=False, **options)
    h = 0.006 if args.full else args.h
    rubble = fempm.DruckerPrager(args.density, 1e4, 0.25, friction_angle=30.0, cohesion=args.cohesion)
    bodies = [planet(*p, h / 2, rubble) for p in PLANETS]  # eight particles in a cube of the mesh
    mesh, walls = fempm.box_mesh([0, 0, 0], SIZE, h), [fempm.Wall(name, "slip") for name in SIDES]
    solid = fempm.Simulation(mesh, bodies, walls, transfer="flip")
    scene = Coupled(solid, IdealGas(1.4), planar_shock(args.mach, FRONT), [SlipWall(name) for name in SIDES])
    record, pictures = play(scene, args, plane=(2, 0.2), watch=lambda s: centres(s) | pieces(s, 0.75 * h))
    log = record.log
    drift = {name: np.ptp(log[name]) / log[name][0] for name in ("mass", "energy")}
    print(f"mass off by {drift['mass']:.1e}, energy by {drift['energy']:.1e} of their start")
    print(f"{len(bodies)} planets, {log['pieces'][-1]} pieces, {log['fragments'][-1]} of 8 particles or more")
    print("energy of the solids:", {k: f"{log[k][-1]:.3g} J" for k in ("kinetic", "elastic", "dissipated")})
    print_files([*record.files, *pictures])
    return {"drift": drift, "pieces": log["pieces"], "record": record}


if __name__ == "__main__":
    main()
