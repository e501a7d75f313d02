"""Networks of two hidden layers and message passings, equation (4.2), the hot path of every model."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch
from torch import nn
from torch.nn import functional as F
from torch.utils.checkpoint import checkpoint

from .edge_sum import EPS, EdgeSum

CHUNK = 2048  # edges worked on at once, so that what belongs to them stays in the cache of a core


class MLP(nn.Module):
    """Two hidden layers with ReLU, and a LayerNorm without parameters on what comes out (thesis 4.4.2.1).

    Parameters
    ----------
    inputs, outputs, latent : widths
    normalised : False for decoders
    """

    def __init__(self, inputs, outputs, latent, normalised=True):
        super().__init__()
        self.first, self.second = nn.Linear(inputs, latent), nn.Linear(latent, latent)
        self.last, self.normalised = nn.Linear(latent, outputs), normalised

    def forward(self, x):
        """(n, inputs) -> (n, outputs)."""
        return self.after_first(self.first(x))

    def after_first(self, z):
        """The same, from what the first layer returns."""
        y = self.last(F.relu(self.second(F.relu(z))))
        return F.layer_norm(y, y.shape[1:], eps=EPS) if self.normalised else y

    def split(self, *parts):
        """What the first layer returns for `parts` side by side, without putting them there."""
        weights = self.first.weight.split([p.shape[1] for p in parts], dim=1)
        z = F.linear(parts[0], weights[0], self.first.bias)
        for part, weight in zip(parts[1:], weights[1:]):
            z = z + F.linear(part, weight)
        return z


@dataclass
class EdgeSet:
    """Directed edges of one kind on one level, in the order of their receivers.

    Attributes
    ----------
    senders, receivers : (E,) int64
    num_nodes : int
    offsets : (E, k) differences of positions from the receiver to the sender, and their lengths; None where
        edges have latents only
    """

    senders: torch.Tensor
    receivers: torch.Tensor
    num_nodes: int
    offsets: torch.Tensor | None = None

    @cached_property
    def start(self):
        """(n,) where the edges of each receiver begin."""
        counts = torch.bincount(self.receivers, minlength=self.num_nodes)
        return counts.cumsum(0) - counts

    @cached_property
    def bounds(self):
        """(n + 1,) array: the edges of each receiver are between two of them."""
        return np.append(self.start.numpy(), len(self.receivers))

    @cached_property
    def arrays(self):
        """Senders and receivers as arrays."""
        return self.senders.numpy(), self.receivers.numpy()

    @cached_property
    def chunks(self):
        """Slices of receivers and of their edges, about `CHUNK` of these in each."""
        edges = len(self.receivers)
        marks = torch.searchsorted(self.start, CHUNK * torch.arange(1, edges // CHUNK + 1)).tolist()
        nodes = sorted({0, *marks, self.num_nodes})
        ends = [*self.start[nodes[:-1]].tolist(), edges]
        return [(slice(*n), slice(*e)) for n, e in zip(zip(nodes, nodes[1:]), zip(ends, ends[1:]))]

    @cached_property
    def longest(self):
        """How many edges the largest chunk has."""
        return max((e.stop - e.start for _, e in self.chunks), default=0)


def edge_set(senders, receivers, *positions):
    """EdgeSet with the offsets, and their lengths, of each of the positions (n, d)."""
    offsets = []
    for x in positions:
        offset = x.index_select(0, senders) - x.index_select(0, receivers)
        offsets += [offset, offset.norm(dim=1, keepdim=True)]
    return EdgeSet(senders, receivers, len(positions[0]), torch.cat(offsets, dim=1))


def offset_widths(dim, contact, world):
    """Widths of the offsets of each edge set (thesis table 4.2)."""
    return ((dim + 1) * (2 if world else 1),) + (dim + 1,) * contact


def check_batch(batch, contact, world):
    """Raise a ValueError where a batch is not of the kind a model is made for."""
    if world and batch.world is None:
        raise ValueError("model with world=True: the batch has no positions `world`, give them to `single`")
    if contact != (batch.levels[0].contact is not None):
        has = "no" if contact else "some"
        raise ValueError(f"model with contact={contact}: the batch has {has} contact edges, make them agree")


def level_edges(ends, material, world, with_world):
    """Edge sets with positions (n, d): of the mesh's `ends`, and of contact edges where they follow."""
    contact = material if world is None else world
    own = (material, world) if with_world else (material,)
    return [edge_set(*ends[0], *own)] + [edge_set(*e, contact) for e in ends[1:]]


