"""Checkpoints: the state of a simulation in one HDF5 file, to go on from later, on any number of ranks."""

import dataclasses
import hashlib
import json
import os
import re
from pathlib import Path

import h5py
import numpy as np

from . import boundaries
from .parallel import Borders, bisect

FORMAT, VERSION = "fempm checkpoint", 1
COUNTERS = ("dropped_vertices", "lost_momentum", "wall_hits", "escaped_mass")  # of each rank


class CheckpointError(ValueError):
    """A file that is no checkpoint, or that of another scene."""


def save_checkpoint(simulation, path):
    """Write the state of a simulation to an HDF5 file, which is there as a whole or not at all. Collective.

    Parameters
    ----------
    simulation : Simulation
    path : file to write or replace; missing folders are made

    Raises
    ------
    OSError
        on all ranks, if the first one cannot write
    """
    with storing(simulation, path, fingerprint(simulation)) as store:
        store_particles(simulation, store)


def store_particles(simulation, store):
    """Write the particles with an open `storing`. Collective."""
    p = simulation.particles
    simulation.ranks.broadcast(lambda: append(store.part, "owner", simulation.owner))
    store("counts", np.array([p.counts]))
    for name in COUNTERS:
        store(f"counters/{name}", np.array([getattr(simulation, name)]))
    for name, array in p.arrays.items():
        store(f"particles/{name}", array)


class storing:
    """Context that writes a checkpoint, all of it or none: call it with a name and each rank's array.

    Parameters
    ----------
    simulation : anything with ranks, time, dt and steps
    path : file to write or replace
    scene : name -> text, what a simulation that takes it up must have in common
    """

    def __init__(self, simulation, path, scene):
        self.simulation, self.ranks, self.path, self.scene = simulation, simulation.ranks, path, scene
        self.part = Path(f"{path}.part")

    def __enter__(self):
        try:
            self.ranks.broadcast(self.begin)
        except Exception:
            self.remove()
            raise
        return self

    def __call__(self, name, array):
        whole = self.ranks.concatenate(array)
        self.ranks.broadcast(lambda: append(self.part, name, whole))

    def __exit__(self, kind, *exc):
        try:
            if kind is None:
                self.ranks.broadcast(lambda: os.replace(self.part, self.path))
        finally:
            self.remove()

    def begin(self):
        """Start the file with what all ranks have in common."""
        s = self.simulation
        self.part.parent.mkdir(parents=True, exist_ok=True)
        with h5py.File(self.part, "w", locking=False) as file:
            file.attrs.update(format=FORMAT, version=VERSION)
            file.attrs.update(time=s.time, dt=s.dt, steps=s.steps)
            file["scene"] = json.dumps(self.scene)

    def remove(self):
        """Remove what was not finished."""
        if self.ranks.rank == 0:
            self.part.unlink(missing_ok=True)


def append(path, name, array):
    """Add one array to the file."""
    with h5py.File(path, "r+", locking=False) as file:
        file[name] = array


def fingerprint(simulation):
    """What a checkpoint and the scene that goes on from it must have in common: name -> text."""
    bodies = simulation.bodies
    return mesh_fingerprint(simulation.mesh) | {
        "bodies": ", ".join(f"{b.name!r} of {len(b.position)} particles" for b in bodies),
        "materials": ", ".join(describe(b.material) for b in bodies),
        "transfer": simulation.transfer,
        "arrays of the particles": ", ".join(sorted(simulation.particles.arrays)),
    }


def mesh_fingerprint(mesh):
    """The part of a fingerprint that tells meshes apart."""
    digest = hashlib.sha256()
    digest.update(mesh.points.tobytes())
    digest.update(mesh.cells.tobytes())
    return {
        "dimension": str(mesh.dim),
        "mesh": f"{len(mesh.cells)} cells, SHA-256 {digest.hexdigest()[:16]}",
    }


def describe(material):
    """A material and its parameters, without the addresses of functions, which differ between runs."""
    if dataclasses.is_dataclass(material):
        return re.sub(" at 0x[0-9a-f]+", "", repr(material))
    return type(material).__name__


def load_checkpoint(simulation, path):
    """Take up the state of a checkpoint. Collective.

    On the number of ranks that wrote it, the simulation goes on bit by bit as that one did; on another
    number, to round-off.

    Parameters
    ----------
    simulation : Simulation of the same scene
    path : file that `save_checkpoint` wrote; every rank reads it

    Raises
    ------
    CheckpointError
        on all ranks, if the file is damaged, no checkpoint, or that of another scene: it names what
        differs. The simulation is as it was before.
    FileNotFoundError
        if there is no such file
    """
    take_up(
        simulation, **read(simulation.ranks, path, fingerprint(simulation), lambda f: needed(simulation, f))
    )


