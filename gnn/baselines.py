"""Networks to compare with: MeshGraphNets on one level, and MS-GNN-Grid on cells of regular grids."""

from dataclasses import dataclass

import numpy as np
import torch
from torch import nn
from torch.utils.weak import WeakIdKeyDictionary

from .message_passing import (
    MLP,
    EdgeSet,
    MessagePassing,
    check_batch,
    edge_encoders,
    encoded,
    in_turn,
    level_edges,
    offset_widths,
)


class MeshGraphNets(nn.Module):
    """One level, many message passings with latents on edges (thesis 4.4.2.2).

    Parameters
    ----------
    num_inputs, num_outputs, dim, latent, contact, world : as in `bsms.BSMS`
    depth : not used, there is one level
    steps : message passings
    """

    def __init__(self, num_inputs, num_outputs, dim, depth, latent=128, contact=False, world=False, steps=15):
        super().__init__()
        self.contact, self.world = contact, world
        widths = offset_widths(dim, contact, world)
        self.encoder, self.decoder = MLP(num_inputs, latent, latent), MLP(latent, num_outputs, latent, False)
        self.edge_encoders = edge_encoders(latent, widths)
        own = latent, [latent] * len(widths), True
        self.steps = nn.ModuleList(MessagePassing(*own) for _ in range(steps))

    def forward(self, batch, features):
        """(N, num_outputs) of a GraphBatch and features (N, num_inputs)."""
        check_batch(batch, self.contact, self.world)
        sets = level_edges(batch.levels[0].ends, batch.material, batch.world, self.world)
        v, _ = in_turn(self.steps, self.encoder(features), sets, encoded(self.edge_encoders, sets))
        return self.decoder(v)


@dataclass
class GridLevel:
    """Cells of a regular grid over the nodes of the level above, where there are any.

    Attributes
    ----------
    cell : (n,) the cell that each node above is in
    offsets : (n, dim + 1) from the mean position of the cell to the node, and its length
    sets : EdgeSets between cells, without offsets
    merged : for each edge set, the edges above that go on, and which edge each of them is part of
    """

    cell: torch.Tensor
    offsets: torch.Tensor
    sets: list
    merged: list


def mean_rows(x, target, n):
    """(n, c) mean of the rows of x with the same target."""
    counts = torch.bincount(target, minlength=n).clamp_min(1)
    return x.new_zeros(n, x.shape[1]).index_add_(0, target, x) / counts[:, None]


def grid_level(x, graph, ends, size):
    """GridLevel, mean positions and graphs of cells of a size, from those of nodes (n, d), (n,)."""
    origin = np.full((graph.max() + 1, x.shape[1]), np.inf)
    np.minimum.at(origin, graph, x)
    places = np.floor((x - origin[graph]) / size).astype(np.int64)
    cells, cell = np.unique(np.column_stack([graph, places]), axis=0, return_inverse=True)
    cell, n = cell.ravel(), len(cells)
    mean = np.stack([np.bincount(cell, c, n) for c in x.T], axis=1) / np.bincount(cell)[:, None]
    offset = x - mean[cell]
    offset = np.column_stack([offset, np.linalg.norm(offset, axis=1)])
    new_ends, merged = [], []
    for senders, receivers in ends:
        a, b = cell[senders], cell[receivers]
        across = np.flatnonzero(a != b)
        pairs, part = np.unique(np.stack([b, a], axis=1)[across], axis=0, return_inverse=True)
        new_ends.append((pairs[:, 1], pairs[:, 0]))
        merged.append((across, part.ravel()))
    return (cell, offset, new_ends, merged), mean, cells[:, 0]


