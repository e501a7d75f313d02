"""Many ranks: who owns which cells, sums on shared vertices, particles that change ranks.

Every rank holds the mesh and its kernel, which the first rank made: so the same numbers go into a run on
any number of ranks, and cells can change hands without moving any of it. What costs time and memory in
every step is divided: particles live on the rank that owns their cell, and a rank works on the vertices
in the rings of its occupied cells, which are its own vertices and the ghosts of a vertex-neighbour layer.
"""

import os
import sys

import numpy as np
from numba import njit

LAUNCHERS = ("OMPI_COMM_WORLD_SIZE", "PMI_SIZE", "PMIX_RANK", "SLURM_PROCID")


class RemoteError(RuntimeError):
    """An error of other ranks, raised by all that have none of their own."""


class Ranks:
    """The ranks of this program; without an MPI launcher there is one, and MPI is not even loaded."""

    def __init__(self):
        self.comm, self.rank, self.size = None, 0, 1
        if "mpi4py.MPI" in sys.modules or any(name in os.environ for name in LAUNCHERS):
            from . import compat  # noqa: F401, before MPI: see there

            # isort: split
            from mpi4py import MPI

            if MPI.COMM_WORLD.size > 1:
                self.comm, self.rank, self.size = MPI.COMM_WORLD, MPI.COMM_WORLD.rank, MPI.COMM_WORLD.size

    def sum(self, x):
        """Sum over the ranks of a number or array. Collective, as are all methods."""
        return x if self.comm is None else self.comm.allreduce(x)

    def max(self, x):
        """Largest of the ranks' numbers, of arrays entry by entry."""
        return x if self.comm is None else np.max(self.comm.allgather(x), axis=0)

    def min(self, x):
        """Least of the ranks' numbers."""
        return -self.max(-x)

    def broadcast(self, make):
        """What `make()` returns, or raises, on the first rank."""
        if self.comm is None:
            return make()
        made = error = None
        if self.rank == 0:
            try:
                made = make()
            except Exception as problem:
                error = problem
        made, error = self.comm.bcast((made, error))
        if error is not None:
            raise error
        return made

    def raise_together(self, error):
        """Raise this rank's error; a rank without one raises RemoteError with the others' message."""
        if self.max(int(error is not None)) == 0:
            return
        messages = [str(error)] if self.comm is None else self.comm.allgather(error and str(error))
        if error is None:
            raise RemoteError("on another rank: " + "; ".join(m for m in messages if m))
        raise error

    def concatenate(self, array):
        """Arrays (n, ...) of all ranks one after the other."""
        if self.comm is None:
            return array
        parts = [np.empty((n, *array.shape[1:]), array.dtype) for n in self.comm.allgather(len(array))]
        parts[self.rank] = np.ascontiguousarray(array)
        for root, part in enumerate(parts):
            if part.size:
                self.comm.Bcast(part.reshape(-1).view(np.uint8), root)
        return np.concatenate(parts)


