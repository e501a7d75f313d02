"""Material points: bodies to start from, ways to fill them, and the arrays of a running simulation."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from .plasticity import volume_ratio
from .simplex import simplex_points


@dataclass
class Body:
    """A body of one material.

    Attributes
    ----------
    position : (n, d) particle positions
    volume : (n,) volumes now, or one number for all
    material : see `fempm.materials`
    velocity : (d,) or a function of positions (n, d) -> (n, d)
    deformation_gradient : (d, d), (n, d, d) or None for the undeformed state
    name : used in messages and output
    f_bar : average volume changes over the kernel in every step, against locking of nearly
        incompressible materials (F-bar, see `solver.average_jacobian`)
    """

    position: np.ndarray
    volume: np.ndarray | float
    material: object
    velocity: np.ndarray | Callable | float = 0.0
    deformation_gradient: np.ndarray | None = None
    name: str = "body"
    f_bar: bool = False

    def __post_init__(self):
        self.position = np.atleast_2d(np.asarray(self.position, float))
        n, d = self.position.shape
        if self.position.size == 0:
            raise ValueError(f"body {self.name!r} has no particles")
        self.volume = np.broadcast_to(np.asarray(self.volume, float), n)
        if not self.volume.min() > 0:
            p = int(np.argmin(self.volume))
            raise ValueError(
                f"body {self.name!r}: particle {p} has volume {self.volume[p]}, it must be positive"
            )
        v = self.velocity(self.position) if callable(self.velocity) else self.velocity
        if np.shape(v) not in ((), (d,), (n, d)):
            raise ValueError(
                f"body {self.name!r}: velocity of shape {np.shape(v)}, give ({d},) or ({n}, {d})"
            )
        self.velocity = np.broadcast_to(np.asarray(v, float), (n, d))
        unset = np.flatnonzero(~np.isfinite(self.velocity).all(axis=1))
        if len(unset):
            raise ValueError(
                f"body {self.name!r}: particle {unset[0]} at {self.position[unset[0]]} has velocity "
                f"{self.velocity[unset[0]]}"
            )
        f = np.eye(d) if self.deformation_gradient is None else self.deformation_gradient
        self.deformation_gradient = np.broadcast_to(np.asarray(f, float), (n, d, d))
        j = np.linalg.det(self.deformation_gradient)
        if not j.min() > 0:
            p = int(np.argmin(j))
            raise ValueError(
                f"body {self.name!r}: particle {p} starts inverted, det F = {j[p]}: check its deformation"
            )


class Particles:
    """Arrays of the particles of this rank; those of one body are contiguous.

    Particles are moved in memory from time to time, to the order of their cells and, on many ranks, to
    the rank that owns their cell: `id` tells who is who, see also `Simulation.gather`.

    Attributes
    ----------
    position, velocity : (n, d)
    mass, volume : (n,) mass and initial volume V0
    deformation_gradient, stress : (n, d, d) F, of plastic bodies its elastic part, and the Kirchhoff
        stress tau = J sigma
    affine : (n, d, d) matrix B of APIC, length 0 for the other transfers
    cell : (n,) int32 cell that holds each particle
    id : (n,) int64 number of each particle, counted through the bodies as they were given
    state : dict name -> (n, ...) internal variables of materials and contact
    ranges : list of slices, one per body
    """

    def __init__(self, arrays, counts):
        d = arrays["position"].shape[1]
        self.affine = np.zeros((0, d, d))
        self.stored = arrays  # with room for more; the attributes are views of the part in use
        self.set_counts(counts)

    def set_counts(self, counts):
        """Let the first counts[0] particles be those of the first body, and so on."""
        ends = np.cumsum([0, *counts]).tolist()
        self.ranges = [slice(a, b) for a, b in zip(ends[:-1], ends[1:], strict=True)]
        self.arrays = {name: array[: ends[-1]] for name, array in self.stored.items()}
        self.state = {}
        for name, view in self.arrays.items():
            if name.startswith("state/"):
                self.state[name.removeprefix("state/")] = view
            else:
                setattr(self, name, view)

    def __len__(self):
        return len(self.mass)

    @property
    def counts(self):
        """Number of particles of each body."""
        return [part.stop - part.start for part in self.ranges]

    @property
    def body(self):
        """(n,) int32 number of each particle's body."""
        return np.repeat(np.arange(len(self.ranges), dtype=np.int32), self.counts)

    @property
    def jacobian(self):
        """(n,) J = V / V0, with what plastic bodies keep outside of F (see `plasticity`)."""
        return volume_ratio(self.deformation_gradient, **self.state)

    @property
    def cauchy_stress(self):
        """(n, d, d) sigma = tau / J."""
        return self.stress / self.jacobian[:, None, None]

    def add_state(self, name, shape):
        """Give the particles an internal variable, zero at first."""
        have = self.stored.get(f"state/{name}")
        if have is not None and have.shape[1:] != tuple(shape):
            raise ValueError(f"internal variable {name!r} has shapes {have.shape[1:]} and {tuple(shape)}")
        if have is None:
            self.stored[f"state/{name}"] = np.zeros((len(self.stored["mass"]), *shape))
            self.set_counts(self.counts)

    def reserve(self, capacity):
        """Make room for that many particles, and no more."""
        for name, array in self.stored.items():
            copy = np.zeros((capacity, *array.shape[1:]), array.dtype)
            n = min(capacity, len(array))
            copy[:n] = array[:n]
            self.stored[name] = copy
        self.set_counts(self.counts)

    def sort_by_cell(self):
        """Bring the particles of each body into the order of their cells, for the sake of caches."""
        for part in self.ranges:
            order = np.argsort(self.cell[part], kind="stable")
            if np.any(order[1:] < order[:-1]):
                for array in self.arrays.values():
                    array[part] = array[part][order]

    def replace(self, leaving, arrivals, bodies):
        """Remove some particles and add others, moving no more of the rest than there are changes.

        Parameters
        ----------
        leaving : (m,) their indices, ascending
        arrivals : dict name -> (k, ...) as in `arrays`
        bodies : (k,) body of each arrival
        """
        begin = [part.start for part in self.ranges]
        kept = [self._close_gaps(part, leaving) for part in self.ranges]
        added = np.bincount(bodies, minlength=len(kept)).tolist()
        counts = [k + a for k, a in zip(kept, added, strict=True)]
        if sum(counts) > len(self.stored["mass"]):
            self.reserve(sum(counts) + sum(counts) // 4 + 64)
        target = np.cumsum([0, *counts[:-1]]).tolist()
        bodies_here = range(len(kept))
        for b in bodies_here:  # blocks that move to the front, first to last: the end of each goes before it
            if target[b] < begin[b]:
                shift = min(begin[b] - target[b], kept[b])
                self._move(begin[b] + kept[b] - shift, target[b], shift)
        for b in reversed(bodies_here):  # then the others, last to first: the start of each goes behind it
            if target[b] > begin[b]:
                shift = min(target[b] - begin[b], kept[b])
                self._move(begin[b], target[b] + kept[b] - shift, shift)
        self.set_counts(counts)
        for b in bodies_here:
            free = slice(target[b] + kept[b], target[b] + counts[b])
            for name, array in arrivals.items():
                self.arrays[name][free] = array[bodies == b]

    def _close_gaps(self, part, leaving):
        """Fill the places of the leaving particles of a body from its end; returns how many stay."""
        gone = leaving[(leaving >= part.start) & (leaving < part.stop)]
        end = part.stop - len(gone)
        holes = gone[gone < end]
        last = np.setdiff1d(np.arange(end, part.stop), gone)
        for array in self.stored.values():
            array[holes] = array[last]
        return end - part.start

    def _move(self, source, target, count):
        for array in self.stored.values():
            array[target : target + count] = array[source : source + count]


def join_bodies(bodies, dim, apic):
    """Particles of all bodies; the cells are still to be found."""
    if not bodies:
        raise ValueError("a simulation needs at least one body")
    for body in bodies:
        if body.position.shape[1] != dim:
            raise ValueError(f"body {body.name!r} has {body.position.shape[1]} coordinates, the mesh {dim}")

    def join(arrays):  # in C order, which np.concatenate does not keep where one value was broadcast
        return np.ascontiguousarray(np.concatenate(arrays))

    counts = [len(body.position) for body in bodies]
    f = join([b.deformation_gradient for b in bodies])
    volume = np.concatenate([b.volume for b in bodies]) / np.linalg.det(f)
    n = len(volume)
    arrays = {
        "position": join([b.position for b in bodies]),
        "velocity": join([b.velocity for b in bodies]),
        "mass": np.repeat([float(b.material.density) for b in bodies], counts) * volume,
        "volume": volume,
        "deformation_gradient": f,
        "stress": np.zeros((n, dim, dim)),
        "cell": np.zeros(n, np.int32),
        "id": np.arange(n),
    }
    if apic:
        arrays["affine"] = np.zeros((n, dim, dim))
    particles = Particles(arrays, counts)
    for body in bodies:
        for name, shape in getattr(body.material, "state", {}).items():
            particles.add_state(name, shape)
    return particles


def fill_box(lower, upper, spacing):
    """Particles on a lattice in a box.

    Parameters
    ----------
    lower, upper : (d,) corners
    spacing : wanted distance; the lattice takes the nearest one that divides the box

    Returns
    -------
    position : (n, d), volume : (n,)
    """
    lower, upper = np.atleast_1d(lower).astype(float), np.atleast_1d(upper).astype(float)
    if not spacing > 0 or not np.all(upper > lower):
        raise ValueError(f"box {lower} to {upper}, spacing {spacing}: both must be positive")
    count = np.maximum(1, np.round((upper - lower) / spacing).astype(int))
    step = (upper - lower) / count
    axes = [a + s * (np.arange(n) + 0.5) for a, s, n in zip(lower, step, count, strict=True)]
    position = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(lower))
    return position, np.full(len(position), step.prod())


