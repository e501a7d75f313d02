"""A network learns the flow past cylinders: data made by DOLFINx, training, rollouts past unseen cylinders.

By default a tiny set that takes less than ten minutes on two cores; --mini is the set of the README's table
and an hour of training, --full one of the published size, for a GPU. Stopped, the same command goes on."""

import argparse
from pathlib import Path

import dataset_cylinder
import torch

from gnn.config import preset
from gnn.picture import rollout_strip
from gnn.rollout import evaluate, predicted_fields, rollout, write_rollout
from gnn.samples import Meshes, find_trajectories
from gnn.train import train

KINDS = {  # trajectories, their size, how many of them nobody trains on, preset and settings of the training
    "tiny": (24, "mini", 4, "cylinder_mini", {"minutes": 7.0}),
    "mini": (50, "mini", 8, "cylinder_mini", {"minutes": 60.0}),
    "full": (1200, "paper", 200, "cylinder", {"minutes": 1440.0, "batch": 32, "last_rate": 1e-6}),
}


def main(argv=None):
    parser = argparse.ArgumentParser(description=__doc__)
    for kind, what in (("mini", "an hour"), ("full", "a day on a GPU")):
        own = {"action": "store_const", "const": kind, "default": "tiny", "help": what}
        parser.add_argument(f"--{kind}", dest="kind", **own)
    parser.add_argument("--minutes", type=float, help="of training")
    parser.add_argument("--jobs", type=int, default=2, help="processes that make data (default: %(default)s)")
    parser.add_argument("--output", default="results/gnn_cylinder", help="folder of all files")
    args = parser.parse_args(argv)
    trajectories, size, held_out, base, settings = KINDS[args.kind]
    settings = settings | ({} if args.minutes is None else {"minutes": args.minutes})
    data, out = Path(args.output) / f"data_{args.kind}", Path(args.output) / args.kind
    options = {"trajectories": trajectories, "size": size, "jobs": args.jobs, "out": data}
    dataset_cylinder.main([f"--{name}={value}" for name, value in options.items()])
    if args.kind == "tiny":
        torch.set_num_threads(1)  # faster on small meshes
    config = preset(base, data=str(data), held_out=held_out, look_every=10**9, **settings)
    predictor = train(config, out)
    unseen = Meshes(find_trajectories(data)[-held_out:], config, predictor.length)
    found = evaluate(predictor, unseen, every=10)
    print(f"past {held_out} unseen cylinders, {1e3 * found['seconds']:.3g} ms a step; root mean square")
    print("error in m/s       network   nothing changes")
    for name, what in ("1", "one step"), ("50", "over 50 steps"), ("at_50", "after 50"), ("all", "over all"):
        print(f"{what:16} {found[f'rmse_{name}']:9.3g} {found[f'persistence_{name}']:9.3g}")
    states, directs, _ = rollout(predictor, unseen, 0)
    files, trajectory = [write_rollout(out / "rollout.xdmf", unseen, 0, states, directs)], unseen[0][0]
    for name, guess, truth in predicted_fields(unseen, 0, states, directs):
        drawn = trajectory.graph, trajectory.times, truth, guess
        files.append(rollout_strip(out / f"rollout_{name}.png", *drawn, name=name))
    print("files:", *files, sep="\n  ")
    return found


if __name__ == "__main__":
    main()
