"""A network with the normalisation of what goes in and comes out: from a state to the next one."""

import dataclasses

import numpy as np
import torch

from .config import Config
from .graph import NUM_TYPES
from .models import make_model
from .samples import make_sample, noise_scales

SMALLEST = 1e-8  # deviation below which a quantity counts as constant


class Predictor(torch.nn.Module):
    """Learned time step.

    Parameters
    ----------
    config : Config
    dim : dimension of the positions
    widths : columns of state, prescribed motion and output
    length : unit of the positions, see `samples.Meshes`
    """

    def __init__(self, config, dim, widths, length=1.0):
        super().__init__()
        self.config, self.dim, self.widths, self.length = config, dim, tuple(widths), float(length)
        state, motion, out = widths
        # positions are no input: what moves with a body does not depend on where it is
        inputs = (motion if config.position else state) + NUM_TYPES
        own = {}
        if config.model == "bsms":
            own = {"transition": config.transition, "checkpointing": config.checkpointing}
            own |= {name: getattr(config, name) for name in ("repeats", "edge_latents", "correction")}
        elif config.model == "meshgraphnets":
            own = {"steps": config.steps_flat}
        options = {"latent": config.latent, "contact": config.contact_radius > 0}
        options |= {"world": bool(config.position), **own}
        sizes = {"num_inputs": inputs, "num_outputs": out, "dim": dim, "depth": config.depth}
        self.model = make_model(config.model, **sizes, **options)
        for name, width in (("in", inputs - NUM_TYPES), ("out", out)):
            self.register_buffer(f"mean_{name}", torch.zeros(width))
            self.register_buffer(f"deviation_{name}", torch.ones(width))

    def forward(self, batch, state, motion=None):
        """(N, o) normalised change of the state, and direct fields."""
        values = state if motion is None else motion
        types = torch.nn.functional.one_hot(batch.node_type, NUM_TYPES).to(values.dtype)
        values = (values - self.mean_in) / self.deviation_in
        return self.model(batch, torch.cat([values, types], dim=1))

    def loss_terms(self, sample):
        """Sum of the squared errors of the normalised output where it is learned, and how many these are."""
        target = (sample.target - self.mean_out) / self.deviation_out
        error = (self(sample.batch, sample.state, sample.motion) - target)[sample.learned]
        return (sample.weight[sample.learned, None] * error**2).sum(), error.numel()

    def step(self, batch, state, motion=None):
        """The next state (N, c) and the direct fields (N, o - c)."""
        out = self(batch, state, motion) * self.deviation_out + self.mean_out
        c = state.shape[1]
        return state + out[:, :c], out[:, c:]

    def fit_normalisation(self, meshes, frames, most=300):
        """Mean and deviation of inputs and targets over some of the frames (k, 2), in float64."""
        rng = np.random.default_rng(self.config.seed)
        chosen, moving = rng.permutation(frames)[:most], torch.tensor(self.config.moving)
        sums = {name: np.zeros((3, getattr(self, f"mean_{name}").numel())) for name in ("in", "out")}
        for i, k in chosen:
            s = make_sample(meshes, int(i), int(k))
            values = s.state if s.motion is None else s.motion
            used = slice(None) if s.motion is None else torch.isin(s.batch.node_type, moving)
            for name, part in (("in", values[used]), ("out", s.target[s.learned])):
                part = part.double().numpy()
                sums[name] += np.stack(
                    [np.full(part.shape[1], len(part)), part.sum(axis=0), (part**2).sum(axis=0)]
                )
        added = np.zeros(self.widths[2])
        added[: self.widths[0]] = noise_scales(meshes[0][0], self.config)
        for name, noise in (("in", 0.0), ("out", added)):
            count, first, second = sums[name]
            mean = first / np.maximum(count, 1)
            deviation = np.sqrt(np.maximum(second / np.maximum(count, 1) - mean**2, 0) + noise**2)
            deviation[deviation < SMALLEST] = 1
            getattr(self, f"mean_{name}").copy_(torch.from_numpy(mean))
            getattr(self, f"deviation_{name}").copy_(torch.from_numpy(deviation))

    def describe(self):
        """What `from_description` makes an equal one of, without its weights."""
        settings = dataclasses.asdict(self.config)
        return {"config": settings, "dim": self.dim, "widths": self.widths, "length": self.length}


def from_description(found):
    """Predictor of `Predictor.describe`."""
    settings = {k: tuple(v) if isinstance(v, list) else v for k, v in found["config"].items()}
    return Predictor(Config(**settings), found["dim"], found["widths"], found["length"])


def make_predictor(config, meshes):
    """Predictor for the trajectories of a data set, without normalisation."""
    trajectory = meshes[0][0]
    state = sum(trajectory.fields[name] for name in config.state)
    out = state + sum(trajectory.fields[name] for name in config.direct)
    motion = trajectory.graph.points.shape[1] if config.position else 0
    return Predictor(config, trajectory.graph.points.shape[1], (state, motion, out), meshes.length)
