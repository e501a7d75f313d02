"""Graph U-Nets: nodes that a learned score chooses make the next level (Gao and Ji 2019, thesis 4.4.2.4)."""

import numpy as np
import scipy.sparse as sp
import torch
from torch import nn

from .message_passing import MLP, MessagePassing, check_batch, level_edges, offset_widths


def matrix(senders, receivers, n):
    """Scipy adjacency (n, n) of directed edges."""
    ends = receivers.cpu().numpy(), senders.cpu().numpy()
    return sp.csr_matrix((np.ones(len(ends[0]), np.float32), ends), (n, n))


def pairs(table, device):
    """Senders and receivers of an adjacency without its diagonal, in the order of the receivers."""
    table = table.tocsr()
    table.sort_indices()
    table = table.tocoo()
    off = table.row != table.col
    return tuple(torch.as_tensor(k[off], dtype=torch.int64, device=device) for k in (table.col, table.row))


def next_ends(ends, n, kept):
    """Edges and contact edges between kept nodes: offdiag((A + I)^2), and (A + I) A_C (A + I)."""
    chosen, device = kept.cpu().numpy(), kept.device
    near = matrix(*ends[0], n) + sp.identity(n, np.float32, "csr")
    rows, columns = near[chosen], near[:, chosen]
    return [pairs(rows @ columns, device)] + [
        pairs(rows @ (matrix(*e, n) @ columns), device) for e in ends[1:]
    ]


def highest(score, graph, ratio):
    """Ascending numbers of the nodes with the highest scores of each graph, a ratio of them, at least one."""
    order = torch.argsort(score, descending=True, stable=True)
    order = order[torch.argsort(graph[order], stable=True)]
    counts = torch.bincount(graph)
    rank = torch.arange(len(order), device=order.device) - (counts.cumsum(0) - counts)[graph[order]]
    return order[rank < (ratio * counts).ceil().clamp_min(1)[graph[order]]].sort().values


class GraphUNets(nn.Module):
    """Learned pooling with one message passing on every level.

    Parameters
    ----------
    num_inputs, num_outputs, dim, depth, latent, contact, world : as in `bsms.BSMS`
    ratio : of the nodes that go on to the next level
    """

    def __init__(
        self, num_inputs, num_outputs, dim, depth, latent=128, contact=False, world=False, ratio=0.5
    ):
        super().__init__()
        if not 0 < ratio < 1:
            raise ValueError(f"graph_unets: ratio {ratio} of nodes that stay must be between 0 and 1")
        self.contact, self.world, self.ratio = contact, world, ratio
        widths = offset_widths(dim, contact, world)

        def passings(n):
            return nn.ModuleList(MessagePassing(latent, widths) for _ in range(n))

        self.encoder, self.decoder = MLP(num_inputs, latent, latent), MLP(latent, num_outputs, latent, False)
        self.down, self.bottom, self.up = passings(depth), MessagePassing(latent, widths), passings(depth)
        self.scores = nn.ModuleList(nn.Linear(latent, 1) for _ in range(depth))

    def forward(self, batch, features):
        """(N, num_outputs) of a GraphBatch and features (N, num_inputs)."""
        check_batch(batch, self.contact, self.world)
        level, x, world, graph = batch.levels[0], batch.material, batch.world, batch.graph_of_node
        ends = level.ends
        v, above = self.encoder(features), []
        for passing, score in zip(self.down, self.scores):
            sets = level_edges(ends, x, world, self.world)
            v, _ = passing(v, sets)
            gate = torch.sigmoid(score(v)[:, 0] / score.weight.norm())
            kept = highest(gate.detach(), graph, self.ratio)
            above.append((v, sets, kept))
            ends = next_ends(ends, len(v), kept)
            v = v.index_select(0, kept) * gate.index_select(0, kept)[:, None]
            x, graph = x[kept], graph[kept]
            world = None if world is None else world[kept]
        v, _ = self.bottom(v, level_edges(ends, x, world, self.world))
        for passing, (skip, sets, kept) in zip(self.up, reversed(above)):
            v = skip.new_zeros(skip.shape).index_add_(0, kept, v.to(skip.dtype))
            v = skip + passing(v, sets)[0]
        return self.decoder(v)