def read(ranks, path, scene, needed):
    """What `needed` returns of the open checkpoint of a scene, CheckpointError on all ranks. Collective."""
    found = problem = None
    try:
        if not Path(path).is_file():
            raise FileNotFoundError(f"checkpoint {path} does not exist")
        with h5py.File(path, "r", locking=False) as file:
            check(file, scene, path)
            found = needed(file)
    except (CheckpointError, FileNotFoundError) as error:
        problem = error
    except Exception as error:  # whatever HDF5 makes of damaged files
        problem = CheckpointError(f"{path} cannot be read as a checkpoint: {error}")
        problem.__cause__ = error
    ranks.raise_together(problem)
    return found


def clock(file):
    """Time, last step and number of steps in a checkpoint, name -> number."""
    return {name: file.attrs[name].item() for name in ("time", "dt", "steps")}


def needed(simulation, file):
    """What this rank needs of a checkpoint, the arguments of `take_up`; the simulation is not changed."""
    counts = file["counts"][()]
    owner, rows, mine = share(file, simulation, counts)
    state = {"scalars": clock(file), "owner": owner, "counts": mine, "arrays": {}}
    for name in COUNTERS:
        values = file[f"counters/{name}"][()]
        state["scalars"][name] = own(values, simulation.ranks).item()
    for name, here in simulation.particles.arrays.items():
        stored = file[f"particles/{name}"]
        if stored.shape != (counts.sum(), *here.shape[1:]) or stored.dtype != here.dtype:
            raise CheckpointError(f"{file.filename}: particles/{name} is {stored.dtype} {stored.shape}")
        state["arrays"][name] = stored[rows] if isinstance(rows, slice) else stored[()][rows]
    return state


def check(file, scene, path):
    """Raise a CheckpointError unless the file is a checkpoint of this scene."""
    if file.attrs.get("format") != FORMAT:
        raise CheckpointError(f"{path} is no checkpoint of fempm")
    version = file.attrs["version"]
    if version != VERSION:
        raise CheckpointError(f"{path}: checkpoint of format version {version}, this fempm reads {VERSION}")
    there = json.loads(file["scene"].asstr()[()])
    other = [
        f"{name}: {there.get(name)}, here {text}" for name, text in scene.items() if there.get(name) != text
    ]
    if other:
        raise CheckpointError(f"{path} is the checkpoint of another scene; " + "; ".join(other))


def share(file, simulation, counts):
    """Owners of the cells, and which rows of the particle arrays, how many per body, are this rank's."""
    ranks, mesh = simulation.ranks, simulation.mesh
    if len(counts) == ranks.size:
        begin = int(counts[: ranks.rank].sum())
        mine = counts[ranks.rank].tolist()
        return file["owner"][()], slice(begin, begin + sum(mine)), mine
    cell, number = file["particles/cell"][()], file["particles/id"][()]
    centres = mesh.points[mesh.cells].mean(axis=1)
    owner = bisect(centres, np.bincount(cell, minlength=len(mesh.cells)), ranks.size)
    body = np.repeat(np.tile(np.arange(counts.shape[1]), len(counts)), counts.ravel())
    rows = np.flatnonzero(owner[cell] == ranks.rank)
    rows = rows[np.lexsort((number[rows], cell[rows], body[rows]))]
    return owner, rows, np.bincount(body[rows], minlength=counts.shape[1]).tolist()


def own(values, ranks):
    """This rank's value of a counter; on another number of ranks the first one has the sum."""
    if len(values) == ranks.size:
        return values[ranks.rank]
    return values.sum() if ranks.rank == 0 else values[0] * 0


def take_up(simulation, scalars, owner, counts, arrays):
    """Put the state read from a checkpoint in the place of the present one. Collective."""
    s, p = simulation, simulation.particles
    boundaries.wall_motion(s, 0.0)  # before the number of steps says that the first one made it
    rings = (s.kernel.ring_start, s.kernel.ring_vertex)
    s.owner, s.borders = owner, Borders(s.ranks, owner, *rings, len(s.kernel.points))
    if sum(counts) > len(p.stored["mass"]):
        p.reserve(sum(counts) + sum(counts) // 4 + 64)
    p.set_counts(counts)
    for name, array in arrays.items():
        p.arrays[name][:] = array
    vars(s).update(scalars)
    s.num_particles = s.ranks.sum(len(p))
    s.stamp[:] = -1  # marks of other steps than the one taken up
    s.sort_particles()
    s.find_contacts()
