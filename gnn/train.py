"""Training: noise on the inputs, Muon or Adam, exact checkpoints, several processes by torchrun."""

import ctypes
import gc
import json
import os
import signal
import sys
import threading
import time
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import torch
import torch.distributed as dist

from .optimizers import learning_rate, make_optimizers
from .predictor import from_description, make_predictor
from .rollout import evaluate
from .samples import (
    Meshes,
    count_frames,
    drawn,
    find_trajectories,
    importance,
    join_samples,
    make_sample,
    mean_edge_length,
)

# settings that a checkpoint and the training that goes on from it have in common
SAME = ("model", "latent", "depth", "steps_flat", "repeats", "transition", "contact_radius", "optimizer")
SAME += ("fields", "direct", "position", "predicted", "moving", "edge_latents", "correction")


class BadCheckpoint(ValueError):
    """A file that is no checkpoint of a training, or of another one."""


class Training:
    """A training that can be stopped and gone on with.

    Parameters
    ----------
    config : Config
    out : folder of checkpoint.pt and log.jsonl

    Attributes
    ----------
    predictor : Predictor; step : steps done; seconds : time spent
    """

    def __init__(self, config, out):
        keep_memory()
        # the momentum of dead units decays to denormal numbers, which make a step take 1.7 times as long
        torch.set_flush_denormal(True)
        self.config, self.out = config, Path(out)
        self.rank, self.size = start_processes()
        self.device = torch.device("cpu")
        if on_gpu():
            self.device = torch.device("cuda", torch.cuda.current_device())
        if config.batch < self.size:
            raise ValueError(
                f"batch {config.batch}: give at least one mesh for each of {self.size} processes"
            )
        torch.manual_seed(config.seed)
        paths = find_trajectories(config.data)
        if not 0 <= config.held_out < len(paths):
            raise ValueError(f"held_out {config.held_out}: {config.data} has {len(paths)} trajectories")
        split = len(paths) - config.held_out
        self.meshes, self.held_out = Meshes(paths[:split], config), Meshes(paths[split:], config)
        self.meshes.length = self.held_out.length = mean_edge_length(self.meshes)
        self.frames = count_frames(self.meshes)
        self.predictor = make_predictor(config, self.meshes).to(self.device)
        self.predictor.fit_normalisation(self.meshes, self.frames)
        if config.compile:
            self.predictor.model.compile(dynamic=True)
        scale = self.predictor.mean_out.cpu().numpy(), self.predictor.deviation_out.cpu().numpy()
        self.shares = importance(self.meshes, *scale)
        self.terms = Terms(self.predictor)
        if self.size > 1:
            self.terms = torch.nn.parallel.DistributedDataParallel(self.terms)
        self.optimizers = make_optimizers(self.predictor, config)
        self.step, self.seconds, self.order = 0, 0.0, (-1, None)

    def run(self):
        """Train to the end, or until Ctrl-C; a checkpoint is written in any case."""
        c, saved, shown = self.config, time.monotonic(), 0.0
        self.out.mkdir(parents=True, exist_ok=True)
        with open(self.out / "log.jsonl", "a", encoding="utf-8") as log, interruptible() as asked:
            stop = 0
            while (done := self.progress()) < 1 and not stop:
                begin = time.monotonic()
                loss, norm = self.train_step(done)
                now = time.monotonic()
                spent, age, stop = self.agreed(now - begin, now - saved, len(asked))
                self.seconds += spent
                row = {"step": self.step, "loss": loss, "norm": norm, "seconds": self.seconds}
                row["rate"] = self.optimizers[0].param_groups[0]["lr"]
                if self.step % c.look_every == 0:
                    row |= self.look()
                if self.rank == 0:
                    print(json.dumps(row), file=log, flush=self.step % 100 == 0 or len(row) > 5)
                    shown = show(done, row, shown)
                if age > 60 * c.save_minutes:
                    self.save()
                    saved = time.monotonic()
            self.save()
            if stop and self.rank == 0:
                print("\nstopped: the same command goes on from the checkpoint", file=sys.stderr)
        if self.rank == 0:
            print(file=sys.stderr)
        return self.predictor

    def progress(self):
        """Share of the training that is done, of the time or of the steps."""
        c = self.config
        return self.seconds / (60 * c.minutes) if c.minutes else self.step / c.steps

    def agreed(self, *values):
        """The first process's times and wishes, so that all save and stop at the same step."""
        if self.size == 1:
            return values
        shared = torch.tensor(values, dtype=torch.float64)
        dist.broadcast(shared, 0)
        return shared.tolist()

    def train_step(self, done):
        """One step; returns the mean squared error of all processes and the norm of the gradient."""
        c = self.config
        for optimizer in self.optimizers:
            for group in optimizer.param_groups:
                group["lr"], group["weight_decay"] = learning_rate(c, done), c.weight_decay
        sample = join_samples([self.sample(n) for n in self.chosen()]).to(self.device)
        self.predictor.zero_grad(set_to_none=True)
        with torch.autocast("cuda", torch.bfloat16, enabled=self.device.type == "cuda"):
            total, count = self.terms(sample)
        # gradients are averaged over the processes: times their number, over the nodes of all of them
        sums = self.summed(torch.tensor([total.item(), count], dtype=torch.float64))
        (total * (self.size / sums[1].item())).backward()
        norm = torch.nn.utils.clip_grad_norm_(self.predictor.parameters(), c.clip)
        if not torch.isfinite(sums[0] + norm):
            raise FloatingPointError(
                f"step {self.step}: loss {sums[0].item():.3g}, gradient {norm.item():.3g}; the last "
                "checkpoint stays: go on with a lower rate, or look for infinite values in the data"
            )
        for optimizer in self.optimizers:
            optimizer.step()
        self.step += 1
        return (sums[0] / sums[1]).item(), norm.item()

    def summed(self, values):
        """Sum of a tensor over the processes."""
        if self.size > 1:
            dist.all_reduce(values)
        return values

    def chosen(self):
        """Numbers in the course of the training of the samples of this process's share of a batch."""
        first = self.step * self.config.batch
        return range(first + self.rank, first + self.config.batch, self.size)

    def sample(self, number):
        """A sample by its number: order and noise depend on it and the seed only, whoever draws it."""
        epoch, place = divmod(number, len(self.frames))
        if self.order[0] != epoch:
            rng = np.random.default_rng([self.config.seed, epoch])
            self.order = epoch, rng.permutation(drawn(self.shares, rng.random()))
        chosen = int(self.order[1][place])
        i, k = self.frames[chosen]
        noise = np.random.default_rng([self.config.seed, epoch, place])
        sample = make_sample(self.meshes, int(i), int(k), noise)
        sample.weight /= np.float32(len(self.frames) * self.shares[chosen])
        return sample

    def look(self):
        """Errors of a rollout of the first trajectory that is held out."""
        if not len(self.held_out) or self.rank:
            return {}
        found = evaluate(self.predictor, self.held_out, steps=self.config.look_steps, only=(0,), every=10)
        return {name: found[name] for name in ("rmse_1", "rmse_last", "persistence_1", "persistence_last")}

    def save(self):
        """Write checkpoint.pt, which is there as a whole or not at all."""
        if self.rank:
            return
        state = {"kind": "gnn training", "step": self.step, "seconds": self.seconds}
        state |= {
            "predictor": self.predictor.state_dict(),
            "optimizers": [o.state_dict() for o in self.optimizers],
        }
        state |= {"about": self.predictor.describe(), "random": torch.get_rng_state()}
        part = self.out / "checkpoint.part"
        torch.save(state, part)
        os.replace(part, self.out / "checkpoint.pt")

    def load(self):
        """Go on from checkpoint.pt, where there is one; raises BadCheckpoint for one of another training."""
        path = self.out / "checkpoint.pt"
        if not path.exists():
            return
        state = read_checkpoint(path)
        mine, theirs = self.predictor.describe(), state["about"]
        pairs = [(name, mine["config"][name], theirs["config"].get(name)) for name in SAME]
        pairs += [("dim", mine["dim"], theirs["dim"]), ("widths", mine["widths"], tuple(theirs["widths"]))]
        for name, own, other in pairs:
            if own != other:
                raise BadCheckpoint(
                    f"{path}: of a training with {name} {other!r}, not {own!r}; give another folder"
                )
        take_up(self.predictor, state, path)
        self.predictor.length = theirs["length"]
        for meshes in (self.meshes, self.held_out):
            meshes.length = theirs["length"]
        for optimizer, kept in zip(self.optimizers, state["optimizers"], strict=True):
            optimizer.load_state_dict(kept)
        torch.set_rng_state(state["random"])
        self.step, self.seconds = state["step"], state["seconds"]

    def close(self):
        """Leave the other processes of torchrun: threads of gloo that outlive Python would abort this one."""
        if self.size > 1:
            self.terms = None
            gc.collect()
            dist.destroy_process_group()


