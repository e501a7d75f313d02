"""BSMS-GNN: one message passing on every level of a bi-stride hierarchy, down and up (thesis 4.3)."""

from torch import nn

from .message_passing import MLP, MessagePassing, check_batch, level_edges, offset_widths
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
    repeats : message passings on the finest level, each way, and on the coarsest one
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
        checkpointing=False,
    ):
        super().__init__()
        self.depth, self.contact, self.world = depth, contact, world
        own = (latent, offset_widths(dim, contact, world), checkpointing)

        def passings(n):
            return nn.ModuleList(MessagePassing(*own) for _ in range(n))

        def transitions():
            return nn.ModuleList(Transition(transition, *own) for _ in range(depth))

        self.encoder, self.decoder = MLP(num_inputs, latent, latent), MLP(latent, num_outputs, latent, False)
        self.down, self.bottom, self.up = passings(depth), MessagePassing(*own), passings(depth)
        first = repeats - 1 if depth else 0  # without pooling there is only the way along the bottom
        self.again_down, self.again_up = passings(first), passings(first)
        self.again_bottom = passings(repeats - 1)
        self.pool, self.unpool = transitions(), transitions()
        self.table = TABLES[transition]

    def forward(self, batch, features):
        """(N, num_outputs) of a GraphBatch and features (N, num_inputs)."""
        check_batch(batch, self.contact, self.world)
        sets, tables = self.geometry(batch)
        v, skips = self.encoder(features), []
        for l in range(self.depth):
            v = self.down[l](v, sets[l])
            if l == 0:
                v = in_turn(self.again_down, v, sets[l])
            skips.append(v)
            v = self.pool[l].down(v, tables[l], sets[l])
        v = in_turn(self.again_bottom, self.bottom(v, sets[-1]), sets[-1])
        for l in reversed(range(self.depth)):
            v = self.up[l](self.unpool[l].up(v, tables[l], sets[l]), sets[l])
            if l == 0:
                v = in_turn(self.again_up, v, sets[l])
            v = skips[l] + v
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


def in_turn(passings, v, sets):
    """Latents (n, latent) after some message passings along the same edges."""
    for passing in passings:
        v = passing(v, sets)
    return v
