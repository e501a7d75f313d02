"""Energies and momenta of a simulation's particles, of all ranks together: all functions are collective."""

import numpy as np

from . import boundaries
from .kernel import negative_weights


def energies(simulation):
    """Kinetic, elastic, gravity and other energy, dict of floats (J, per unit depth in 2D).

    The kinetic energy is that of the particle velocities; what APIC keeps in its affine matrices is not
    in it. Gravity energy is relative to the origin. With plastic materials there is also "dissipated", with
    contact "barrier", and with friction "friction", the work done against it.
    """
    p = simulation.particles
    elastic = 0.0
    for body, part in zip(simulation.bodies, p.ranges, strict=True):
        state = {name: p.state[name][part] for name in getattr(body.material, "state", ())}
        elastic += float(p.volume[part] @ body.material.energy(p.deformation_gradient[part], **state))
    out = {
        "kinetic": 0.5 * float(p.mass @ np.sum(p.velocity**2, axis=1)),
        "elastic": elastic,
        "gravity": -float(p.mass @ (p.position @ simulation.gravity)),
    }
    if "dissipation" in p.state:
        out["dissipated"] = float(p.volume @ p.state["dissipation"])
    if simulation.contact:
        out["barrier"] = simulation.contact.energy(p)
    if "friction_work" in p.state:
        out["friction"] = float(p.state["friction_work"].sum())
    total = simulation.ranks.sum(np.array(list(out.values())))
    return dict(zip(out, total.tolist(), strict=True))


def linear_momentum(simulation, body=None):
    """(d,) sum of m v over the particles of one body, or of all."""
    p = simulation.particles
    part = slice(None) if body is None else p.ranges[body]
    return simulation.ranks.sum(p.mass[part] @ p.velocity[part])


def angular_momentum(simulation):
    """Angular momentum about the origin: (1,) in 2D, (3,) in 3D, empty in 1D.

    With APIC it includes the affine part sum m B^T : eps (thesis definition 2.2.4).
    """
    p = simulation.particles
    x, mv = p.position, p.mass[:, None] * p.velocity
    moment = np.einsum("pa,pb->ab", x, mv)
    if len(p.affine):
        moment += np.einsum("p,pba->ab", p.mass, p.affine)
    spin = simulation.ranks.sum(moment - moment.T)
    if len(spin) < 2:
        return np.empty(0)
    return np.array([spin[0, 1]]) if len(spin) == 2 else spin[[1, 2, 0], [2, 0, 1]]


def summary(simulation):
    """Everything above as one flat dict, the columns of a run's CSV log."""
    energies_now = energies(simulation)
    out = {"time": simulation.time, "dt": simulation.dt, **energies_now}
    out["total"] = sum(energies_now.values())
    names = "xyz"[: simulation.mesh.dim]
    out |= {f"momentum_{a}": m for a, m in zip(names, linear_momentum(simulation), strict=True)}
    spin = angular_momentum(simulation)
    out |= {f"spin_{a}": s for a, s in zip("z" if len(spin) == 1 else names, spin, strict=False)}
    return out


def vertex_fields(simulation):
    """Mass (nv,) and velocity (nv, d) on the mesh's vertices, zero without particles."""
    simulation.particle_to_grid()
    boundaries.fold(simulation, boundaries.wall_motion(simulation, 0.0)[0][0])
    at, *values = at_vertices(simulation)
    fields = {}
    for name, found in zip(("mass", "velocity"), values, strict=True):
        fields[name] = np.zeros((len(simulation.mesh.points), *found.shape[1:]))
        fields[name][at] = found
    return fields


def at_vertices(simulation):
    """Vertices (k,), with their mass (k,) and velocity (k, d), of folded sums that ranks have not yet shared.

    Those of all ranks together, except where there is next to no mass.
    """
    s, nv, d = simulation, len(simulation.mesh.points), simulation.mesh.dim
    fields, at = np.zeros((nv, 1 + d)), s.vertices[: s.num_vertices]
    at = at[at < nv]
    fields[at] = s.grids[0, at, : 1 + d]
    fields = s.ranks.sum(fields)
    seen = np.flatnonzero(fields[:, 0] > s.smallest_mass)
    return seen, fields[seen, 0], fields[seen, 1:] / fields[seen, :1]


def active_parts(simulation):
    """Which parts of the method this scene uses: name -> whether it costs anything."""
    s = simulation
    return {
        "affine matrices (APIC)": len(s.particles.affine) > 0,
        "velocity increments (FLIP)": len(s.increment) > 0,
        "consistent-gradient correction": len(s.kernel.phi) > 0,
        "mirror vertices along walls": len(s.layer.owner) > 0,
        "moving walls": bool(s.layer.moving),
        "body force at particles": s.body_force is not None,
        "barrier contact": bool(s.contact),
        "F-bar": bool(s.f_bar),
        "condition on vertices": s.condition is not None,
        "gravity": bool(np.any(s.gravity)),
        "outlets": s.outlet is not None,
        "threads": s.threads > 1,
        "several ranks": s.ranks.size > 1,
    }


def report(simulation):
    """A few lines on the scene: sizes, active parts, correction, counters. Collective."""
    s = simulation
    p, k, ranks = s.particles, s.kernel, s.ranks
    negative, least = negative_weights(k, p.position, p.cell)
    negative, least = ranks.sum(negative), -ranks.max(-least)
    most = ranks.max(len(p)) * ranks.size / s.num_particles
    parts = [f"  {'on ' if on else 'off'}  {name}" for name, on in active_parts(s).items()]
    return "\n".join(
        [
            f"{s.num_particles} particles, bodies: {len(s.bodies)}, "
            f"{len(s.mesh.cells)} cells, {len(s.mesh.points)} vertices, {len(s.layer.owner)} mirror vertices",
            *([f"{ranks.size} ranks, the fullest has {most:.2f} of its share"] if ranks.size > 1 else []),
            *parts,
            f"consistent gradients: largest |int g| {s.correction['before']:.1e} -> "
            f"{s.correction['after']:.1e} of int w / h in {s.correction['iterations']} iterations",
            f"negative weights: {negative} particles see one, the least is {least:.3g}",
            f"vertices left out for lack of mass: {ranks.sum(s.dropped_vertices)} in {s.steps} "
            f"steps, momentum lost there: {ranks.sum(s.lost_momentum):.2e}",
            f"particles put back on a wall: {ranks.sum(s.wall_hits)}",
            *([contact_line(s)] if s.contact else []),
        ]
    )


def contact_line(simulation):
    """How many particles are within reach of a surface, and the energy of the barrier there. Collective."""
    s = simulation
    touching = s.ranks.sum(int(np.sum(s.contact.distance[: s.contact.num] < s.contact.nearby)))
    energy = energies(s)
    share = energy["barrier"] / max(sum(abs(e) for e in energy.values()), 1e-300)
    return (
        f"contacts within reach: {touching}, their barrier holds {100 * share:.2g} % of all energy; steps in "
        f"which vertices were held back: {s.held_back}"
    )
