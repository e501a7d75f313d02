"""Running a simulation: time loop, output frames, log, checkpoints, and an orderly end when it fails."""

import contextlib
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import h5py
import numpy as np

from .interrupt import Interrupted, StopRequests
from .locate import LostParticles
from .output import MeshFile, ParticleFile, Progress, TimeLog
from .parallel import RemoteError
from .solver import SimulationError


@dataclass
class Record:
    """What a run leaves behind, the same on all ranks.

    Attributes
    ----------
    log : dict name -> (k,) array, the columns of the CSV log (see `diagnostics.summary`)
    frames : sequence of (time, positions, velocities) at the output times, particles in the order of
        their `id`, or without particles of (time, fields on the vertices); read from the file when asked for,
        in memory where there is none
    vertex_frames : with particles and an output, the same of (time, fields on the vertices)
    files : paths written
    """

    log: dict = field(default_factory=dict)
    frames: Sequence = field(default_factory=list)
    vertex_frames: Sequence = field(default_factory=list)
    files: list = field(default_factory=list)


def run(
    simulation,
    until,
    output=None,
    frames=None,
    every=None,
    log_every=10,
    dt=None,
    watch=None,
    progress=True,
    restart=None,
    checkpoint_every=None,
):
    """Advance a simulation to the time `until`. Collective; the first rank writes all files.

    Ctrl-C and SIGTERM end it with Interrupted, a SystemExit, and a checkpoint <output>_checkpoint.h5.

    Parameters
    ----------
    simulation : Simulation, or `coupling.Flow`
    until : final time; steps are shortened evenly so that it and the frames are met exactly
    output : path without ending, for example "results/bar": writes particles (.xdmf), vertex fields
        (_mesh.xdmf; .xdmf without particles) and the log (.csv) beside it; nothing when not given
    frames : number of output frames after the initial one, 20 when `every` is not given
    every : time between frames, which are at its multiples and at the end
    log_every : steps between rows of the log
    dt : fixed time step; the stable one of the current state when not given
    watch : function of the simulation returning a dict, further columns of the log; every rank calls it
    progress : show a progress bar
    restart : checkpoint to go on from; files of the interrupted run are continued
    checkpoint_every : seconds of wall time after which, and at the end, <output>_checkpoint.h5 is written

    Returns
    -------
    Record

    Raises
    ------
    SimulationError, LostParticles, and RemoteError on ranks where nothing is wrong
        with time and place; the state at that time is written to <output>_last.xdmf
    ValueError, CheckpointError
        for options that are out of range; for a checkpoint that does not fit
    """
    check_options(frames, every, log_every, dt, checkpoint_every)
    ranks, start = simulation.ranks, simulation.time
    if restart is not None:
        simulation.load(restart)
    times = output_times(start, simulation.time, until, frames, every)
    record = Record()
    bar = Progress(until, done=simulation.time) if progress and ranks.rank == 0 else None
    with (
        StopRequests(ranks) as stop,
        Output(simulation, output, record, watch, resume=restart is not None) as files,
        bar or contextlib.nullcontext(),
    ):
        checkpoints = Checkpoints(files, checkpoint_every, stop)
        advance_through(simulation, times, dt, log_every, files, checkpoints, bar)
    record.log = {name: np.array(column) for name, column in record.log.items()}
    return record


def check_options(frames, every, log_every, dt, checkpoint_every):
    """Raise a ValueError for options that are out of range."""
    if frames is not None and every is not None:
        raise ValueError(f"frames {frames}, every {every}: give one of them")
    for name, value in (("every", every), ("checkpoint_every", checkpoint_every)):
        if value is not None and not value > 0:
            raise ValueError(f"{name} {value}: it must be positive")
    if dt is not None and not dt > 0:
        raise ValueError(f"dt {dt}: the time step must be positive")
    if (frames is not None and frames < 1) or log_every < 1:
        raise ValueError(f"frames {frames}, log_every {log_every}: give at least 1 each")


