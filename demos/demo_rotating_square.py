"""A square torn round by its two halves: momenta under APIC over many steps (thesis 2.2.1)."""

from pathlib import Path

import numpy as np

import fempm
from fempm.cli import print_files, run_options, scene_arguments
from fempm.diagnostics import angular_momentum, linear_momentum
from fempm.picture import snapshot_strip

MESHES = Path(__file__).parent.parent / "meshes"


def main(argv=None):
    args = scene_arguments(__doc__, argv, until=1.0, every=0.2, h=(0.01, "mesh size in m"))
    mesh = fempm.read_mesh(MESHES / "square.geo", h=args.h)
    rubber = fempm.NeoHookean(density=1.0, young=1e4, poisson=0.3)
    square = fempm.Body(
        *fempm.fill_box([0.4, 0.4], [0.6, 0.6], 0.01),
        rubber,
        velocity=lambda x: np.where(x[:, :1] < 0.5, [0.0, 1.0], [0.0, -1.0]),
    )
    scene = fempm.Simulation(mesh, [square], transfer="apic", threads=args.threads)
    size = scene.gather("mass") @ np.linalg.norm(scene.gather("velocity"), axis=1)
    start = linear_momentum(scene), angular_momentum(scene)
    record = fempm.run(scene, **run_options(args), log_every=1000, dt=1e-5)
    drift = np.abs(linear_momentum(scene) - start[0]).max() / size
    turn = np.abs(angular_momentum(scene) / start[1] - 1).max()
    moments = [(t, x, np.linalg.norm(v, axis=1)) for t, x, v in record.frames[::2]]
    picture = snapshot_strip(f"{args.output}.png", moments, label="speed (m/s)")
    print(f"after {scene.steps} steps: linear momentum off by {drift:.1e} of sum m |v|,")
    print(f"angular momentum by {turn:.1e} of its start (thesis: 1e-15 and 1e-7, absolute, 1e6 steps)")
    print_files([*record.files, picture])
    return {"linear": drift, "angular": turn, "record": record}


if __name__ == "__main__":
    main()
