"""What a network is trained on: frames of trajectories, with noise, and what comes one step later."""

from collections import OrderedDict
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from .batch import GraphBatch, join, level_tensors, single
from .contact import contact_edges
from .hierarchy import build_hierarchy, cached_hierarchy
from .trajectory import Trajectory

KEPT_MESHES = 512  # hierarchies that stay in memory
LEAST_SHARE = 0.1  # of the mean one, for samples in which nothing happens: no weight is above eleven


@dataclass
class Sample:
    """One frame of one mesh, or several in one disjoint graph.

    Attributes
    ----------
    batch : GraphBatch, its positions in units of the edge length
    state : (N, c) fields or positions, with noise
    motion : (N, d) change of position that is prescribed, zero elsewhere; None for fields at rest
    target : (N, o) change of the state to the next frame, without its noise, and the fields of it
    learned : (N,) bool, nodes that are not prescribed
    weight : (N,) of their squared errors in the loss
    """

    batch: GraphBatch
    state: torch.Tensor
    motion: torch.Tensor | None
    target: torch.Tensor
    learned: torch.Tensor
    weight: torch.Tensor

    def to(self, device):
        """The same on a device."""
        return Sample(*(None if v is None else v.to(device) for v in vars(self).values()))


def find_trajectories(folder):
    """Paths of the trajectories of a data set, in the order of their names."""
    paths = sorted(p for p in Path(folder).glob("*.xdmf") if not p.name.startswith("."))
    if not paths:
        raise FileNotFoundError(f"{folder}: no *.xdmf there; a script demos/dataset_*.py makes a data set")
    return paths


class Meshes:
    """Trajectories with the hierarchies of their meshes, opened when they are needed.

    Parameters
    ----------
    paths : of the trajectories
    config : Config
    length : mean length of an edge, the unit of positions inside of the network
    """

    def __init__(self, paths, config, length=1.0):
        self.paths, self.config, self.length = list(paths), config, length
        self.open, self.others = OrderedDict(), OrderedDict()

    def __len__(self):
        return len(self.paths)

    def __getitem__(self, i):
        """Trajectory, hierarchy and its tensors, of path i."""
        return recalled(self.open, i, self.opened)

    def opened(self, i):
        """The same, from its files."""
        c, trajectory = self.config, Trajectory(self.paths[i])
        check_fields(trajectory, c)
        folder = Path(self.paths[i]).parent / ".hierarchies"
        options = {"seeding": c.seeding, "top_up": c.top_up}
        if c.seeding == "random":
            folder, options["rng"] = None, np.random.default_rng([c.seed, i])
        hierarchy = cached_hierarchy(trajectory.graph, c.depth, folder, **options)
        return trajectory, hierarchy, level_tensors(hierarchy)

    def other(self, key):
        """Another hierarchy and its tensors; key: number of the mesh and a number for its random seeds."""
        c, graph = self.config, self[key[0]][0].graph
        rng = np.random.default_rng([c.seed, *key])
        hierarchy = build_hierarchy(graph.edges, graph.points, c.depth, "random", c.top_up, rng)
        return hierarchy, level_tensors(hierarchy)

    def state(self, i, k):
        """(n, c) float32 state of frame k of trajectory i."""
        return stack(self[i][0], self.config.state, k)

    def batch(self, i, world=None, number=0):
        """GraphBatch of mesh i, with contact edges where positions (n, d) are given.

        Its levels are those of the config's seeds, or of a number, see `other`.
        """
        trajectory, *pooled = self[i]
        hierarchy, levels = recalled(self.others, (i, number), self.other) if number else pooled
        graph, contact = trajectory.graph, None
        if self.config.contact_radius:
            contact = contact_edges(world, graph.edges, self.config.contact_radius)
        out = single(graph, hierarchy, levels, world, contact)
        out.material = out.material / self.length
        if world is not None:
            out.world = out.world / self.length
        return out

    def learned(self, i):
        """(n,) bool, nodes whose type is predicted."""
        return np.isin(self[i][0].graph.node_type, self.config.predicted)

    def motion(self, i, change):
        """(n, d) change of position from one frame to the next where it is prescribed, zero elsewhere."""
        moving = np.isin(self[i][0].graph.node_type, self.config.moving)
        return torch.from_numpy(np.where(moving[:, None], change, np.float32(0)))


def recalled(store, key, make):
    """What an OrderedDict has for a key, else what make(key) returns; it keeps what was used last."""
    if key not in store:
        store[key] = make(key)
        if len(store) > KEPT_MESHES:
            store.popitem(last=False)
    store.move_to_end(key)
    return store[key]


def check_fields(trajectory, config):
    """Raise a ValueError where a trajectory lacks what a Config asks for."""
    wanted = (*config.state, *config.direct)
    missing = [name for name in wanted if name not in trajectory.fields]
    if missing:
        raise ValueError(f"{trajectory.path}: no field {missing[0]!r}, it has {', '.join(trajectory.fields)}")
    dim = trajectory.graph.points.shape[1]
    if config.mirror and (dim == 1 or not set(config.mirror) <= set(range(dim))):
        raise ValueError(f"mirror {config.mirror}: give axes of a plane or space, the meshes have {dim}")
    if not np.isin(trajectory.graph.node_type, config.predicted).any():
        raise ValueError(f"{trajectory.path}: no node is of the types {config.predicted} that are predicted")