def fused(v):
    """Whether `EdgeSum` can be used: its chunks are for caches of processors, its kernels for two types."""
    simple = not (torch.compiler.is_compiling() or torch.is_autocast_enabled(v.device.type))
    return simple and v.device.type == "cpu" and v.dtype in (torch.float32, torch.float64)


def edge_sums(mlp, v, edges, latents=None, keep=False):
    """Sum (n, latent) over the edges into each node of mlp([offsets, v of receiver, v of sender]).

    Where given, latents (E, latent) of the edges stand in the place of the offsets. With `keep` the terms of
    the sum come back too, added to the latents where there are some; else None. The first layer is linear:
    its products with v are taken once for every node, not for every edge.
    """
    if len(v) != edges.num_nodes:
        raise ValueError(f"features of {len(v)} nodes for a graph of {edges.num_nodes}")
    x, width = edges.offsets if latents is None else latents, v.shape[1]
    weight, to_receiver, to_sender = mlp.first.weight.split([x.shape[1], width, width], dim=1)
    p, q = F.linear(v, to_receiver, mlp.first.bias), F.linear(v, to_sender)
    if fused(v):
        second, last = mlp.second, mlp.last
        centred = last.weight - last.weight.mean(0), last.bias - last.bias.mean()
        layers = weight, second.weight, second.bias, *centred
        sums, y = EdgeSum.apply(edges, torch.is_grad_enabled(), keep, x, p, q, *layers)
    else:
        z = p.index_select(0, edges.receivers) + q.index_select(0, edges.senders)
        y = mlp.after_first(z + F.linear(x, weight))
        sums = y.new_zeros(edges.num_nodes, y.shape[1]).index_add_(0, edges.receivers, y)
    if not keep:
        return sums, None
    return sums, y if latents is None else latents + y


class MessagePassing(nn.Module):
    """One message passing, equation (4.2).

    Parameters
    ----------
    latent : width of the latents of nodes
    widths : of what each edge set comes with, its offsets (`offset_widths`) or latents
    keep : whether messages stay on the edges, as their latents or added to them (Pfaff et al. 2020)
    checkpointing : activations are computed again in the backward pass instead of stored
    """

    def __init__(self, latent, widths, keep=False, checkpointing=False):
        super().__init__()
        self.edges = nn.ModuleList(MLP(k + 2 * latent, latent, latent) for k in widths)
        self.nodes = MLP((1 + len(widths)) * latent, latent, latent)
        self.keep, self.checkpointing = keep, checkpointing

    def forward(self, v, sets, latents=None):
        """Latents (n, latent) of nodes and a list of those of edges, after messages along each EdgeSet."""
        if self.checkpointing and torch.is_grad_enabled():
            return checkpoint(self.update, v, sets, latents, use_reentrant=False)
        return self.update(v, sets, latents)

    def update(self, v, sets, latents):
        old = latents or [None] * len(sets)
        pairs = [edge_sums(mlp, v, *own, self.keep) for mlp, *own in zip(self.edges, sets, old)]
        v = v + self.nodes.after_first(self.nodes.split(v, *(sums for sums, _ in pairs)))
        return v, [new for _, new in pairs] if self.keep else None


def edge_encoders(latent, widths):
    """Networks that make latents of the offsets of each edge set."""
    return nn.ModuleList(MLP(k, latent, latent) for k in widths)


def linear_encoders(latent, widths):
    """Linear maps of the offsets of each edge set, normalised: messages have two hidden layers of their own.

    `edge_encoders` on all levels would take an eighth of a training step.
    """
    return nn.ModuleList(
        nn.Sequential(nn.Linear(k, latent), nn.LayerNorm(latent, EPS, elementwise_affine=False))
        for k in widths
    )


def encoded(encoders, sets):
    """Latents (E, latent) of the edges of each EdgeSet, from their offsets."""
    return [mlp(edges.offsets) for mlp, edges in zip(encoders, sets)]


def in_turn(passings, v, sets, latents=None):
    """Latents of nodes and of edges, None without, after some message passings along the same edges."""
    for passing in passings:
        v, latents = passing(v, sets, latents)
    return v, latents