def output_times(start, now, until, frames, every):
    """Times of the frames of a run that began at `start`, from now on."""
    if not until >= now:
        raise ValueError(f"until {until}: the simulation is at time {now} already")
    if every is None:
        times = np.linspace(start, until, (frames or 20) + 1)
    else:
        between = every * np.arange(np.floor(start / every) + 1, np.ceil(until / every))
        apart = (between > start + 1e-9 * every) & (between < until - 1e-9 * every)
        times = np.array([start, *between[apart], until])
    return np.unique(times[times >= now])


def advance_through(simulation, times, dt, log_every, files, checkpoints, bar):
    """The time loop: steps up to each output time, with rows of the log, frames and checkpoints."""
    log, frames = files.record.log, files.record.frames
    if not log or simulation.steps % log_every == 0:
        files.row()
    if not frames and times[0] > simulation.time:
        files.frame()
    try:
        for target in times:
            while simulation.time < target:
                advance(simulation, target, dt)
                if simulation.steps % log_every == 0:
                    files.row()
                if bar:
                    bar.update(simulation.time, f"step {simulation.steps}")
                checkpoints.look()
            files.frame()
    except (SimulationError, LostParticles, RemoteError) as error:
        error.args = (f"{error}; last state in {files.last_state()}",)
        raise
    if log["time"][-1] < simulation.time:
        files.row()
    checkpoints.look(at_end=True)


def advance(simulation, target, dt):
    """One step towards the target time, of equal length to those that follow it."""
    wanted = dt or simulation.stable_step()
    left = target - simulation.time
    steps = int(np.ceil(left / wanted * (1 - 1e-12)))
    simulation.dt = left / steps
    simulation.step(simulation.dt)
    if steps == 1:
        simulation.time = target


def particle_fields(simulation):
    """Fields written with the particles, in the order of their `id`, on the first rank. Collective."""
    p, fields = simulation.particles, {}
    d = p.position.shape[1]
    names = {name: name for name in ("velocity", "cauchy_stress", "deformation_gradient", "mass", "body")}
    names |= {"volume": "volume", "jacobian": "jacobian"}
    for name, array in p.state.items():
        if array.shape[1:] in ((), (d,), (3,), (d, d), (3, 3)):  # what XDMF has a type for
            names[name] = f"state/{name}"
    with np.errstate(all="ignore"):
        for name, source in names.items():
            array = simulation.gather(source)
            if simulation.ranks.rank == 0:
                fields[name] = array
        identity = simulation.gather("id")
        if fields:
            fields["density"] = fields.pop("mass") / (fields.pop("volume") * fields.pop("jacobian"))
            fields["id"] = identity
    return fields


class Frames(Sequence):
    """Frames in a file, read when they are asked for.

    Of particles (time, positions, velocities) each; without particles (time, fields), a dict.
    """

    def __init__(self, path, dim, times, particles):
        self.path, self.dim, self.times, self.particles = path, dim, times, particles

    def __len__(self):
        return len(self.times)

    def __getitem__(self, k):
        if isinstance(k, slice):
            return [self[i] for i in range(len(self))[k]]
        k = range(len(self))[k]
        with h5py.File(self.path, "r") as file:  # locked as a file that the caller may have open, too
            if not self.particles:
                fields = {name: field[()] for name, field in file[f"{k}/Node"].items()}
                fields["velocity"] = fields["velocity"][:, : self.dim]
                return self.times[k], fields
            x, v = (file[f"{k}/{name}"][:, : self.dim] for name in ("points", "Node/velocity"))
        return self.times[k], x, v


