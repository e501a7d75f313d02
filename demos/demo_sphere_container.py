"""A compressed elastic body is released in a sphere, hits its wall with friction (thesis 2.3.5)."""

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
        until=0.008,
        h=(0.08, "mesh size of the sphere in m"),
        body_h=(0.045, "mesh size of the body in m, 8 particles in each of its cells"),
        full=(False, "as fine as in the thesis, h = 0.025 m and 2.4 million particles: hours, 2 GB"),
        wall=(("contact", "slip", "sticky"), "what the body does at the wall"),
        cfl=(0.3, "time step over cell size / (wave speed + particle speed)"),
    )
    h, body_h = (0.025, 0.0075) if args.full else (args.h, args.body_h)
    mesh = fempm.read_mesh(MESHES / "sphere.geo", h=h)
    shape = fempm.read_mesh(MESHES / "metatron.geo", h=body_h, R=0.42)
    rubber = fempm.NeoHookean(density=1000.0, young=3.3e6, poisson=0.49)
    body = fempm.Body(*fempm.fill_cells(shape, 8), rubber, deformation_gradient=0.75 * np.eye(3))
    wall = fempm.Wall("wall", args.wall, friction=0.5 if args.wall == "contact" else 0.0)
    scene = fempm.Simulation(
        mesh, [body], [wall], transfer="flip", flip=0.99, cfl=args.cfl, threads=args.threads
    )
    print(scene.report())
    record = fempm.run(scene, **run_options(args))
    moments = [(t, x, np.linalg.norm(v, axis=1)) for t, x, v in record.frames[:: len(record.frames) // 4]]
    picture = snapshot_strip(f"{args.output}.png", moments, label="speed (m/s)")
    x, mass, log = scene.gather("position"), scene.gather("mass"), record.log
    reach = max(np.linalg.norm(x, axis=1).max() for _, x, _ in record.frames)
    energy = {name: log[name] / log["total"][0] for name in log if name in KINDS}
    centre, hits = np.linalg.norm(mass @ x) / mass.sum(), scene.ranks.sum(scene.wall_hits)
    print(f"{scene.steps} steps; centre of mass off by {centre / 0.5:.1e} of the radius (exact: 0),")
    print(f"largest radius {reach:.4f} m of 0.5 m; particles put back on the wall: {hits}")
    print("energy, in shares of its start: at the end and at most (FLIP damps short waves, see README)")
    for name, share in energy.items():
        print(f"  {name:8} {share[-1]:7.4f} {share.max():7.4f}")
    print_files([*record.files, picture])
    return {"energy": energy["total"], "centre": centre, "reach": reach, "hits": hits, "record": record}


KINDS = ("kinetic", "elastic", "barrier", "friction", "total")

if __name__ == "__main__":
    main()
