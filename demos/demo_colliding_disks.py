"""Two elastic disks collide and bounce apart (thesis 2.3.2)."""

from pathlib import Path

import numpy as np

import fempm
from fempm.cli import print_files, run_options, scene_arguments
from fempm.diagnostics import linear_momentum
from fempm.picture import snapshot_strip

MESHES = Path(__file__).parent.parent / "meshes"


def main(argv=None):
    args = scene_arguments(
        __doc__,
        argv,
        until=3.5,
        h=(0.025, "mesh size in m"),
        transfer=(("flip", "apic"), "transfer scheme"),
    )
    mesh = fempm.read_mesh(MESHES / "collision_box.geo", h=args.h)
    rubber = fempm.NeoHookean(density=1000.0, young=1000.0, poisson=0.3)
    outline = fempm.read_mesh(MESHES / "disk.geo", h=args.h / 0.2)  # a unit disk, scaled to r = 0.2
    x, volume = fempm.fill_cells(outline, 4)
    left = fempm.Body(0.2 + 0.2 * x, 0.04 * volume, rubber, velocity=[0.1, 0.1], name="left disk")
    right = fempm.Body(0.8 + 0.2 * x, 0.04 * volume, rubber, velocity=[-0.1, -0.1], name="right disk")
    scene = fempm.Simulation(mesh, [left, right], transfer=args.transfer, threads=args.threads)
    centre = np.argmin(np.linalg.norm(left.position - 0.2, axis=1))

    def watch(simulation):
        stress = simulation.gather("cauchy_stress")[centre]
        return {"left_momentum_x": linear_momentum(simulation, 0)[0], "stress_xx": stress[0, 0]}

    record = fempm.run(scene, **run_options(args), watch=watch)
    log = record.log
    recovered = -log["left_momentum_x"][-1] / log["left_momentum_x"][0]
    energy = log["total"] / log["total"][0]
    size = scene.gather("mass") @ np.linalg.norm(scene.gather("velocity"), axis=1)
    drift = np.abs(linear_momentum(scene)).max() / size
    moments = [(t, x, np.linalg.norm(v, axis=1)) for t, x, v in record.frames[8:15:3]]
    picture = snapshot_strip(f"{args.output}.png", moments, label="speed (m/s)")
    kinetic = log["kinetic"][-1] / log["kinetic"][0]
    print(f"total momentum off by {drift:.1e} of sum m |v|; the left disk recovers {100 * recovered:.1f} %")
    print(
        f"of its momentum; kinetic energy {100 * kinetic:.1f} %, total {100 * energy[-1]:.1f} % of the start"
    )
    print_files([*record.files, picture])
    return {"drift": drift, "recovered": recovered, "energy": energy[-1], "record": record}


if __name__ == "__main__":
    main()