class MSGNNGrid(nn.Module):
    """Levels by closeness in space: nodes in a cell of a grid become one (Lino et al. 2022, thesis 4.4.2.3).

    Parameters
    ----------
    num_inputs, num_outputs, dim, latent, contact, world : as in `bsms.BSMS`
    depth : not used, `passes` has the levels
    dx : size of the first cells, for all axes or each; about 2.5 mean edges in table 4.3
    inflation : of the cells from level to level
    passes : message passings on each level, on the way down and again on the way up
    """

    def __init__(
        self,
        num_inputs,
        num_outputs,
        dim,
        depth,
        latent=128,
        contact=False,
        world=False,
        dx=2.5,
        inflation=2.0,
        passes=(4, 2, 2, 4),
    ):
        super().__init__()
        if not (np.min(dx) > 0 and inflation >= 1):
            raise ValueError(f"grid cells of size {dx}, inflation {inflation}: give dx > 0, inflation >= 1")
        self.contact, self.world, self.dx, self.inflation = contact, world, dx, inflation
        widths = offset_widths(dim, contact, world)
        sets, below = len(widths), len(passes) - 1

        def blocks(counts):
            own = latent, [latent] * sets, True
            return nn.ModuleList(nn.ModuleList(MessagePassing(*own) for _ in range(n)) for n in counts)

        self.encoder, self.decoder = MLP(num_inputs, latent, latent), MLP(latent, num_outputs, latent, False)
        self.edge_encoders = edge_encoders(latent, widths)
        self.down, self.up = blocks(passes), blocks(passes[:-1])
        self.gather_nodes = nn.ModuleList(MLP(dim + 1 + latent, latent, latent) for _ in range(below))
        self.gather_edges = nn.ModuleList(
            nn.ModuleList(MLP(latent, latent, latent) for _ in range(sets)) for _ in range(below)
        )
        self.give_back = nn.ModuleList(MLP(dim + 1 + 2 * latent, latent, latent) for _ in range(below))
        self.grids = WeakIdKeyDictionary()

    def levels(self, batch, sets):
        """GridLevels of a batch, made once for each batch."""
        if batch not in self.grids:
            x, graph = batch.material.double().cpu().numpy(), batch.graph_of_node.cpu().numpy()
            ends = [(s.senders.cpu().numpy(), s.receivers.cpu().numpy()) for s in sets]
            levels, size = [], np.array(self.dx)

            def tensors(value):
                if isinstance(value, np.ndarray):
                    dtype = batch.material.dtype if value.dtype == float else torch.int64
                    return torch.as_tensor(value, dtype=dtype, device=batch.material.device)
                return [tensors(v) for v in value]

            for _ in self.up:
                (cell, offsets, ends, merged), x, graph = grid_level(x, graph, ends, size)
                below = [EdgeSet(*tensors(pair), len(x)) for pair in ends]
                levels.append(GridLevel(tensors(cell), tensors(offsets), below, tensors(merged)))
                size = size * self.inflation
            self.grids[batch] = levels
        return self.grids[batch]

    def forward(self, batch, features):
        """(N, num_outputs) of a GraphBatch and features (N, num_inputs)."""
        check_batch(batch, self.contact, self.world)
        sets = level_edges(batch.levels[0].ends, batch.material, batch.world, self.world)
        levels = self.levels(batch, sets)
        sets = [sets] + [level.sets for level in levels]
        v, latents = self.encoder(features), encoded(self.edge_encoders, sets[0])
        kept = []
        for l, block in enumerate(self.down):
            v, latents = in_turn(block, v, sets[l], latents)
            if l < len(levels):
                kept.append((v, latents))
                grid = levels[l]
                v = self.gather_nodes[l].after_first(self.gather_nodes[l].split(grid.offsets, v))
                v = mean_rows(v, grid.cell, int(grid.cell.max()) + 1)
                latents = [
                    mean_rows(mlp(e.index_select(0, across)), part, len(edges.senders))
                    for mlp, e, (across, part), edges in zip(
                        self.gather_edges[l], latents, grid.merged, grid.sets
                    )
                ]
        for l in reversed(range(len(levels))):
            (own, latents), grid, mlp = kept[l], levels[l], self.give_back[l]
            v = own + mlp.after_first(mlp.split(grid.offsets, v.index_select(0, grid.cell), own))
            v, latents = in_turn(self.up[l], v, sets[l], latents)
        return self.decoder(v)
