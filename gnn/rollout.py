"""Rollouts: the learned step again and again, its errors beside the truth, and files of both."""

import time

import numpy as np
import torch

from .samples import stack
from .trajectory import write_trajectory

BOUNDARY = ("prescribed", "frozen")


def rollout(predictor, meshes, i, steps=None, start=0, boundary="prescribed"):
    """States that the network predicts from one frame of a trajectory on.

    Parameters
    ----------
    predictor : Predictor
    meshes : samples.Meshes; i : which of its trajectories
    steps : how many, to its end when not given; start : frame to start from
    boundary : where nodes are not predicted, "prescribed" takes the truth, "frozen" that of the first frame

    Returns
    -------
    (steps + 1, n, c) states, the first one true; (steps, n, m) direct fields; seconds for a step
    """
    if boundary not in BOUNDARY:
        raise ValueError(f"boundary {boundary!r}: give one of {', '.join(map(repr, BOUNDARY))}")
    trajectory = meshes[i][0]
    most = len(trajectory) - 1 - start
    wanted, steps = steps, most if steps is None else min(steps, most)
    if steps < 1:
        raise ValueError(f"start {start}, steps {wanted}: {trajectory.path} has {len(trajectory)} frames")
    device = next(predictor.parameters()).device
    learned, now = torch.from_numpy(meshes.learned(i)).to(device), meshes.state(i, start)
    state = torch.from_numpy(now).to(device)
    deforms, batch = bool(predictor.config.position), None
    states, directs, begin = [state.cpu().numpy()], [], time.perf_counter()
    with torch.no_grad():
        for k in range(start, start + steps):
            if batch is None or deforms:
                batch = meshes.batch(i, state.cpu().numpy() if deforms else None).to(device)
            after = meshes.state(i, k + 1)
            motion = None
            if deforms:
                change = after - now if boundary == "prescribed" else 0 * now
                motion = meshes.motion(i, change).to(device)
            new, direct = predictor.step(batch, state, motion)
            given, now = state if boundary == "frozen" else torch.from_numpy(after).to(device), after
            state = torch.where(learned[:, None], new, given)
            states.append(state.cpu().numpy())
            directs.append(direct.cpu().numpy())
    seconds = (time.perf_counter() - begin) / steps
    return np.array(states), np.array(directs), seconds


def rmse(a, b):
    """Root of the mean squared difference."""
    return float(np.sqrt(np.mean((np.asarray(a, float) - b) ** 2)))


def evaluate(predictor, meshes, steps=None, start=0, only=None, every=1, boundary="prescribed"):
    """Errors over trajectories, of the predicted nodes in the units of the state, beside persistence.

    Persistence predicts that nothing changes.

    Parameters
    ----------
    only : numbers of the trajectories, all by default
    every : of the frames, each one of which this many is a start of a single step

    Returns
    -------
    dict
        rmse_1 : of a single step from true states, over all frames
        rmse_50, rmse_all : of the rollout, over its first 50 steps (or all, if it has fewer) and over all
        rmse_at_50, rmse_last : at the ends of these; rmse_<name> : of a field alone, in single steps;
        persistence_* of the same; seconds : for a step
    """
    kinds, names = ("1", "50", "all", "at_50", "last"), (*predictor.config.state, *predictor.config.direct)
    squares = {f"{who}_{kind}": [] for who in ("rmse", "persistence") for kind in kinds}
    seconds = []
    for i in range(len(meshes)) if only is None else only:
        trajectory, learned = meshes[i][0], meshes.learned(i)
        states, _, each = rollout(predictor, meshes, i, steps, start, boundary)
        seconds.append(each)
        truth = np.array([meshes.state(i, start + k) for k in range(len(states))])[:, learned]
        found, at = states[:, learned], min(50, len(states) - 1)
        for who, guess in (("rmse", found), ("persistence", np.broadcast_to(truth[0], truth.shape))):
            parts = {"50": slice(1, at + 1), "all": slice(1, None)}
            parts |= {"at_50": slice(at, at + 1), "last": slice(-1, None)}
            for kind, part in parts.items():
                squares[f"{who}_{kind}"].append(rmse(guess[part], truth[part]) ** 2)
        for k in range(start, len(trajectory) - 1, every):
            one, direct, _ = rollout(predictor, meshes, i, 1, k, boundary)
            single = np.concatenate([one[1], direct[0]], axis=1)[learned]
            before, after = (stack(trajectory, names, j)[learned] for j in (k, k + 1))
            state = slice(one.shape[2])
            squares["rmse_1"].append(rmse(single[:, state], after[:, state]) ** 2)
            squares["persistence_1"].append(rmse(before[:, state], after[:, state]) ** 2)
            for name, own in columns(trajectory, names):
                for who, guess in (("rmse", single), ("persistence", before)):
                    squares.setdefault(f"{who}_{name}", []).append(rmse(guess[:, own], after[:, own]) ** 2)
    return {name: float(np.sqrt(np.mean(v))) for name, v in squares.items()} | {
        "seconds": float(np.mean(seconds))
    }


def columns(trajectory, names):
    """Each name of some fields, and its columns where they are side by side."""
    widths = [trajectory.fields[name] for name in names]
    for name, last, width in zip(names, np.cumsum(widths), widths):
        yield name, slice(last - width, last)


def predicted_fields(meshes, i, states, directs, start=0):
    """Name, predicted and true values (nt, n[, c]) of each field of a `rollout`, direct ones at last.

    In the first frame, from which no step leads to a direct field, the true one stands for it.
    """
    trajectory, config = meshes[i][0], meshes.config
    frames = range(start, start + len(states))
    for names, found in ((config.state, states), (config.direct, directs)):
        if not names:
            continue
        truth = np.array([stack(trajectory, names, k) for k in frames])
        found = np.concatenate([truth[: len(truth) - len(found)], found])
        for name, at in columns(trajectory, names):
            pair = found[..., at], truth[..., at]
            yield name, *(a[..., 0] if trajectory.fields[name] == 1 else a for a in pair)


def write_rollout(path, meshes, i, states, directs, start=0):
    """XDMF of what was predicted, of the truth and of their difference, for each field of a `rollout`."""
    trajectory, fields = meshes[i][0], {}
    for name, found, truth in predicted_fields(meshes, i, states, directs, start):
        fields |= {name: found, f"{name}_truth": truth, f"{name}_error": found - truth}
    write_trajectory(path, trajectory.graph, trajectory.times[start : start + len(states)], fields)
    return path
