"""Command line: `python -m gnn train|evaluate|rollout|convert ...`."""

import argparse
import json
import sys
from pathlib import Path


def main(argv=None):
    """Run one of the commands."""
    from .config import PRESETS, add_arguments

    parser = argparse.ArgumentParser(prog="python -m gnn", description="Learned simulation on meshes.")
    commands = parser.add_subparsers(required=True)
    training = commands.add_parser("train", help="train, or go on with a training")
    training.add_argument("--preset", choices=PRESETS, default="cylinder")
    training.add_argument("--out", default="results/gnn", help="folder of checkpoint.pt and log.jsonl")
    add_arguments(training)
    training.set_defaults(run=train)
    for name, run, text in (
        ("evaluate", evaluate, "errors of a trained network, beside persistence, as JSON"),
        ("rollout", rollout, "XDMF and picture of a rollout beside the truth"),
    ):
        command = commands.add_parser(name, help=text)
        command.add_argument("checkpoint", help="checkpoint.pt or its folder")
        command.add_argument("data", help="folder of trajectories, or one of them")
        command.add_argument("--all", action="store_true", help="also the trajectories that were trained on")
        command.add_argument("--steps", type=int)
        command.add_argument("--start", type=int, default=0)
        command.add_argument("--boundary", default="prescribed", help="or frozen")
        command.set_defaults(run=run)
        if run is rollout:
            command.add_argument("--number", type=int, default=0, help="which of the trajectories")
            command.add_argument("--out", default="results/gnn", help="folder of the files")
            command.add_argument("--gif", action="store_true")
    converting = commands.add_parser("convert", help="XDMF of a published TFRecord file")
    converting.add_argument("tfrecord")
    converting.add_argument("meta", help="its meta.json")
    converting.add_argument("--out", required=True)
    converting.set_defaults(run=convert)
    args = parser.parse_args(argv)
    args.run(args)


def train(args):
    """Train as the options say."""
    from .config import from_arguments
    from .train import train

    train(from_arguments(args), args.out)
    print(Path(args.out) / "checkpoint.pt")


def opened(args):
    """Predictor of a checkpoint, and the meshes of a data set for it."""
    from .samples import Meshes, find_trajectories
    from .train import load_predictor

    predictor = load_predictor(args.checkpoint)
    paths, config = [args.data], predictor.config
    if not args.data.endswith(".xdmf"):
        paths = find_trajectories(args.data)
        if config.held_out and not args.all and Path(args.data).resolve() == Path(config.data).resolve():
            paths = paths[-config.held_out :]
            print(f"the {len(paths)} trajectories that were not trained on (--all for all)", file=sys.stderr)
    return predictor, Meshes(paths, config, predictor.length)


def evaluate(args):
    """Print errors."""
    from .rollout import evaluate

    predictor, meshes = opened(args)
    found = evaluate(predictor, meshes, args.steps, args.start, boundary=args.boundary)
    print(json.dumps(found, indent=1))


def rollout(args):
    """Write the files of a rollout."""
    from .picture import rollout_film, rollout_strip
    from .rollout import predicted_fields, rollout, write_rollout

    predictor, meshes = opened(args)
    out, deforms = Path(args.out), bool(predictor.config.position)
    out.mkdir(parents=True, exist_ok=True)
    states, directs, seconds = rollout(predictor, meshes, args.number, args.steps, args.start, args.boundary)
    print(f"{len(states) - 1} steps, {1e3 * seconds:.3g} ms each")
    print(write_rollout(out / "rollout.xdmf", meshes, args.number, states, directs, args.start))
    trajectory = meshes[args.number][0]
    times = trajectory.times[args.start : args.start + len(states)]
    for name, found, truth in predicted_fields(meshes, args.number, states, directs, args.start):
        same = trajectory.graph, times, truth, found
        print(rollout_strip(out / f"rollout_{name}.png", *same, name=name, deforms=deforms))
        if args.gif:
            print(rollout_film(out / f"rollout_{name}.gif", *same, name=name, deforms=deforms))


def convert(args):
    """Convert a published set."""
    from .tfrecord import convert_tfrecord

    convert_tfrecord(args.tfrecord, args.meta, args.out)
    print(args.out)


if __name__ == "__main__":
    main()
