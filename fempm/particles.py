"""Material points: bodies to start from, ways to fill them, and the arrays of a running simulation."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

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
    """

    position: np.ndarray
    volume: np.ndarray | float
    material: object
    velocity: np.ndarray | Callable | float = 0.0
    deformation_gradient: np.ndarray | None = None
    name: str = "body"

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


@dataclass
class Particles:
    """Arrays of all particles; those of one body are contiguous, and their order never changes.

    Attributes
    ----------
    position, velocity : (n, d)
    mass, volume : (n,) mass and initial volume V0
    deformation_gradient, stress : (n, d, d) F and the Kirchhoff stress tau = J sigma
    affine : (n, d, d) matrix B of APIC, length 0 for the other transfers
    cell : (n,) int32 cell that holds each particle
    ranges : list of slices, one per body
    """

    position: np.ndarray
    velocity: np.ndarray
    mass: np.ndarray
    volume: np.ndarray
    deformation_gradient: np.ndarray
    stress: np.ndarray
    affine: np.ndarray
    cell: np.ndarray
    ranges: list

    def __len__(self):
        return len(self.mass)

    @property
    def cauchy_stress(self):
        """(n, d, d) sigma = tau / det F."""
        return self.stress / np.linalg.det(self.deformation_gradient)[:, None, None]

    @property
    def body(self):
        """(n,) int32 number of each particle's body."""
        return np.repeat(np.arange(len(self.ranges), dtype=np.int32), [r.stop - r.start for r in self.ranges])


def join_bodies(bodies, dim, apic):
    """Particles of all bodies; the cells are still to be found."""
    if not bodies:
        raise ValueError("a simulation needs at least one body")
    for body in bodies:
        if body.position.shape[1] != dim:
            raise ValueError(f"body {body.name!r} has {body.position.shape[1]} coordinates, the mesh {dim}")

    def join(arrays):  # in C order, which np.concatenate does not keep where one value was broadcast
        return np.ascontiguousarray(np.concatenate(arrays))

    count = np.cumsum([0] + [len(b.position) for b in bodies])
    f = join([b.deformation_gradient for b in bodies])
    volume = np.concatenate([b.volume for b in bodies]) / np.linalg.det(f)
    density = np.repeat([b.material.density for b in bodies], np.diff(count))
    n = len(volume)
    return Particles(
        join([b.position for b in bodies]),
        join([b.velocity for b in bodies]),
        density * volume,
        volume,
        f,
        np.zeros((n, dim, dim)),
        np.zeros((n if apic else 0, dim, dim)),
        np.zeros(n, np.int32),
        [slice(int(a), int(b)) for a, b in zip(count[:-1], count[1:], strict=True)],
    )


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