def fill_cells(mesh, per_cell, inside=None, region=None):
    """Particles in the cells of a mesh, equal shares of the cell's volume each.

    Parameters
    ----------
    mesh : SimplexMesh, a body mesh or the background mesh
    per_cell : particles per cell; powers of 2^d are the centroids of equal parts of the cell, other
        numbers a quasi-random sequence
    inside : function of positions (n, d) -> (n,) bool that selects particles, all when not given
    region : name of a region of the mesh to fill, see `SimplexMesh.regions`

    Returns
    -------
    position : (n, d), volume : (n,)
    """
    if region is not None and region not in mesh.regions:
        raise KeyError(f"unknown region {region!r}: this mesh has {sorted(mesh.regions)}")
    chosen = slice(None) if region is None else mesh.regions[region]
    rule = simplex_points(mesh.dim, per_cell)
    position = np.einsum("pq,cqd->cpd", rule, mesh.points[mesh.cells[chosen]]).reshape(-1, mesh.dim)
    volume = np.repeat(mesh.volumes[chosen] / per_cell, per_cell)
    if inside is not None:
        chosen = np.asarray(inside(position), bool)
        if chosen.shape != volume.shape:
            raise ValueError(f"inside returns shape {chosen.shape} for {len(volume)} positions (n, d)")
        position, volume = position[chosen], volume[chosen]
    return np.ascontiguousarray(position), volume