class Terms(torch.nn.Module):
    """The terms of the loss as what `forward` returns, as DistributedDataParallel wants it."""

    def __init__(self, predictor):
        super().__init__()
        self.predictor = predictor

    def forward(self, sample):
        return self.predictor.loss_terms(sample)


def start_processes():
    """Rank and number of the processes that torchrun has started, 0 and 1 without it."""
    if "WORLD_SIZE" not in os.environ or int(os.environ["WORLD_SIZE"]) == 1:
        return 0, 1
    if not dist.is_initialized():
        # imported later, as DistributedDataParallel does, its default arguments keep the group alive for ever
        from torch.distributed import nn  # noqa: F401

        dist.init_process_group("cpu:gloo,cuda:nccl" if on_gpu() else "gloo")
    if on_gpu():
        local, number = int(os.environ["LOCAL_RANK"]), torch.cuda.device_count()
        if local >= number:
            raise ValueError(f"{local + 1} processes or more on {number} GPU(s): start one process for each")
        torch.cuda.set_device(local)
    return dist.get_rank(), dist.get_world_size()


@contextmanager
def interruptible():
    """A list that Ctrl-C fills, so that a step is never left half made; a second one ends at once."""
    asked, main = [], threading.current_thread() is threading.main_thread()
    if not main:
        yield asked
        return

    def ask(*_):
        if asked:
            raise KeyboardInterrupt
        asked.append(True)

    before = signal.signal(signal.SIGINT, ask)
    try:
        yield asked
    finally:
        signal.signal(signal.SIGINT, before)


