"""A ball of compressed gas explodes in a closed box, in 3D (Toro, Riemann Solvers, section 17.1).

One eighth of it, between the three planes of symmetry. What the shock has not reached costs no advection."""

from pathlib import Path

import numpy as np

import fempm
from coupling import Flow, IdealGas, SlipWall
from coupling.picture import schlieren_strip, spread
from coupling.probes import probe
from fempm.cli import print_files, run_options, scene_arguments

MESHES = Path(__file__).parent.parent / "meshes"


def initial(x):
    """Density, velocity and pressure: ten times the pressure within 0.4 of the corner."""
    inside = np.linalg.norm(x, axis=1) < 0.4
    return np.where(inside, 1.0, 0.125), 0.0, np.where(inside, 1.0, 0.1)


def rays(number):
    """(number, 3) directions spread evenly over an octant."""
    k = np.arange(number) + 0.5
    z, angle = k / number, 0.5 * np.pi * (k * 0.6180339887 % 1)
    return np.stack([np.sqrt(1 - z**2) * np.cos(angle), np.sqrt(1 - z**2) * np.sin(angle), z], axis=1)


def main(argv=None):
    args = scene_arguments(__doc__, argv, until=0.25, every=0.05, threads=False, h=(0.04, "mesh size in m"))
    mesh = fempm.read_mesh(MESHES / "cube.geo", h=args.h)
    gas = Flow(mesh, IdealGas(1.4), initial, [SlipWall("walls")])
    record = fempm.run(gas, **run_options(args))
    radii, fields = np.linspace(0.01, 0.98, 971), record.frames[-1][1]
    x = rays(200)[:, None] * radii[:, None]
    pressure, density = (probe(mesh, x, fields[n]).reshape(200, -1) for n in ("pressure", "density"))
    shock = radii[np.argmin(np.where(radii > 0.6, np.gradient(pressure.mean(axis=0)), 0))]
    differ = density.std(axis=0)
    drift = {name: np.ptp(record.log[name]) / record.log[name][0] for name in ("mass", "energy")}
    picture = schlieren_strip(
        f"{args.output}.png", mesh, spread(record.frames, 3), contrast=5.0, plane=(2, 0.02)
    )
    print(f"{len(mesh.points)} vertices, {len(mesh.cells)} cells, {gas.steps} steps")
    print(f"mass off by {drift['mass']:.1e}, energy by {drift['energy']:.1e} of their start")
    print(f"shock at r = {shock:.3f} m (radial reference at 0.25 s: 0.793 m)")
    print(f"density at equal radius differs by {differ.mean():.1e} kg/m3 (RMS), at most {differ.max():.3f}")
    print_files([*record.files, picture])
    return {"shock": shock, "spread": differ.mean(), "drift": drift, "record": record}


if __name__ == "__main__":
    main()
