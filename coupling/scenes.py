"""What the coupled scenes have in common: shocks and bursts to start from, and the report at their end."""

import numpy as np

from fempm.cli import run_options
from fempm.run import run

from .picture import schlieren_strip, spread


def shocked(mach, density, pressure, gamma=1.4):
    """Density, speed and pressure behind a shock that runs into a gas at rest (Rankine-Hugoniot)."""
    if not mach > 1:
        raise ValueError(f"mach {mach}: a shock is faster than sound")
    square = mach**2
    ratio = (gamma + 1) * square / ((gamma - 1) * square + 2)
    speed = mach * np.sqrt(gamma * pressure / density) * (1 - 1 / ratio)
    return density * ratio, speed, pressure * (1 + 2 * gamma / (gamma + 1) * (square - 1))


def planar_shock(mach, position, density=1.0, pressure=1.0, gamma=1.4):
    """Initial state, a function for `Flow`: a shock at x = position runs into gas at rest, to larger x."""
    behind = shocked(mach, density, pressure, gamma)

    def initial(x):
        pushed, along = x[:, 0] < position, np.eye(x.shape[1])[0]
        velocity = np.where(pushed, behind[1], 0.0)[:, None] * along
        return np.where(pushed, behind[0], density), velocity, np.where(pushed, behind[2], pressure)

    return initial


def burst(centre, radius, density, pressure, outside=(1.0, 1.0)):
    """Initial state, a function for `Flow`: gas at rest, denser and under pressure in a ball or ellipsoid.

    `radius` is a number or (d,), `outside` density and pressure of the other gas.
    """

    def initial(x):
        inside = np.sum(((x - centre) / radius) ** 2, axis=1) < 1
        return np.where(inside, density, outside[0]), 0.0, np.where(inside, pressure, outside[1])

    return initial


def centres(scene):
    """Columns for a run's log: the centre of mass of every body that still has particles. Collective."""
    p, names, out = scene.solid.particles, "xyz"[: scene.mesh.dim], {}
    for body, part in zip(scene.solid.bodies, p.ranges, strict=True):
        sums = scene.ranks.sum(np.append(p.mass[part] @ p.position[part], p.mass[part].sum()))
        with np.errstate(invalid="ignore"):
            centre = sums[:-1] / sums[-1]
        out |= {f"{body.name.replace(' ', '_')}_{a}": c for a, c in zip(names, centre, strict=True)}
    return out


def play(scene, args, moments=4, plane=None, contrast=8.0, **options):
    """Run a coupled scene with the options of its command line, draw it, and print what was conserved.

    Parameters
    ----------
    scene : Coupled
    args : of `fempm.cli.scene_arguments`
    moments : panels of the picture, schlieren with particles
    plane : (axis, coordinate) of the slice drawn in 3D; particles within a cell's width of it are drawn
    contrast : of the schlieren, see `schlieren_strip`
    options : further ones of `fempm.run`

    Returns
    -------
    record : of the run, whose log has the centres of the bodies
    pictures : list of paths, for further ones
    """
    options.setdefault("watch", centres)
    record = run(scene, **run_options(args), **options)
    chosen = spread(range(len(record.vertex_frames)), moments)
    fields = [record.vertex_frames[k] for k in chosen]
    positions = [record.frames[k][1] for k in chosen]
    if plane is not None:
        width = np.median(scene.width)
        positions = [x[abs(x[:, plane[0]] - plane[1]) < width] for x in positions]
    drawn = {"contrast": contrast, "plane": plane, "particles": positions}
    path = schlieren_strip(f"{args.output}.png", scene.mesh, fields, **drawn)
    log, mesh = record.log, scene.mesh
    print(f"{len(mesh.points)} vertices, {scene.solid.num_particles} particles, {scene.steps} steps,")
    print(
        f"{scene.repeated} repeated in halves; at most {log['iterations'].max()} iterations for the pressure"
    )
    for name in ("mass", "energy"):
        value = log[name]
        print(f"{name}: {value[0]:.6g} at first, {value[-1]:.6g} at the end (open ends count)")
    return record, [path]
