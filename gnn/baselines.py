"""Networks to compare with: MeshGraphNets on one level, and MS-GNN-Grid on cells of regular grids."""

from dataclasses import dataclass

import numpy as np
import torch
from torch import nn
from torch.nn import functional as F
from torch.utils.weak import WeakIdKeyDictionary

from .message_passing import MLP, check_batch, level_edges, offset_widths


class LatentPassing(nn.Module):
    """A message passing with latents on edges that stay and change (Pfaff et al. 2020).

    Parameters
    ----------
    latent : width of all latents
    sets : number of edge sets
    """

    def __init__(self, latent, sets):
        super().__init__()
        self.edges = nn.ModuleList(MLP(3 * latent, latent, latent) for _ in range(sets))
        self.nodes = MLP((1 + sets) * latent, latent, latent)

    def forward(self, v, ends, latents):
        """Latents (n, latent) of nodes and of each edge set, whose senders and receivers `ends` has."""
        sums, changed = [], []
        for mlp, (senders, receivers), old in zip(self.edges, ends, latents):
            own, to_receiver, to_sender = mlp.first.weight.chunk(3, dim=1)
            z = F.linear(old, own, mlp.first.bias) + F.linear(v, to_receiver).index_select(0, receivers)
            change = mlp.after_first(z + F.linear(v, to_sender).index_select(0, senders))
            sums.append(change.new_zeros(len(v), change.shape[1]).index_add_(0, receivers, change))
            changed.append(old + change)
        return v + self.nodes.after_first(self.nodes.split(v, *sums)), changed


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
        self.edge_encoders = nn.ModuleList(MLP(k, latent, latent) for k in widths)
        self.steps = nn.ModuleList(LatentPassing(latent, len(widths)) for _ in range(steps))

    def forward(self, batch, features):
        """(N, num_outputs) of a GraphBatch and features (N, num_inputs)."""
        check_batch(batch, self.contact, self.world)
        sets = level_edges(batch.levels[0].ends, batch.material, batch.world, self.world)
        ends = [(s.senders, s.receivers) for s in sets]
        v, latents = self.encoder(features), [mlp(s.offsets) for mlp, s in zip(self.edge_encoders, sets)]
        for step in self.steps:
            v, latents = step(v, ends, latents)
        return self.decoder(v)


@dataclass
class GridLevel:
    """Cells of a regular grid over the nodes of the level above, where there are any.

    Attributes
    ----------
    cell : (n,) the cell that each node above is in
    offsets : (n, dim + 1) from the mean position of the cell to the node, and its length
    ends : senders and receivers of each edge set between cells
    merged : for each edge set, the edges above that go on, and which edge each of them is part of
    """

    cell: torch.Tensor
    offsets: torch.Tensor
    ends: list
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
            return nn.ModuleList(nn.ModuleList(LatentPassing(latent, sets) for _ in range(n)) for n in counts)

        self.encoder, self.decoder = MLP(num_inputs, latent, latent), MLP(latent, num_outputs, latent, False)
        self.edge_encoders = nn.ModuleList(MLP(k, latent, latent) for k in widths)
        self.down, self.up = blocks(passes), blocks(passes[:-1])
        self.gather_nodes = nn.ModuleList(MLP(dim + 1 + latent, latent, latent) for _ in range(below))
        self.gather_edges = nn.ModuleList(
            nn.ModuleList(MLP(latent, latent, latent) for _ in range(sets)) for _ in range(below)
        )
        self.give_back = nn.ModuleList(MLP(dim + 1 + 2 * latent, latent, latent) for _ in range(below))
        self.grids = WeakIdKeyDictionary()

    def levels(self, batch, ends):
        """GridLevels of a batch, made once for each batch."""
        if batch not in self.grids:
            x, graph = batch.material.double().cpu().numpy(), batch.graph_of_node.cpu().numpy()
            arrays, levels, size = [[k.cpu().numpy() for k in pair] for pair in ends], [], np.array(self.dx)

            def tensors(value):
                if isinstance(value, np.ndarray):
                    dtype = batch.material.dtype if value.dtype == float else torch.int64
                    return torch.as_tensor(value, dtype=dtype, device=batch.material.device)
                return [tensors(v) for v in value]

            for _ in self.up:
                found, x, graph = grid_level(x, graph, arrays, size)
                arrays, size = found[2], size * self.inflation
                levels.append(GridLevel(*tensors(found)))
            self.grids[batch] = levels
        return self.grids[batch]

    def forward(self, batch, features):
        """(N, num_outputs) of a GraphBatch and features (N, num_inputs)."""
        check_batch(batch, self.contact, self.world)
        sets = level_edges(batch.levels[0].ends, batch.material, batch.world, self.world)
        ends = [[(s.senders, s.receivers) for s in sets]]
        levels = self.levels(batch, ends[0])
        v, latents = self.encoder(features), [mlp(s.offsets) for mlp, s in zip(self.edge_encoders, sets)]
        kept = []
        for l, block in enumerate(self.down):
            for passing in block:
                v, latents = passing(v, ends[l], latents)
            if l < len(levels):
                kept.append((v, latents))
                grid = levels[l]
                v = self.gather_nodes[l].after_first(self.gather_nodes[l].split(grid.offsets, v))
                v = mean_rows(v, grid.cell, int(grid.cell.max()) + 1)
                latents = [
                    mean_rows(mlp(e.index_select(0, across)), part, len(pairs[0]))
                    for mlp, e, (across, part), pairs in zip(
                        self.gather_edges[l], latents, grid.merged, grid.ends
                    )
                ]
                ends.append(grid.ends)
        for l in reversed(range(len(levels))):
            (own, latents), grid, mlp = kept[l], levels[l], self.give_back[l]
            v = own + mlp.after_first(mlp.split(grid.offsets, v.index_select(0, grid.cell), own))
            for passing in self.up[l]:
                v, latents = passing(v, ends[l], latents)
        return self.decoder(v)
