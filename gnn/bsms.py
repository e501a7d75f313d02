"""BSMS-GNN: one message passing on every level of a bi-stride hierarchy, down and up (thesis 4.3)."""

from torch import nn

from .message_passing import (
    MLP,
    MessagePassing,
    check_batch,
    encoded,
    in_turn,
    level_edges,
    linear_encoders,
    offset_widths,
)
from .transitions import TABLES, Transition, contribution


class BSMS(nn.Module):
    """Bi-stride multi-scale graph network.

    Parameters
    ----------
    num_inputs, num_outputs : columns of the features and of what comes out
    dim : dimension of the positions
    depth : poolings; a batch with fewer goes on on its coarsest level, as `batch.join` does
    latent : width of all layers
    contact : whether batches have contact edges
    world : whether positions in the deformed mesh are offsets of the mesh's edges too
    transition : between levels, one of `transitions.TABLES`
    repeats : message passings on the coarsest level; twice as many on the finest one, of these one on the way
        down: the others have what coarser levels know
    edge_latents : whether edges have latents too, which stay on their level from the way down to the way up
    correction : whether a level adds what the coarser ones have changed to its own latents, as multigrid does
        (full approximation scheme, Brandt 1977), and goes on from there; or, as published, the coarser ones'
        latents come up as they are and those of the way down are added after the message passings
    checkpointing : activations are computed again instead of stored, for big meshes
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
        transition="contribution",
        repeats=1,
        edge_latents=False,
        correction=False,
        checkpointing=False,
    ):
        super().__init__()
        self.depth, self.contact, self.world, self.correction = depth, contact, world, correction
        widths = offset_widths(dim, contact, world)
        on_edges = [latent] * len(widths) if edge_latents else widths

        def passings(n):
            own = latent, on_edges, edge_latents, checkpointing
            return nn.ModuleList(MessagePassing(*own) for _ in range(n))

        def way(finest):
            return nn.ModuleList(passings(1 if l else finest) for l in range(depth))

        def transitions():
            own = latent, widths, checkpointing
            return nn.ModuleList(Transition(transition, *own) for _ in range(depth))

        self.encoder, self.decoder = MLP(num_inputs, latent, latent), MLP(latent, num_outputs, latent, False)
        levels = depth + 1 if edge_latents else 0
        self.edge_encoders = nn.ModuleList(linear_encoders(latent, widths) for _ in range(levels))
        self.down, self.bottom, self.up = way(1), passings(repeats), way(2 * repeats - 1)
        self.pool, self.unpool = transitions(), transitions()
        self.table = TABLES[transition]

    def forward(self, batch, features):
        """(N, num_outputs) of a GraphBatch and features (N, num_inputs)."""
        check_batch(batch, self.contact, self.world)
        sets, tables = self.geometry(batch)
        latents = [None] * (self.depth + 1)
        if self.edge_encoders:
            latents = [encoded(*own) for own in zip(self.edge_encoders, sets)]
        v, skips, pooled = self.encoder(features), [], []
        for l in range(self.depth):
            v, latents[l] = in_turn(self.down[l], v, sets[l], latents[l])
            skips.append(v)
            v = self.pool[l].down(v, tables[l], sets[l])
            pooled.append(v)
        v, _ = in_turn(self.bottom, v, sets[-1], latents[-1])
        for l in reversed(range(self.depth)):
            if self.correction:
                v = skips[l] + self.unpool[l].up(v - pooled[l], tables[l], sets[l])
                v, _ = in_turn(self.up[l], v, sets[l], latents[l])
            else:
                v = self.unpool[l].up(v, tables[l], sets[l])
                v = skips[l] + in_turn(self.up[l], v, sets[l], latents[l])[0]
        return self.decoder(v)

    def geometry(self, batch):
        """Edge sets of levels 0 to depth, and the tables below them, None where a level goes on as it is."""
        material, world = batch.material, batch.world
        sets, tables = [], []
        for level in batch.levels[: self.depth + 1]:
            sets.append(level_edges(level.ends, material, world, self.world))
            tables.append(None if level.kept is None else self.table(level, material))
            if level.kept is not None:
                average = contribution(level, material)
                material = average.down(material)
                world = None if world is None else average.down(world)
        missing = self.depth + 1 - len(sets)
        return sets + sets[-1:] * missing, tables + tables[-1:] * missing