def keep_memory():
    """Let glibc keep what is freed, for all of this process; elsewhere nothing happens.

    Otherwise the pages of every large array are mapped and cleared anew in each step: at 47,000 nodes 10 s of
    the 26 s of a step.
    """
    mmap_max, trim_threshold = -4, -1  # of malloc.h
    try:
        mallopt = ctypes.CDLL("libc.so.6").mallopt
    except (OSError, AttributeError):
        return
    mallopt(mmap_max, 0)
    mallopt(trim_threshold, -1)


def on_gpu():
    """Whether torch finds a GPU."""
    return torch.cuda.is_available()


def read_checkpoint(path):
    """What a checkpoint holds; raises BadCheckpoint where it cannot be read."""
    try:
        state = torch.load(path, map_location="cpu", weights_only=True)
    except FileNotFoundError:
        raise
    except Exception as error:
        raise BadCheckpoint(f"{path}: cannot be read ({error}); delete it to start anew") from None
    if not isinstance(state, dict) or state.get("kind") != "gnn training":
        raise BadCheckpoint(f"{path}: not a checkpoint of a training of gnn")
    return state


def take_up(predictor, state, path):
    """Give a predictor the weights of a checkpoint; raises BadCheckpoint where they are another's."""
    try:
        predictor.load_state_dict(state["predictor"])
    except RuntimeError as error:
        raise BadCheckpoint(f"{path}: of another network, delete it to start anew; {error}") from None


def load_predictor(path):
    """The trained Predictor of a checkpoint, or of the folder of a training."""
    path = Path(path)
    path = path / "checkpoint.pt" if path.is_dir() else path
    state = read_checkpoint(path)
    try:
        predictor = from_description(state["about"])
    except TypeError as error:  # a setting that is not there any more
        raise BadCheckpoint(f"{path}: of another version of gnn ({error}); train it again") from None
    take_up(predictor, state, path)
    return predictor.eval()


def show(done, row, shown):
    """A line of progress: on a terminal ten times a second, else at every tenth of the training."""
    tty, now = sys.stderr.isatty(), time.monotonic()
    reached = now if tty else done
    if reached >= shown:
        looked = f"  rollout {row['rmse_last']:.3g}" if "rmse_last" in row else ""
        text = f"[{'#' * int(24 * done):<24}] step {row['step']}  loss {row['loss']:.4g}{looked}"
        print(f"\r{text}\x1b[K" if tty else text, end="" if tty else "\n", file=sys.stderr, flush=True)
        return now + 0.1 if tty else (np.floor(10 * done + 1e-9) + 1) / 10
    return shown


def train(config, out):
    """Train, or go on with a training; returns its Predictor."""
    training = Training(config, out)
    training.load()
    predictor = training.run().eval()
    training.close()
    return predictor
