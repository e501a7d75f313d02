"""Networks trained on cylinder flows: architectures, transitions, seeds (thesis tables 4.5, 4.7, 4.8)."""

import json
import resource
import shutil
import subprocess
import sys
from pathlib import Path

from gnn.config import PRESETS

from .gnn_models import own_process

ROOT = Path(__file__).parents[2]
ARCHITECTURES = ("bsms", "meshgraphnets", "ms_gnn_grid", "graph_unets")
TRANSITIONS = ("contribution", "none", "graph_conv", "position_kernel", "learnable")
HELD_OUT = PRESETS["cylinder_mini"]["held_out"]  # trajectories with cylinders that no training sees
OTHER_SETS = {"airfoil": 20, "plate": 8, "font": 50}  # trajectories


def make_data(folder, trajectories, *more, kind="cylinder"):
    """The mini set of cylinder flows, or another kind, made where it is not there yet."""
    script = ROOT / f"demos/dataset_{kind}.py"
    options = ["--trajectories", str(trajectories), "--out", str(folder), "--jobs", "2", *more]
    subprocess.run([sys.executable, str(script), *options], check=True, cwd=ROOT)


def trained(folder, out, minutes, **changes):
    """Train in a process of its own, for a time, and return the row of a table."""
    own = {"data": str(folder), "minutes": minutes, "look_every": 10**9}
    options = own | changes
    return own_process(__name__, options, str(out))


def worker(options, out):
    """Train and evaluate; prints the row."""
    from gnn.config import preset
    from gnn.rollout import evaluate
    from gnn.train import Training

    training = Training(preset(options.pop("preset", "cylinder_mini"), **options), out)
    training.load()
    predictor = training.run().eval()
    found = evaluate(predictor, training.held_out, every=10)
    row = {"parameters": sum(p.numel() for p in predictor.parameters()), "steps": training.step}
    row["ms_per_step"] = 1e3 * training.seconds / max(training.step, 1)
    row["infer_ms"] = 1e3 * found.pop("seconds")
    row["GB"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    print(json.dumps(row | found))


def architectures(folder, out, minutes):
    """A row for each architecture after the same time of training; speed-up: of a frame over the solver."""
    shutil.rmtree(out, ignore_errors=True)  # what an earlier run has trained
    rows, solver = [], solver_ms(folder)
    for name in ARCHITECTURES:
        row = {"model": name} | trained(folder, Path(out) / name, minutes, model=name)
        rows.append(row | {"speed-up": solver / row["infer_ms"]})
    return rows


def transitions(folder, out, minutes, first):
    """A row for each transition between levels (table 4.7); the first one is that of `architectures`."""
    kept = {k: v for k, v in first.items() if k not in ("model", "speed-up")}
    rows = [{"transition": TRANSITIONS[0]} | kept]
    for name in TRANSITIONS[1:]:
        place = Path(out) / f"transition_{name}"
        rows.append({"transition": name} | trained(folder, place, minutes, transition=name))
    return rows


def other_sets(folder, out, minutes):
    """A row for each error on aerofoils, plates and letters that were not trained on, beside persistence."""
    rows = []
    for kind, trajectories in OTHER_SETS.items():
        data = folder / kind
        make_data(data, trajectories, kind=kind)
        found = trained(data, Path(out) / kind, minutes, preset=f"{kind}_mini")
        for name in (k for k in found if k.startswith("rmse_")):
            other = found[name.replace("rmse", "persistence")]
            row = {"set": kind, "error": name, "network": found[name], "persistence": other}
            rows.append(row | {"ratio": other / found[name]})
    return rows


def solver_ms(folder, frames=10):
    """CPU milliseconds in which the solver that made the data takes a frame of the unseen flows."""
    sys.path.insert(0, str(ROOT / "demos"))
    import time

    import dataset_cylinder as data
    import h5py

    from gnn.samples import find_trajectories

    seconds = []
    for path in find_trajectories(folder)[-HELD_OUT:]:
        with h5py.File(path.with_suffix(".h5"), "r") as h5:
            about = dict(h5.attrs)
        steps, (mesh, facets, _) = about["steps_per_frame"], data.mesh_past("mini", about)
        flow = data.channel_flow(mesh, facets, about["peak"], data.EVERY / steps)
        begin = time.process_time()
        for _ in range(frames * steps):
            flow.step()
        seconds.append((time.process_time() - begin) / frames)
    return 1e3 * sum(seconds) / len(seconds)


def larger_meshes(folder, out):
    """Errors of the trained network on its own size of mesh and on one five times as fine."""
    from gnn.rollout import evaluate
    from gnn.samples import Meshes, find_trajectories
    from gnn.train import load_predictor

    predictor, rows = load_predictor(Path(out) / "bsms"), []
    large = folder.parent / "cylinder_large"
    make_data(large, 2, "--size", "large", "--seed", "1")
    for name, paths in (
        ("mini", find_trajectories(folder)[-HELD_OUT:]),
        ("large", find_trajectories(large)),
    ):
        meshes = Meshes(paths, predictor.config, predictor.length)
        nodes = sum(len(meshes[i][0].graph.points) for i in range(len(meshes))) / len(meshes)
        found = evaluate(predictor, meshes, every=10)
        rows.append(
            {"meshes": name, "nodes": round(nodes)} | {"infer_ms": 1e3 * found.pop("seconds")} | found
        )
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
    worker(*json.loads(sys.argv[1]))
