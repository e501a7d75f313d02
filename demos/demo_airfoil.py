"""Wind over an airfoil (NACA 0012), near and above the speed of sound, ten chords of air around it.

Exact: the pressure coefficient where the wind comes to rest at the nose; at Mach 2 behind a normal shock."""

from pathlib import Path

import numpy as np

import fempm
from coupling import Flow, IdealGas, Inflow, Outflow, SlipWall
from coupling.picture import colour_strip
from coupling.probes import stopped_pressure, wall_force
from fempm.cli import print_files, run_options, scene_arguments
from fempm.picture import curves

MESHES = Path(__file__).parent.parent / "meshes"


def main(argv=None):
    h, angle = (0.02, "mesh size along the airfoil in chords"), (1.25, "angle with the chord in degrees")
    wind = {"mach": (0.8, "Mach number of the wind"), "angle": angle}
    args = scene_arguments(__doc__, argv, until=None, threads=False, h=h, **wind)
    turn = np.deg2rad(args.angle)
    along, up = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    mesh = fempm.read_mesh(MESHES / "naca0012.geo", h=args.h)
    wind = {"density": 1.4, "velocity": args.mach * along, "pressure": 1.0}  # sound: 1 m/s
    left = Inflow("left", **wind) if args.mach > 1 else Outflow("left", **wind)
    ends = [left, Outflow("outer", **wind), SlipWall("airfoil")]
    gas = Flow(mesh, IdealGas(1.4), lambda x: tuple(wind.values()), ends)
    head = 0.7 * args.mach**2

    def forces(gas):
        force = wall_force(mesh, "airfoil", gas.vertex_fields()["pressure"]) / head
        return {"lift": force @ up, "drag": force @ along}

    run = run_options(args) | {"until": args.until or (30.0 if args.mach < 1 else 8.0)}
    record = fempm.run(gas, **run, watch=forces)
    fields, late = record.frames[-1][1], record.log["time"] > 0.9 * gas.time
    lift, drag = (record.log[name][late].mean() for name in ("lift", "drag"))
    on = np.array(sorted(np.unique(mesh.facets("airfoil")), key=lambda i: mesh.points[i, 0]))
    cp, y, x = (fields["pressure"][on] - 1) / head, mesh.points[on, 1], np.linspace(0, 1, 501)
    upper, lower = (np.interp(x, mesh.points[on[s], 0], cp[s]) for s in (y > -1e-9, y < 1e-9))
    shock = x[25 + np.argmax(np.diff(upper[25:451]))]
    nose = (stopped_pressure(args.mach) - 1) / head
    near = {"label": "Mach number", "box": (-0.6, 1.6, -0.8, 0.8)}
    sides = {"upper side": -upper, "lower side": -lower}
    picture = colour_strip(f"{args.output}.png", mesh, record.frames[-1:], "mach", **near)
    curve = curves(f"{args.output}_cp.png", x, sides, "x in chords", "-cp")
    print(f"{len(mesh.points)} vertices, {gas.steps} steps; coefficients: lift {lift:.4f}, drag {drag:.4f}")
    print(f"steepest rise of pressure on the upper side at {shock:.2f} chords, least cp {cp.min():.2f}")
    print(f"cp at the nose {cp.max():.3f} (exact: {nose:.3f}); Mach at most {fields['mach'].max():.2f}")
    print_files([*record.files, picture, curve])
    return {"lift": lift, "drag": drag, "shock": shock, "nose": cp.max() / nose, "record": record}


if __name__ == "__main__":
    main()
