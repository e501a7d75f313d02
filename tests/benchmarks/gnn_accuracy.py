"""Networks trained on cylinder flows: architectures, transitions, seeds (thesis tables 4.5, 4.7, 4.8)."""

import json
import os
import shutil
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from .gnn_models import own_process
from .memory import peak_memory

ROOT = Path(__file__).parents[2]
ARCHITECTURES = {"bsms": 3, "meshgraphnets": 3, "ms_gnn_grid": 1, "graph_unets": 1}  # trainings
TRANSITIONS = ("contribution", "none", "graph_conv", "position_kernel", "learnable")
OTHER_SETS = {"airfoil": 20, "plate": 8, "font": 50}  # trajectories


def make_data(folder, trajectories, *more, kind="cylinder"):
    """The mini set of cylinder flows, or another kind, made where it is not there yet."""
    script = ROOT / f"demos/dataset_{kind}.py"
    options = ["--trajectories", str(trajectories), "--out", str(folder), "--jobs", "2", *more]
    subprocess.run([sys.executable, str(script), *options], check=True, cwd=ROOT)


def trained(folder, out, minutes, **changes):
    """Train in a process of its own, for a time, and return the row of a table.

    Errors are of the trajectories in the folder `test`, without it of those that the training has held out.
    """
    own = {"data": str(folder), "minutes": minutes, "look_every": 10**9}
    options = own | changes
    return own_process(__name__, options, str(out))


def worker(options, out):
    """Train and evaluate; prints the row."""
    from gnn.config import preset
    from gnn.rollout import evaluate
    from gnn.samples import Meshes, find_trajectories
    from gnn.train import Training

    test = options.pop("test", None)
    training = Training(preset(options.pop("preset", "cylinder_mini"), **options), out)
    training.load()
    predictor = training.run().eval()
    unseen = training.held_out
    if test:
        unseen = Meshes(find_trajectories(test), predictor.config, predictor.length)
    found = evaluate(predictor, unseen, every=10)
    row = {"parameters": sum(p.numel() for p in predictor.parameters()), "steps": training.step}
    row["ms_per_step"] = 1e3 * training.seconds / max(training.step, 1)
    row["infer_ms"] = 1e3 * found.pop("seconds")
    row["GB"] = peak_memory() / 1e9
    print(json.dumps(row | found))


def trained_together(calls, **shared):
    """Rows of `trained` with the arguments of each call and the shared ones, one at a time on each core."""
    with ThreadPoolExecutor(len(os.sched_getaffinity(0))) as pool:
        return list(pool.map(lambda own: trained(**shared, **own), calls))


def architectures(folder, test, out, minutes, most):
    """A row for each training of each architecture, at most so many, after the same time on one core."""
    shutil.rmtree(out, ignore_errors=True)  # what an earlier run has trained
    labels = [{"model": m, "seed": s} for m, n in ARCHITECTURES.items() for s in range(min(n, most))]
    calls = [{"out": Path(out) / f"{m['model']}_{m['seed']}"} | m for m in labels]
    found = trained_together(calls, folder=folder, minutes=minutes, test=str(test))
    return [label | row for label, row in zip(labels, found)]


def means(rows, test):
    """A row for each architecture, of means over its seeds; speed-up: of a frame over the solver."""
    solver, found = solver_ms(test), []
    for name in ARCHITECTURES:
        own = [row for row in rows if row["model"] == name]
        row = {k: sum(r[k] for r in own) / len(own) for k in own[0] if k not in ("model", "seed")}
        found.append({"model": name, "trainings": len(own)} | row | {"speed-up": solver / row["infer_ms"]})
    return found


def transitions(folder, test, out, minutes, first):
    """A row for each transition between levels (table 4.7); the first one is that of `architectures`."""
    calls = [{"out": Path(out) / f"transition_{name}", "transition": name} for name in TRANSITIONS[1:]]
    found = trained_together(calls, folder=folder, minutes=minutes, test=str(test))
    first = {k: v for k, v in first.items() if k not in ("model", "seed")}
    return [{"transition": name} | row for name, row in zip(TRANSITIONS, [first, *found])]


def other_sets(folder, out, minutes):
    """A row for each error on aerofoils, plates and letters that were not trained on, beside persistence."""
    calls, rows = [], []
    for kind, trajectories in OTHER_SETS.items():
        make_data(folder / kind, trajectories, kind=kind)
        calls.append({"folder": folder / kind, "out": Path(out) / kind, "preset": f"{kind}_mini"})
    for kind, found in zip(OTHER_SETS, trained_together(calls, minutes=minutes)):
        for name in (k for k in found if k.startswith("rmse_")):
            other = found[name.replace("rmse", "persistence")]
            row = {"set": kind, "error": name, "network": found[name], "persistence": other}
            rows.append(row | {"ratio": other / found[name]})
    return rows


def solver_ms(folder, frames=10):
    """CPU milliseconds in which the solver that made the flows of a folder takes a frame of them."""
    sys.path.insert(0, str(ROOT / "demos"))
    import time

    import dataset_cylinder as data
    import h5py

    from gnn.samples import find_trajectories

    seconds = []
    for path in find_trajectories(folder):
        with h5py.File(path.with_suffix(".h5"), "r") as h5:
            about = dict(h5.attrs)
        steps, (mesh, facets, _) = about["steps_per_frame"], data.mesh_past("mini", about)
        flow = data.channel_flow(mesh, facets, about["peak"], data.EVERY / steps)
        begin = time.process_time()
        for _ in range(frames * steps):
            flow.step()
        seconds.append((time.process_time() - begin) / frames)
    return 1e3 * sum(seconds) / len(seconds)


def larger_meshes(test, out, first):
    """Errors of the first trained network on its own size of mesh, its row, and on one five times as fine."""
    from gnn.rollout import evaluate
    from gnn.samples import Meshes, find_trajectories
    from gnn.train import load_predictor

    predictor, large = load_predictor(Path(out) / "bsms_0"), test.parent / "cylinder_large"
    make_data(large, 2, "--size", "large", "--seed", "1")
    small, fine = (
        Meshes(find_trajectories(folder), predictor.config, predictor.length) for folder in (test, large)
    )
    found = evaluate(predictor, fine, every=10)
    found = {"infer_ms": 1e3 * found.pop("seconds")} | found
    rows = ("mini", small, {k: first[k] for k in found}), ("large", fine, found)
    return [{"meshes": name, "nodes": round(mean_nodes(meshes))} | row for name, meshes, row in rows]


def mean_nodes(meshes):
    """Mean number of nodes."""
    return sum(len(meshes[i][0].graph.points) for i in range(len(meshes))) / len(meshes)


def seeding(test, out, first):
    """Errors with other seeds than those of the training, over those with the same, its row (table 4.8)."""
    import dataclasses

    from gnn.rollout import evaluate
    from gnn.samples import Meshes, find_trajectories
    from gnn.train import load_predictor

    predictor, rows = load_predictor(Path(out) / "bsms_0"), []
    for kind in ("close_center", "random"):
        config = dataclasses.replace(predictor.config, seeding=kind)
        found = evaluate(predictor, Meshes(find_trajectories(test), config, predictor.length), every=10)
        names = "rmse_1", "rmse_50", "rmse_all"
        rows.append({"seeds": kind} | {f"{name} ratio": found[name] / first[name] for name in names})
    return rows


if __name__ == "__main__":
    worker(*json.loads(sys.argv[1]))
