"""Running a simulation: time loop, output frames, log, progress, and an orderly end when it fails."""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from . import diagnostics
from .locate import LostParticles
from .output import MeshFile, ParticleFile, Progress, TimeLog
from .solver import SimulationError


@dataclass
class Record:
    """What a run leaves behind.

    Attributes
    ----------
    log : dict name -> (k,) array, the columns of the CSV log (see `diagnostics.summary`)
    frames : list of (time, positions, velocities) at the output times
    files : paths written
    """

    log: dict = field(default_factory=dict)
    frames: list = field(default_factory=list)
    files: list = field(default_factory=list)


def run(
    simulation,
    until,
    output=None,
    frames=20,
    log_every=10,
    dt=None,
    watch=None,
    progress=True,
):
    """Advance a simulation to the time `until`.

    Parameters
    ----------
    simulation : Simulation
    until : final time; steps are shortened evenly so that it and the frames are met exactly
    output : path without ending, for example "results/bar": writes particles (.xdmf), vertex fields
        (_mesh.xdmf) and the log (.csv) beside it; nothing is written when not given
    frames : number of output frames after the initial one
    log_every : steps between rows of the log
    dt : fixed time step; the stable one of the current state when not given
    watch : function of the simulation returning a dict, further columns of the log
    progress : show a progress bar

    Returns
    -------
    Record

    Raises
    ------
    SimulationError, LostParticles
        with time and place; the state at that time is written to <output>_last.xdmf
    ValueError
        for a final time before the current one, a time step that is not positive, or no frames
    """
    if not until >= simulation.time:
        raise ValueError(f"until {until}: the simulation is at time {simulation.time} already")
    if dt is not None and not dt > 0:
        raise ValueError(f"dt {dt}: the time step must be positive")
    if frames < 1 or log_every < 1:
        raise ValueError(f"frames {frames}, log_every {log_every}: give at least 1 each")
    record = Record()
    writers = Writers(simulation, output, record)
    bar = Progress(until) if progress else None
    times = np.linspace(simulation.time, until, frames + 1)
    try:
        log_row(simulation, dt, watch, record, writers)
        for k, target in enumerate(times):
            while simulation.time < target:
                advance(simulation, target, dt)
                if simulation.steps % log_every == 0:
                    log_row(simulation, dt, watch, record, writers)
                if bar:
                    bar.update(simulation.time, f"step {simulation.steps}")
            p = simulation.particles
            record.frames.append((simulation.time, p.position.copy(), p.velocity.copy()))
            writers.frame(k)
        if record.log["time"][-1] < simulation.time:
            log_row(simulation, dt, watch, record, writers)
    except (SimulationError, LostParticles) as error:
        path = Path(f"{output or 'fempm'}_last.xdmf")
        with ParticleFile(path) as last:
            last.write(simulation.time, simulation.particles.position, **particle_fields(simulation))
        error.args = (f"{error}; last state in {path}",)
        raise
    finally:
        writers.close()
        if bar:
            bar.close()
    record.log = {name: np.array(column) for name, column in record.log.items()}
    return record


def advance(simulation, target, dt):
    """One step towards the target time, of equal length to those that follow it."""
    wanted = dt or simulation.stable_step()
    left = target - simulation.time
    steps = int(np.ceil(left / wanted * (1 - 1e-12)))
    simulation.dt = left / steps
    simulation.step(simulation.dt)
    if steps == 1:
        simulation.time = target


def log_row(simulation, dt, watch, record, writers):
    """Append one row to the log in memory and on disk."""
    row = diagnostics.summary(simulation)
    if watch is not None:
        row |= watch(simulation)
    for name, value in row.items():
        record.log.setdefault(name, []).append(value)
    writers.row(simulation.steps, row)


def particle_fields(simulation):
    """Fields written with the particles."""
    p = simulation.particles
    with np.errstate(all="ignore"):
        return {
            "velocity": p.velocity,
            "cauchy_stress": p.cauchy_stress,
            "deformation_gradient": p.deformation_gradient,
            "density": p.mass / (p.volume * np.linalg.det(p.deformation_gradient)),
            "body": p.body,
            "id": np.arange(len(p)),
        }


def vertex_fields(simulation):
    """Mass and velocity on the mesh's vertices, as the last step left them; zero without particles."""
    nv = len(simulation.mesh.points)
    seen = simulation.stamp[:nv] == simulation.steps - 1
    return {
        "mass": np.where(seen, simulation.grids[0, :nv, 0], 0.0),
        "velocity": np.where(seen[:, None], simulation.velocity[:nv], 0.0),
    }


class Writers:
    """The files of one run; does nothing without an output path."""

    def __init__(self, simulation, output, record):
        self.simulation, self.on = simulation, output is not None
        if not self.on:
            return
        mesh = simulation.mesh
        paths = [f"{output}.xdmf", f"{output}_mesh.xdmf", f"{output}.csv"]
        self.particles = ParticleFile(paths[0])
        self.mesh = MeshFile(paths[1], mesh.points, mesh.cells)
        self.log = TimeLog(paths[2])
        record.files += [Path(p) for p in paths]

    def frame(self, k):
        """Write frame k of particles, and of vertex fields once there are any."""
        if not self.on:
            return
        s = self.simulation
        self.particles.write(s.time, s.particles.position, **particle_fields(s))
        if s.steps:
            self.mesh.write(s.time, **vertex_fields(s))

    def row(self, step, columns):
        """Write one row of the log."""
        if self.on:
            self.log.write(step, **columns)

    def close(self):
        """Close all files."""
        if self.on:
            for writer in (self.particles, self.mesh, self.log):
                writer.close()
