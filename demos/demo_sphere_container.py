"""A compressed elastic body is released inside a sphere and expands against its wall (thesis 2.3.5)."""

from pathlib import Path

import numpy as np

import fempm
from fempm.cli import print_files, run_options, scene_arguments
from fempm.picture import snapshot_strip

MESHES = Path(__file__).parent.parent / "meshes"


def main(argv=None):
    args = scene_arguments(
        __doc__,
        argv,
        until=0.02,
        h=(0.07, "mesh size of the sphere in m (thesis: 0.025)"),
        body_h=(0.05, "mesh size of the body in m"),
        wall=(("slip", "sticky"), "what the body does at the wall"),
        cfl=(0.3, "time step over cell size / (wave speed + particle speed)"),
    )
    mesh = fempm.read_mesh(MESHES / "sphere.geo", h=args.h)
    shape = fempm.read_mesh(MESHES / "metatron.geo", h=args.body_h, R=0.42)
    rubber = fempm.NeoHookean(density=1000.0, young=3.3e6, poisson=0.49)
    body = fempm.Body(*fempm.fill_cells(shape, 8), rubber, deformation_gradient=0.75 * np.eye(3))
    scene = fempm.Simulation(
        mesh, [body], [fempm.Wall("wall", args.wall)], transfer="flip", cfl=args.cfl, threads=args.threads
    )
    print(scene.report())
    record = fempm.run(scene, **run_options(args))
    moments = [(t, x, np.linalg.norm(v, axis=1)) for t, x, v in record.frames[:: len(record.frames) // 4]]
    picture = snapshot_strip(f"{args.output}.png", moments, label="speed (m/s)")
    x, mass = scene.gather("position"), scene.gather("mass")
    reach = np.linalg.norm(x, axis=1).max()
    total = record.log["total"] / record.log["total"][0]
    centre = np.linalg.norm(mass @ x) / mass.sum()
    print(f"{scene.steps} steps; centre of mass off by {centre / 0.5:.1e} of the radius (exact: 0),")
    print(f"energy falls to {total[-1]:.3f} of its start (FLIP damps short waves, see README)")
    hits = scene.ranks.sum(scene.wall_hits)
    print(f"largest radius {reach:.4f} m of 0.5 m; particles put back on the wall: {hits}")
    print_files([*record.files, picture])
    return {"energy": total, "centre": centre, "reach": reach, "record": record}


if __name__ == "__main__":
    main()