def stack(trajectory, names, k):
    """(n, c) float32 fields of a frame side by side."""
    return stack_frames(trajectory, names, k, k + 1)[0]


def stack_frames(trajectory, names, k0, k1):
    """(k1 - k0, n, c) float32 fields of frames k0 to k1 - 1 side by side."""
    parts = [trajectory.read_many(name, k0, k1) for name in names]
    return np.concatenate([a.reshape(*a.shape[:2], -1) for a in parts], axis=2)


def noise_scales(trajectory, config):
    """(c,) standard deviation of the noise on each column of the state."""
    return np.repeat(config.noise, [trajectory.fields[name] for name in config.state])


def make_sample(meshes, i, k, rng=None):
    """Frame k of trajectory i; with rng (numpy Generator) noise is added, and mirror and levels are drawn.

    The target leads from the noisy state to the true one of the next frame: so the network learns to take
    back what it does wrong in a rollout.
    """
    config, trajectory = meshes.config, meshes[i][0]
    clean, after, learned = meshes.state(i, k), meshes.state(i, k + 1), meshes.learned(i)
    state = clean
    if rng is not None:
        scales = noise_scales(trajectory, config) * learned[:, None]
        state = (clean + scales * rng.standard_normal(clean.shape)).astype(np.float32)
    world = state if config.position else None
    motion = meshes.motion(i, after - clean) if config.position else None
    target = after - state
    if config.direct:
        target = np.concatenate([target, stack(trajectory, config.direct, k + 1)], axis=1)
    rest = (torch.from_numpy(a) for a in (target, learned, np.ones(len(learned), np.float32)))
    several = rng is not None and config.model == "bsms" and config.hierarchies > 1
    number = int(rng.integers(config.hierarchies)) if several else 0
    sample = Sample(meshes.batch(i, world, number), torch.from_numpy(state), motion, *rest)
    for axis in config.mirror if rng is not None else ():
        if rng.random() < 0.5:
            turn_round(sample, axis, vectors(trajectory, config))
    return sample


def vectors(trajectory, config):
    """Columns of state and direct fields at which their vectors begin."""
    dim = trajectory.graph.points.shape[1]
    widths = [trajectory.fields[name] for name in (*config.state, *config.direct)]
    return [int(end) - w for w, end in zip(widths, np.cumsum(widths)) if w == dim]


def turn_round(sample, axis, vectors):
    """Mirror a sample along an axis, in place; vectors begin at the given columns of state and target."""
    for x in (sample.batch.material, sample.batch.world, sample.motion):
        if x is not None:
            x[:, axis] *= -1
    for column in vectors:
        for x in (sample.state, sample.target):
            if column < x.shape[1]:
                x[:, column + axis] *= -1


def join_samples(samples):
    """One Sample of several."""

    def cat(name):
        parts = [getattr(s, name) for s in samples]
        return None if parts[0] is None else torch.cat(parts)

    rest = (cat(name) for name in ("state", "motion", "target", "learned", "weight"))
    return Sample(join([s.batch for s in samples]), *rest)


def count_frames(meshes):
    """(k, 2) trajectory and frame of everything that a training can ask for."""
    parts = [
        np.stack([np.full(len(t) - 1, i), np.arange(len(t) - 1)], axis=1) for i, (t, *_) in enumerate(meshes)
    ]
    if not sum(map(len, parts)):
        raise ValueError(
            f"{meshes.paths[0].parent}: no trajectory of two frames or more, nothing to learn from"
        )
    return np.concatenate(parts)


def importance(meshes, mean, deviation):
    """Shares (k,) of the samples of `count_frames` in a training, by the root mean square of their targets.

    With the noise that is added to them, normalised by mean and deviation (o,). Errors, and with them the
    gradients, grow with what happens in a step: drawn by these shares and weighted by one over them, samples
    give the same gradient on average, with less variance (Katharopoulos and Fleuret 2018).
    """
    c, sizes = meshes.config, []
    noise = noise_scales(meshes[0][0], c)
    floor = np.sum((noise / deviation[: len(noise)]) ** 2) / len(deviation)
    for i, (trajectory, *_) in enumerate(meshes):
        frames = 0, len(trajectory)
        target = np.diff(stack_frames(trajectory, c.state, *frames), axis=0)
        if c.direct:
            target = np.concatenate([target, stack_frames(trajectory, c.direct, *frames)[1:]], axis=2)
        target = (target[:, meshes.learned(i)] - mean) / deviation
        sizes.append(np.sqrt(np.mean(target**2, axis=(1, 2)) + floor))
    sizes = np.concatenate(sizes)
    sizes += LEAST_SHARE * sizes.mean() + np.finfo(float).tiny
    return sizes / sizes.sum()


def drawn(shares, offset):
    """Numbers (k,) of samples, each as often as its share says, up to less than one (systematic resampling).

    Parameters
    ----------
    shares : (k,) with sum one
    offset : random number in [0, 1)
    """
    at = (np.arange(len(shares)) + offset) / len(shares)
    return np.searchsorted(np.cumsum(shares), at).clip(max=len(shares) - 1)


def mean_edge_length(meshes, most=20):
    """Mean length of the edges of the first meshes."""
    lengths = []
    for i in range(min(len(meshes), most)):
        graph = meshes[i][0].graph
        lengths.append(np.linalg.norm(np.diff(graph.points[graph.edges], axis=1)[:, 0], axis=1).mean())
    return float(np.mean(lengths))
