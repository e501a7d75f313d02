"""Hot gas at high pressure bursts an elastic shell in a closed box of still air (thesis 3.10).

The shell stretches until its particles are too far apart to hold on to each other, and tears. Shocks run
ahead of it and through the gaps, come back from the walls, and gas flows back with them. Exact: the mass of
the gas. Energy is lost where APIC damps the pieces that snap back."""

import numpy as np

import fempm
from coupling import Coupled, IdealGas, SlipWall
from coupling.scenes import burst, play
from fempm.cli import print_files, scene_arguments

CENTRE, RADIUS, THICK = np.array([0.5, 0.5]), 0.115, 0.03
SIDES = "left", "right", "bottom", "top"


def watch(scene):
    """Columns of the log: pieces, particles in cells that touch, and the speed of the fastest. Collective."""
    corners = scene.mesh.cells[np.unique(scene.gather("cell"))]
    label, before = np.arange(len(scene.mesh.points)), None
    while before is None or np.any(label != before):
        before = label.copy()
        np.minimum.at(label, corners, label[corners].min(axis=1)[:, None])
    speed = np.linalg.norm(scene.gather("velocity"), axis=1).max()
    return {"pieces": len(np.unique(label[corners])), "fastest": speed}


def main(argv=None):
    options = {"h": (0.01, "mesh size in m"), "full": (False, "h = 1/1024 as in the thesis")}
    options |= {"pressure": (100.0, "in the shell, that of the air is 1"), "density": (10.0, "likewise")}
    options |= {"young": (100.0, "Young's modulus of the shell in Pa")}
    args = scene_arguments(__doc__, argv, until=0.3, threads=False, **options)
    h = 1 / 1024 if args.full else args.h
    mesh = fempm.box_mesh([0, 0], [1, 1], h)
    x, volume = fempm.fill_box([0.3, 0.3], [0.7, 0.7], h / 2)
    inside = abs(np.linalg.norm(x - CENTRE, axis=1) - RADIUS) < THICK / 2
    rubber = fempm.NeoHookean(density=50.0, young=args.young, poisson=0.3)
    shell = fempm.Body(x[inside], volume[inside], rubber, name="shell")
    solid = fempm.Simulation(mesh, [shell], [fempm.Wall(s, "slip") for s in SIDES], transfer="apic")
    initial = burst(CENTRE, RADIUS, args.density, args.pressure)
    scene = Coupled(solid, IdealGas(1.4), initial, [SlipWall(s) for s in SIDES])
    record, pictures = play(scene, args, watch=watch)
    log, fields = record.log, record.vertex_frames[-1][1]
    away = mesh.points - CENTRE
    back = -np.min(np.sum(fields["velocity"] * away, axis=1) / (np.linalg.norm(away, axis=1) + 1e-9))
    drift = np.ptp(log["mass"]) / log["mass"][0]
    momentum = max(abs(log[f"momentum_{a}"]).max() for a in "xy")
    print(f"mass off by {drift:.1e}, momentum at most {momentum:.1e}")
    print(f"{log['pieces'][-1]} pieces, the first at {log['time'][np.argmax(log['pieces'] > 1)]:.3f} s")
    print(f"fastest particle {log['fastest'].max():.2f} m/s; gas flows back with {back:.2f} m/s at the end")
    print_files([*record.files, *pictures])
    return {"mass": drift, "pieces": log["pieces"], "record": record}


if __name__ == "__main__":
    main()