class Output:
    """The files of one run, written by the first rank; all methods are collective.

    Without a path, rows and frames are kept in the record only.
    """

    def __init__(self, simulation, path, record, watch, resume):
        self.simulation, self.path, self.record, self.watch = simulation, path, record, watch
        self.with_particles = simulation.particles is not None
        self.series = self.log = None
        if path is None:
            return
        endings = (".xdmf", "_mesh.xdmf", ".csv") if self.with_particles else (".xdmf", ".csv")
        record.files = [Path(f"{path}{end}") for end in endings]
        times, record.log = simulation.ranks.broadcast(lambda: self.open(resume))
        first = record.files[0].with_suffix(".h5")
        record.frames = Frames(first, simulation.mesh.dim, times, self.with_particles)
        if self.with_particles:
            fields = record.files[1].with_suffix(".h5")
            record.vertex_frames = Frames(fields, simulation.mesh.dim, times, False)

    def __enter__(self):
        return self

    def __exit__(self, *exc):
        for writer in (*(self.series or ()), self.log):
            if writer is not None:
                writer.close()

    def open(self, resume):
        """Open the files; returns the times of the frames and the log that are kept of older ones."""
        s, (*particles, mesh, log) = self.simulation, self.record.files
        # what belongs to the very time of the checkpoint is written again
        time, step = (s.time, s.steps) if resume else (-np.inf, None)
        self.series = [ParticleFile(path, keep_before=time) for path in particles]
        self.series.append(MeshFile(mesh, s.mesh.points, s.mesh.cells, keep_before=time))
        self.log = TimeLog(log, keep_before=step)
        return list(self.series[0].times), self.log.columns

    def beside(self, ending):
        """Path of a further file of this run."""
        return Path(f"{self.path or 'fempm'}{ending}")

    def frame(self):
        """Write a frame of particles and vertex fields, or keep it."""
        s, frames = self.simulation, self.record.frames
        if self.path is None and self.with_particles:
            frames.append((s.time, s.gather("position"), s.gather("velocity")))
            return
        on_vertices = s.vertex_fields()
        if self.path is None:
            frames.append((s.time, on_vertices))
            return
        position, fields = self.particles()

        def write():
            if self.with_particles:
                self.series[0].write(s.time, position, **fields)
            self.series[-1].write(s.time, **on_vertices)

        s.ranks.broadcast(write)
        frames.times.append(s.time)

    def row(self):
        """Add a row to the log in memory and on disk."""
        s = self.simulation
        row = s.summary()
        if self.watch is not None:
            row |= self.watch(s)
        for name, value in row.items():
            self.record.log.setdefault(name, []).append(value)
        if self.path is not None:
            s.ranks.broadcast(lambda: self.log.write(s.steps, **row))

    def particles(self):
        """Positions and fields of the particles, None where there are none. Collective."""
        if not self.with_particles:
            return None, None
        return self.simulation.gather("position"), particle_fields(self.simulation)

    def last_state(self):
        """Write the state of a failed run to a file of its own; returns its path."""
        s, path = self.simulation, self.beside("_last.xdmf")
        position, fields = self.particles()
        on_vertices = None if self.with_particles else s.vertex_fields()

        def write():
            if self.with_particles:
                with ParticleFile(path) as last:
                    last.write(s.time, position, **fields)
            else:
                with MeshFile(path, s.mesh.points, s.mesh.cells) as last:
                    last.write(s.time, **on_vertices)

        s.ranks.broadcast(write)
        return path


class Checkpoints:
    """When a run writes checkpoints: every so many seconds, at the end, and when it is told to stop."""

    def __init__(self, files, every, stop):
        self.files, self.every, self.stop = files, every, stop
        self.path = files.beside("_checkpoint.h5")
        self.due = np.inf if every is None else time.monotonic() + every

    def look(self, at_end=False):
        """Write a checkpoint if one is due; raise Interrupted if a rank was told to stop. Collective."""
        s = self.files.simulation
        due = time.monotonic() >= self.due or (at_end and self.every is not None)
        wish = s.ranks.max(2 if self.stop.received else int(due))
        if wish:
            s.save(self.path)
            self.due = np.inf if self.every is None else time.monotonic() + self.every
        if wish == 2:
            raise Interrupted(self.path, s.time, s.steps)
        if wish and self.path not in self.files.record.files:
            self.files.record.files.append(self.path)