def bisect(centres, weights, parts):
    """Owner (nc,) int32 of each cell by recursive bisection: equal weight, cut across the longest extent.

    Parameters
    ----------
    centres : (nc, d) of the cells
    weights : (nc,) work in each cell, its number of particles
    parts : number of ranks
    """
    owner = np.zeros(len(centres), np.int32)
    weights = weights + 1e-3 * weights.mean()  # so that empty regions are divided as well

    def split(cells, first, parts):
        if parts == 1 or len(cells) == 0:  # none are left beside a cell of more than half of the weight
            owner[cells] = first
            return
        occupied = cells[weights[cells] > weights.min()]
        axis = np.argmax(np.ptp(centres[occupied if len(occupied) else cells], axis=0))
        order = cells[np.argsort(centres[cells, axis], kind="stable")]
        below = np.cumsum(weights[order])
        # to the left what lies there by more than half: off by half a cell's weight at most
        middle = below - weights[order] / 2
        cut = int(np.searchsorted(middle, below[-1] * (parts // 2) / parts))
        split(order[:cut], first, parts // 2)
        split(order[cut:], first + parts // 2, parts - parts // 2)

    split(np.arange(len(centres)), 0, parts)
    return owner


class Borders:
    """The vertices that this rank shares with others, and sums over them.

    Parameters
    ----------
    ranks : Ranks
    owner : (nc,) rank that owns each cell
    ring_start, ring_vertex : see `kernel.Kernel`
    num_vertices : of the kernel, mirrors included
    """

    def __init__(self, ranks, owner, ring_start, ring_vertex, num_vertices):
        self.ranks, self.shared = ranks, {}
        if ranks.size == 1:
            return
        mine = touched(owner, ranks.rank, ring_start, ring_vertex, num_vertices)
        for other in set(range(ranks.size)) - {ranks.rank}:
            theirs = touched(owner, other, ring_start, ring_vertex, num_vertices)
            common = np.flatnonzero(mine & theirs).astype(np.int32)
            if len(common):
                self.shared[other] = common

    def add_shared(self, grid, stamp, now):
        """Add to the rows of `grid` (nv, m) that this rank uses now what the other ranks hold. Collective."""
        outgoing, incoming, requests = {}, {}, []
        for other, vertices in self.shared.items():
            incoming[other] = np.empty((len(vertices), grid.shape[1]))
            outgoing[other] = np.empty_like(incoming[other])
            pack(grid, stamp, now, vertices, outgoing[other])
            requests.append(self.ranks.comm.Irecv(incoming[other], other))
            requests.append(self.ranks.comm.Isend(outgoing[other], other))
        for request in requests:
            request.Wait()
        for other, vertices in self.shared.items():
            add(grid, stamp, now, vertices, incoming[other])


@njit(cache=True)
def touched(owner, rank, ring_start, ring_vertex, num_vertices):
    """(nv,) bool: vertices in the rings of a rank's cells."""
    out = np.zeros(num_vertices, np.bool_)
    for c in range(len(owner)):
        if owner[c] == rank:
            for j in range(ring_start[c], ring_start[c + 1]):
                out[ring_vertex[j]] = True
    return out


@njit(cache=True, nogil=True)
def pack(grid, stamp, now, vertices, out):
    """Rows of `grid` in use, zero for the others."""
    for i in range(len(vertices)):
        v = vertices[i]
        for j in range(grid.shape[1]):
            out[i, j] = grid[v, j] if stamp[v] == now else 0.0


@njit(cache=True, nogil=True)
def add(grid, stamp, now, vertices, rows):
    """Add to the rows of `grid` in use."""
    for i in range(len(vertices)):
        v = vertices[i]
        if stamp[v] == now:
            for j in range(grid.shape[1]):
                grid[v, j] += rows[i, j]


def migrate(ranks, particles, owner):
    """Send particles to the ranks that own their cells; returns how many left this rank. Collective."""
    destination = owner[particles.cell]
    leaving = np.flatnonzero(destination != ranks.rank)
    destination = destination[leaving]
    order = np.argsort(destination, kind="stable")
    rows = np.empty((len(leaving), 1 + sum(width(a) for a in particles.arrays.values())))
    rows[:, 0] = particles.body[leaving] if len(leaving) else 0
    at = 1
    for array in particles.arrays.values():  # integers below 2^53 survive in float64
        rows[:, at : at + width(array)] = array[leaving].reshape(len(leaving), width(array))
        at += width(array)
    rows = rows[order]
    outgoing = np.bincount(destination, minlength=ranks.size)
    incoming = np.empty_like(outgoing)
    ranks.comm.Alltoall(outgoing, incoming)
    received = np.empty((incoming.sum(), rows.shape[1]))
    requests, begin, end = [], np.cumsum(outgoing) - outgoing, np.cumsum(incoming) - incoming
    for other in range(ranks.size):
        if incoming[other]:
            part = received[end[other] : end[other] + incoming[other]]
            requests.append(ranks.comm.Irecv(part, other))
        if outgoing[other]:
            part = rows[begin[other] : begin[other] + outgoing[other]]
            requests.append(ranks.comm.Isend(part, other))
    for request in requests:
        request.Wait()
    if len(leaving) or len(received):
        arrivals, at = {}, 1
        for name, array in particles.arrays.items():
            columns = received[:, at : at + width(array)]
            arrivals[name] = columns.reshape(len(received), *array.shape[1:]).astype(array.dtype)
            at += width(array)
        particles.replace(leaving, arrivals, received[:, 0].astype(int))
    return len(leaving)


def width(array):
    """Numbers per particle."""
    return int(np.prod(array.shape[1:]))
