"""From one level to the next coarser one and back (thesis 4.3.2, table 4.7)."""

from dataclasses import dataclass

import torch
from torch import nn

from .message_passing import MessagePassing


@dataclass
class Table:
    """Sparse matrix (fine, coarse) of weights without gradient: down is its transpose, up itself.

    Attributes
    ----------
    rows, columns : (k,) int64 fine and coarse nodes
    values : (k,)
    shape : numbers of fine and coarse nodes
    """

    rows: torch.Tensor
    columns: torch.Tensor
    values: torch.Tensor
    shape: tuple

    def down(self, v):
        """Values (coarse, c) of (fine, c)."""
        return weighted_sum(v, self.rows, self.columns, self.values, self.shape[1])

    def up(self, v):
        """Values (fine, c) of (coarse, c)."""
        return weighted_sum(v, self.columns, self.rows, self.values, self.shape[0])


def weighted_sum(v, source, target, values, n):
    """(n, c): rows `source` of v times values, added up in rows `target`."""
    terms = v.index_select(0, source) * values[:, None].to(v.dtype)
    return v.new_zeros(n, v.shape[1]).index_add_(0, target, terms)


def contribution(level, positions):
    """The contribution table of a level, computed with its hierarchy: what the published model uses."""
    return Table(*level.down, (level.num_nodes, len(level.kept)))


def none(level, positions):
    """Kept nodes as they are, zero in the others."""
    k = torch.arange(len(level.kept), device=level.kept.device)
    values = torch.ones(len(k), dtype=positions.dtype, device=k.device)
    return Table(level.kept, k, values, (level.num_nodes, len(k)))


def graph_conv(level, positions):
    """One graph convolution: all neighbours of a kept node count the same."""
    return normalised(level, torch.ones_like(level.down[2]))


def position_kernel(level, positions):
    """Neighbours of a kept node count by their inverse distance (Liu et al. 2021)."""
    rows, columns, _ = level.down
    distance = (positions[rows] - positions[level.kept[columns]]).norm(dim=1)
    # a cluster of one node has only itself, at no distance
    return normalised(level, 1 / distance.clamp_min(torch.finfo(distance.dtype).tiny ** 0.5))


def normalised(level, weights):
    """Table with weights on the entries of the contribution table, each column with sum one."""
    rows, columns, _ = level.down
    sums = weights.new_zeros(len(level.kept)).index_add_(0, columns, weights)
    return Table(rows, columns, weights / sums[columns], (level.num_nodes, len(level.kept)))


# "learnable" is a message passing on the finer level (Fortunato et al. 2022) around going on as they are
TABLES = {
    "contribution": contribution,
    "none": none,
    "graph_conv": graph_conv,
    "position_kernel": position_kernel,
    "learnable": none,
}


class Transition(nn.Module):
    """Way between two levels, down or up.

    Parameters
    ----------
    kind : of `TABLES`
    latent, widths, checkpointing : of the message passing of "learnable"
    """

    def __init__(self, kind, latent, widths, checkpointing=False):
        super().__init__()
        if kind not in TABLES:
            raise ValueError(f"transition {kind!r}: there are {', '.join(TABLES)}")
        own = latent, widths, False, checkpointing
        self.passing = MessagePassing(*own) if kind == "learnable" else None

    def down(self, v, table, sets):
        """Latents on the coarser level; sets are the edges of the finer one, table None keeps all nodes."""
        v = v if self.passing is None else self.passing(v, sets)[0]
        return v if table is None else table.down(v)

    def up(self, v, table, sets):
        """Latents on the finer level."""
        v = v if table is None else table.up(v)
        return v if self.passing is None else self.passing(v, sets)[0]
