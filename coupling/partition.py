"""The share of a space that one MPI rank works on, and sums over what it has in common with others."""

import dataclasses

import numpy as np

from fempm.parallel import bisect

from . import pressure


class Part:
    """The cells of one rank, the nodes and pressure dofs they touch, and each edge on one rank only.

    What a node gets from cells and edges is summed over the ranks that share it, so each of them has the
    whole of it. With one rank it is the space itself.

    Parameters
    ----------
    whole : Space
    ranks : fempm.parallel.Ranks

    Attributes
    ----------
    space : Space of this rank, numbered locally; volumes and areas are those of the whole
    nodes : (n,) number of each local node in the whole
    owned : local pressure dofs that are unknowns of this rank
    mine : (n,) bool, nodes that count for this rank in sums over all nodes
    size, shape : tuples whose lengths tell the kernels d, and (pressures, nodes, d) per cell
    pairs : nodes, dofs and |int chi_q grad phi_b|^2 of all pairs that touch
    """

    def __init__(self, whole, ranks):
        self.ranks, self.whole = ranks, whole
        owner = np.zeros(len(whole.cell_nodes), np.int32)
        if ranks.size > 1:
            centres = np.zeros((len(owner), whole.dim))
            for column in whole.cell_nodes.T:
                centres += whole.points[column] / whole.cell_nodes.shape[1]
            owner = bisect(centres, np.ones(len(owner)), ranks.size)
        self.cells = np.flatnonzero(owner == ranks.rank)
        self.nodes = np.unique(whole.cell_nodes[self.cells])
        self.dofs = np.unique(whole.cell_pressures[self.cells])
        self.space = whole if ranks.size == 1 else self.restrict(whole, owner)
        first_nodes, self.node_borders = self.borders(whole.cell_nodes, self.nodes, owner)
        first_dofs, self.dof_borders = self.borders(whole.cell_pressures, self.dofs, owner)
        self.mine = first_nodes == ranks.rank
        self.owned = slice(None) if ranks.size == 1 else np.flatnonzero(first_dofs == ranks.rank)
        self.num_owned = int(np.count_nonzero(first_dofs == ranks.rank))
        d = whole.dim
        self.size = (1,) * d
        self.shape = ((1,) * whole.cell_pressures.shape[1], (1,) * whole.cell_nodes.shape[1], self.size)
        self.pairs = self.touching_pairs()

    def restrict(self, whole, owner):
        """The space of this rank's cells and edges."""
        local = np.full(len(whole.points), -1, np.int32)
        local[self.nodes] = np.arange(len(self.nodes))
        dof = np.full(len(whole.pressure_volumes), -1, np.int32)
        dof[self.dofs] = np.arange(len(self.dofs))
        edges = self.owned_edges(whole, owner)
        return dataclasses.replace(
            whole,
            points=whole.points[self.nodes],
            volumes=whole.volumes[self.nodes],
            edges=local[whole.edges[edges]],
            vectors=whole.vectors[edges],
            forward=whole.forward[edges],
            backward=whole.backward[edges],
            cell_nodes=local[whole.cell_nodes[self.cells]],
            cell_pressures=dof[whole.cell_pressures[self.cells]],
            pressure_volumes=whole.pressure_volumes[self.dofs],
            coefficients=whole.coefficients[self.cells],
            cell_volumes=whole.cell_volumes[self.cells],
        )

    def owned_edges(self, whole, owner):
        """Edges whose first cell, in the order of the mesh, is this rank's."""
        a, b = np.triu_indices(whole.cell_nodes.shape[1], 1)
        ends = np.stack([whole.cell_nodes[:, a].ravel(), whole.cell_nodes[:, b].ravel()], axis=1)
        ends = np.sort(ends, axis=1).astype(np.int64) @ [len(whole.points), 1]
        keys, first = np.unique(ends, return_index=True)
        owners = np.repeat(owner, len(a))[first]
        edges = np.sort(whole.edges, axis=1).astype(np.int64) @ [len(whole.points), 1]
        return np.flatnonzero(owners[np.searchsorted(keys, edges)] == self.ranks.rank)

    def borders(self, entries, mine, owner):
        """Lowest rank that has each of my entries, and which of them I share with each other rank."""
        lowest = np.full(len(mine), self.ranks.size, np.int32)
        shared = {}
        for rank in range(self.ranks.size):
            theirs = np.isin(mine, entries[owner == rank]) if self.ranks.size > 1 else slice(None)
            lowest[theirs] = np.minimum(lowest[theirs], rank)
            if rank != self.ranks.rank and np.any(theirs):
                shared[rank] = np.flatnonzero(theirs)
        return lowest, shared

    def touching_pairs(self):
        """See `pairs`."""
        s = self.space
        nb, nq = s.cell_nodes.shape[1], s.cell_pressures.shape[1]
        nodes = np.tile(s.cell_nodes[:, None, :], (1, nq, 1)).ravel().astype(np.int64)
        dofs = np.tile(s.cell_pressures[:, :, None], (1, 1, nb)).ravel().astype(np.int64)
        keys, place = np.unique(dofs * len(s.points) + nodes, return_inverse=True)
        flat = s.coefficients.reshape(-1, s.dim)
        squares = sum(np.bincount(place.ravel(), flat[:, a], len(keys)) ** 2 for a in range(s.dim))
        return keys % len(s.points), keys // len(s.points), squares

    def find(self, nodes):
        """Local numbers of nodes (k,) of the whole, and which of them this rank has, (k,) bool."""
        if self.ranks.size == 1:
            return nodes, np.ones(len(nodes), bool)
        at = np.searchsorted(self.nodes, nodes)
        at[at == len(self.nodes)] = 0
        return at, self.nodes[at] == nodes

    def sum_nodes(self, array):
        """Add what the other ranks hold for my nodes to `array` (n, ...), in place. Collective."""
        return self.add_borders(array, self.node_borders)

    def sum_dofs(self, array):
        """The same for pressure dofs."""
        return self.add_borders(array, self.dof_borders)

    def add_borders(self, array, borders):
        if self.ranks.size == 1:
            return array
        requests, incoming, outgoing = [], {}, {}
        for other, entries in borders.items():
            outgoing[other] = array[entries]
            incoming[other] = np.empty_like(outgoing[other])
            requests.append(self.ranks.comm.Irecv(incoming[other], other))
            requests.append(self.ranks.comm.Isend(outgoing[other], other))
        for request in requests:
            request.Wait()
        for other, entries in borders.items():
            array[entries] += incoming[other]
        return array

    def spread(self, values):
        """Pressures (nq,) of all my dofs from those that are my unknowns. Collective."""
        if self.ranks.size == 1:
            return values
        out = np.zeros(len(self.dofs))
        out[self.owned] = values
        return self.sum_dofs(out)

    def local(self, array):
        """Array (n, ...) of the whole at my nodes; with one rank the array itself."""
        return array if self.ranks.size == 1 else array[self.nodes]

    def gather(self, array):
        """Array (n, ...) of the whole, on all ranks; with one rank the array itself. Collective."""
        if self.ranks.size == 1:
            return array
        out = np.empty((len(self.whole.points), *array.shape[1:]))
        numbers = self.ranks.concatenate(self.nodes[self.mine])
        out[numbers] = self.ranks.concatenate(array[self.mine])
        return out

    def gather_dofs(self, values):
        """Values (nq,) of the pressure dofs of the whole, on all ranks. Collective."""
        if self.ranks.size == 1:
            return values
        out = np.empty(len(self.whole.pressure_volumes))
        out[self.ranks.concatenate(self.dofs[self.owned])] = self.ranks.concatenate(values[self.owned])
        return out

    def total(self, array):
        """Sum over all nodes of m_i times `array` (n, ...). Collective."""
        s = self.space
        return self.ranks.sum(np.tensordot(s.volumes[self.mine], array[self.mine], 1))

    def pressure_force(self, values, out):
        """`out` (n, d) = A P. Collective."""
        s = self.space
        pressure.pressure_force(self.shape, s.cell_nodes, s.cell_pressures, s.coefficients, values, out)
        return self.sum_nodes(out)

    def divergence(self, velocity, out):
        """`out` (nq,) = A^T u. Collective."""
        s = self.space
        out[:] = 0.0
        pressure.add_divergence(self.shape, s.cell_nodes, s.cell_pressures, s.coefficients, velocity, out)
        return self.sum_dofs(out)

    def work(self, values, velocity):
        """(n,) energy that the pressure carries to each node, per time. Collective."""
        s, out = self.space, np.zeros(len(self.nodes))
        pressure.add_work(
            self.shape, s.cell_nodes, s.cell_pressures, s.coefficients, s.weights, values, velocity, out
        )
        return self.sum_nodes(out)

    def means(self, density, first, second):
        """(nq,) mass-weighted means of two nodal fields (n,) over the pressure functions. Collective."""
        s, out = self.space, np.zeros((len(self.dofs), 3))
        lists = s.cell_nodes, s.cell_pressures
        pressure.add_means(self.shape, *lists, s.weights, s.cell_volumes, density, first, second, out)
        mass, one, other = self.sum_dofs(out).T
        return one / mass, other / mass
