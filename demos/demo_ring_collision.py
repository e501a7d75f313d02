"""Two hollow rubber cylinders collide and bounce apart (plane strain; a common test of contact in the
material point method: K = 121.7 MPa, G = 26.1 MPa, 1010 kg/m^3, radii 30 and 40 mm, 30 m/s each)."""

from pathlib import Path

import numpy as np

import fempm
from fempm.cli import print_files, run_options, scene_arguments
from fempm.diagnostics import angular_momentum, linear_momentum
from fempm.picture import snapshot_strip

MESHES = Path(__file__).parent.parent / "meshes"
K, G, SPEED, RADIUS = 121.7e6, 26.1e6, 30.0, 0.04


def main(argv=None):
    options = {"h": (0.003, "mesh size in m"), "transfer": (("flip", "apic"), "transfer scheme")}
    args = scene_arguments(__doc__, argv, until=4e-3, **options)
    mesh = fempm.read_mesh(MESHES / "tank.geo", h=args.h, W=0.26, H=0.12)
    outline = fempm.read_mesh(MESHES / "ring.geo", h=args.h / RADIUS, R=0.75)  # scaled to the radius below
    x, volume = fempm.fill_cells(outline, 4)
    rubber = fempm.NeoHookean(
        density=1010.0, young=9 * K * G / (3 * K + G), poisson=0.5 - 1.5 * G / (3 * K + G)
    )
    rings = [
        fempm.Body([place, 0.06] + RADIUS * x, RADIUS**2 * volume, rubber, [speed, 0.0], name=name)
        for name, place, speed in (("left ring", 0.085, SPEED), ("right ring", 0.175, -SPEED))
    ]
    scene = fempm.Simulation(mesh, rings, transfer=args.transfer, threads=args.threads)
    size = scene.gather("mass") @ np.linalg.norm(scene.gather("velocity"), axis=1)
    start = linear_momentum(scene), angular_momentum(scene)

    def watch(simulation):
        return {"left_momentum_x": linear_momentum(simulation, 0)[0]}

    record = fempm.run(scene, **run_options(args), watch=watch)
    log = record.log
    drift = np.abs(linear_momentum(scene) - start[0]).max() / size
    turn = np.abs(angular_momentum(scene) - start[1]).max() / (size * RADIUS)
    recovered = -log["left_momentum_x"][-1] / log["left_momentum_x"][0]
    energy = {name: log[name] / log["total"][0] for name in ("kinetic", "elastic", "total")}
    moments = [(t, x, np.linalg.norm(v, axis=1)) for t, x, v in record.frames[::4][:5]]
    picture = snapshot_strip(f"{args.output}.png", moments, label="speed (m/s)")
    print(f"momentum off by {drift:.1e} of sum m |v|, angular momentum by {turn:.1e} of it times the radius;")
    at = energy["elastic"].argmax()
    print(f"the left ring goes back with {100 * recovered:.1f} % of its momentum; energy: elastic at most")
    print(f"{100 * energy['elastic'][at]:.1f} % at {1e3 * log['time'][at]:.2f} ms, at the end", end=" ")
    print(f"{100 * energy['kinetic'][-1]:.1f} % kinetic and {100 * energy['total'][-1]:.1f} % in all")
    print_files([*record.files, picture])
    return {"drift": drift, "turn": turn, "recovered": recovered, "energy": energy, "record": record}


if __name__ == "__main__":
    main()
