"""A disk of compressed gas bursts in a closed square, on irregular triangles (Kwatra et al. 2009, Toro 17.1).

Reference at 0.25 s, a radial computation on 16,000 cells: shock at r = 0.8134, contact at 0.620."""

from pathlib import Path

import numpy as np

import fempm
from coupling import Flow, IdealGas, SlipWall
from coupling.picture import schlieren_strip, spread
from coupling.probes import probe
from fempm.cli import print_files, run_options, scene_arguments

MESHES = Path(__file__).parent.parent / "meshes"


def initial(x):
    """Density, velocity and pressure: ten times the pressure within 0.4 of the centre."""
    inside = np.linalg.norm(x, axis=1) < 0.4
    return np.where(inside, 1.0, 0.125), 0.0, np.where(inside, 1.0, 0.1)


def around(mesh, fields, radii, rays=180):
    """Density and pressure (rays, m) on circles."""
    angle = 2 * np.pi * (np.arange(rays)[:, None] + 0.5) / rays
    x = np.stack([radii * np.cos(angle), radii * np.sin(angle)], axis=-1)
    return (probe(mesh, x, fields[name]).reshape(rays, -1) for name in ("density", "pressure"))


def main(argv=None):
    options = {"h": (0.01, "mesh size in m"), "pair": (("B1-B0", "B2-B1"), "spaces of velocity and pressure")}
    args = scene_arguments(__doc__, argv, until=0.25, every=0.05, threads=False, **options)
    mesh = fempm.read_mesh(MESHES / "tank.geo", h=args.h, W=2.0, H=2.0, x0=-1.0, y0=-1.0)
    walls = [SlipWall(name) for name in ("left", "right", "bottom", "top")]
    gas = Flow(mesh, IdealGas(1.4), initial, walls, pair=args.pair)
    record = fempm.run(gas, **run_options(args))
    radii = np.linspace(0, 0.95, 951)
    density, pressure = around(mesh, record.frames[-1][1], radii)
    mean, differ = density.mean(axis=0), density.std(axis=0)
    # the pressure jumps at the shock, the density at the contact behind it
    shock = radii[np.argmin(np.where(radii > 0.6, np.gradient(pressure.mean(axis=0)), 0))]
    contact = radii[np.argmin(np.where(abs(radii - shock + 0.2) < 0.1, np.gradient(mean), 0))]
    drift = {name: np.ptp(record.log[name]) / record.log[name][0] for name in ("mass", "energy")}
    picture = schlieren_strip(f"{args.output}.png", mesh, spread(record.frames, 3), contrast=5.0)
    print(f"{len(mesh.points)} vertices, {gas.steps} steps, {gas.repeated} repeated in halves")
    print(f"mass off by {drift['mass']:.1e}, energy by {drift['energy']:.1e} of their start")
    print(f"shock at r = {shock:.4f} m, contact at {contact:.3f} m (reference at 0.25 s: 0.8134 and 0.620)")
    print(f"density at equal radius differs by {differ.mean():.2e} kg/m3 (RMS), at most {differ.max():.3f},")
    print(f"where it is steep: r = {radii[differ.argmax()]:.3f} m")
    print_files([*record.files, picture])
    return {"shock": shock, "contact": contact, "spread": differ.mean(), "drift": drift, "record": record}


if __name__ == "__main__":
    main()
