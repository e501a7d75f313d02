"""Networks trained on cylinder flows: architectures, transitions, seeds (thesis tables 4.5, 4.7, 4.8)."""

import json
import resource
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]
ARCHITECTURES = ("bsms", "meshgraphnets", "ms_gnn_grid", "graph_unets")
TRANSITIONS = ("contribution", "none", "graph_conv", "position_kernel", "learnable")
HELD_OUT = 4  # trajectories with cylinders that no training sees
SETTINGS = {"latent": 64, "depth": 4, "batch": 4, "held_out": HELD_OUT, "noise": (0.01,), "look_every": 10**9}


def make_data(folder, trajectories):
    """The mini set of cylinder flows, made where it is not there yet."""
    script = ROOT / "demos/dataset_cylinder.py"
    options = ["--trajectories", str(trajectories), "--size", "mini", "--out", str(folder), "--jobs", "2"]
    subprocess.run([sys.executable, str(script), *options], check=True, cwd=ROOT)


def trained(folder, out, minutes, **changes):
    """Train in a process of its own, for a time, and return the row of a table."""
    options = {**SETTINGS, "data": str(folder), "minutes": minutes, **changes}
    command = [sys.executable, __file__, json.dumps(options), str(out)]
    done = subprocess.run(command, check=True, cwd=ROOT, capture_output=True, text=True)
    return json.loads(done.stdout.splitlines()[-1])


def worker(options, out):
    """Train and evaluate; prints the row."""
    import torch

    from gnn.config import Config
    from gnn.rollout import evaluate
    from gnn.train import Training

    torch.set_num_threads(1)
    options["noise"] = tuple(options["noise"])
    training = Training(Config(**options), out)
    training.load()
    predictor = training.run().eval()
    found = evaluate(predictor, training.held_out, every=10)
    row = {"parameters": sum(p.numel() for p in predictor.parameters()), "steps": training.step}
    row["ms_per_step"] = 1e3 * training.seconds / max(training.step, 1)
    row["infer_ms"] = 1e3 * found.pop("seconds")
    row["GB"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    print(json.dumps(row | found))


def architectures(folder, out, minutes):
    """A row for each architecture after the same time of training."""
    rows = []
    for name in ARCHITECTURES:
        rows.append({"model": name} | trained(folder, Path(out) / name, minutes, model=name))
    return rows


def transitions(folder, out, minutes):
    """A row for each transition between levels (table 4.7); the first one is that of `architectures`."""
    rows = []
    for name in TRANSITIONS:
        place = Path(out) / ("bsms" if name == "contribution" else f"transition_{name}")
        rows.append({"transition": name} | trained(folder, place, minutes, transition=name))
    return rows


def seeding(folder, out):
    """Errors with other seeds than those of the training, over those with the same (table 4.8)."""
    import dataclasses

    from gnn.rollout import evaluate
    from gnn.samples import Meshes, find_trajectories
    from gnn.train import load_predictor

    predictor = load_predictor(Path(out) / "bsms")
    paths, found = find_trajectories(folder)[-HELD_OUT:], {}
    for kind in ("min_average", "close_center", "random"):
        config = dataclasses.replace(predictor.config, seeding=kind)
        found[kind] = evaluate(predictor, Meshes(paths, config, predictor.length), every=10)
    rows = []
    for kind in ("close_center", "random"):
        row = {"seeds": kind}
        for name in ("rmse_1", "rmse_50", "rmse_all"):
            row[name + " ratio"] = found[kind][name] / found["min_average"][name]
        rows.append(row)
    return rows


if __name__ == "__main__":
    worker(json.loads(sys.argv[1]), sys.argv[2])
