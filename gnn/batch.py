"""Graphs of several meshes as one disjoint graph of torch tensors, on all levels of their hierarchies."""

from dataclasses import dataclass

import numpy as np
import torch

from .hierarchy import contact_levels


@dataclass
class LevelGraph:
    """One level: directed edges, both ways, in the order of their receivers, and the way to the next one.

    Attributes
    ----------
    senders, receivers : (E,) int64
    num_nodes : int
    down : rows, columns, values of the contribution table to the next level; None on the last one
    kept : (m,) nodes that the next level has; None on the last one
    contact : senders and receivers of the contact edges, or None
    """

    senders: torch.Tensor
    receivers: torch.Tensor
    num_nodes: int
    down: tuple | None
    kept: torch.Tensor | None
    contact: tuple | None = None

    @property
    def ends(self):
        """Senders and receivers of the mesh's edges, and of the contact edges where there are some."""
        return [(self.senders, self.receivers)] + ([] if self.contact is None else [self.contact])


@dataclass
class GraphBatch:
    """Disjoint union of graphs.

    Attributes
    ----------
    levels : list of LevelGraph, the finest first
    node_type : (N,) int64
    material : (N, d) float32 positions in the undeformed mesh
    world : (N, d) float32 positions now, or None for fields on meshes at rest
    graph_of_node : (N,) int64
    """

    levels: list
    node_type: torch.Tensor
    material: torch.Tensor
    world: torch.Tensor | None
    graph_of_node: torch.Tensor

    def to(self, device):
        """The same on a device."""

        def move(value):
            if isinstance(value, torch.Tensor):
                return value.to(device, non_blocking=True)
            return tuple(map(move, value)) if isinstance(value, tuple) else value

        levels = [LevelGraph(*(move(v) for v in vars(level).values())) for level in self.levels]
        rest = (move(v) for name, v in vars(self).items() if name != "levels")
        return GraphBatch(levels, *rest)


def both_ways(edges):
    """Senders and receivers (2 ne,) of undirected edges (ne, 2), in the order of the receivers."""
    senders, receivers = np.concatenate([edges, edges[:, ::-1]]).T
    order = np.lexsort((senders, receivers))
    return senders[order].astype(np.int64), receivers[order].astype(np.int64)


def level_tensors(hierarchy):
    """The levels of a mesh's hierarchy as LevelGraphs; made once for a mesh."""
    out = []
    for level in hierarchy.levels:
        senders, receivers = map(torch.from_numpy, both_ways(level.edges))
        down = kept = None
        if level.kept is not None:
            table = level.transfer.tocoo()
            indices = (torch.from_numpy(k.astype(np.int64)) for k in (table.row, table.col))
            down = *indices, torch.from_numpy(table.data.astype(np.float32))
            kept = torch.from_numpy(level.kept.astype(np.int64))
        out.append(LevelGraph(senders, receivers, level.num_nodes, down, kept))
    return out


def single(graph, hierarchy, levels=None, world=None, contact=None):
    """GraphBatch of one mesh.

    Parameters
    ----------
    graph : MeshGraph
    hierarchy : Hierarchy of its edges
    levels : what `level_tensors` makes of it, to save the work
    world : (n, d) positions now
    contact : (nce, 2) contact edges of the mesh, taken to all levels
    """
    levels = levels or level_tensors(hierarchy)
    if contact is not None:
        pairs = [tuple(map(torch.from_numpy, both_ways(e))) for e in contact_levels(hierarchy, contact)]
        levels = [LevelGraph(**(vars(a) | {"contact": b})) for a, b in zip(levels, pairs)]
    n = len(graph.points)
    world = None if world is None else torch.as_tensor(np.asarray(world, np.float32))
    material = torch.from_numpy(graph.points.astype(np.float32))
    types = torch.from_numpy(graph.node_type.astype(np.int64))
    return GraphBatch(levels, types, material, world, torch.zeros(n, dtype=torch.int64))


def join(batches):
    """Disjoint union of GraphBatches; hierarchies that end earlier keep their last nodes alone below."""
    if len(batches) == 1:
        return batches[0]
    depth = max(len(b.levels) for b in batches)
    levels = [join_levels([level_or_copy(b, l, l < depth - 1) for b in batches]) for l in range(depth)]
    worlds = [b.world for b in batches]
    numbers = torch.arange(len(batches)).repeat_interleave(torch.tensor([len(b.node_type) for b in batches]))
    return GraphBatch(
        levels,
        torch.cat([b.node_type for b in batches]),
        torch.cat([b.material for b in batches]),
        None if worlds[0] is None else torch.cat(worlds),
        numbers,
    )


def level_or_copy(batch, l, goes_on):
    """Level l of a batch; where it has no further one, its last, which hands its nodes down as they are."""
    level = batch.levels[min(l, len(batch.levels) - 1)]
    if level.kept is None and goes_on:
        every = torch.arange(level.num_nodes)
        level = LevelGraph(**(vars(level) | {"down": (every, every, torch.ones(len(every))), "kept": every}))
    return level


def join_levels(parts):
    """One LevelGraph of several."""
    starts = np.cumsum([0] + [p.num_nodes for p in parts[:-1]]).tolist()

    def shifted(get, offsets=starts):
        return torch.cat([get(p) + k for p, k in zip(parts, offsets)])

    down = kept = contact = None
    if parts[0].kept is not None:
        kept = shifted(lambda p: p.kept)
        coarse = np.cumsum([0] + [len(p.kept) for p in parts[:-1]]).tolist()
        columns = shifted(lambda p: p.down[1], coarse)
        down = shifted(lambda p: p.down[0]), columns, torch.cat([p.down[2] for p in parts])
    if parts[0].contact is not None:
        contact = tuple(shifted(lambda p, k=k: p.contact[k]) for k in range(2))
    ends = shifted(lambda p: p.senders), shifted(lambda p: p.receivers)
    return LevelGraph(*ends, sum(p.num_nodes for p in parts), down, kept, contact)
