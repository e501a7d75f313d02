"""Command lines of scenes: the options that all demos share."""

import argparse
import os
import sys
from pathlib import Path

from .parallel import Ranks


def scene_arguments(description, argv=None, *, until, every=None, **options):
    """Parse the command line of a scene; from here on only the first of several MPI ranks prints.

    Parameters
    ----------
    description : what the scene shows
    argv : arguments, those of the program when not given
    until : default end of the run
    every : default time between output frames, a twentieth of the run when not given
    options : name -> (default, help text), further options; a tuple default lists the choices, the
        first one being the default

    Returns
    -------
    argparse.Namespace
        with the given options, those for `run_options`, and `threads`
    """
    if Ranks().rank > 0:
        sys.stdout = open(os.devnull, "w")
    parser = argparse.ArgumentParser(description=description)

    def add(name, default, text, **kind):
        text += "" if default is None or default is False else " (default: %(default)s)"
        parser.add_argument(f"--{name.replace('_', '-')}", default=default, help=text, **kind)

    for name, (default, text) in options.items():
        if isinstance(default, tuple):
            add(name, default[0], text, choices=default)
        elif isinstance(default, bool):
            add(name, default, text, action="store_true")
        else:
            add(name, default, text, type=type(default))
    add("until", float(until), "end of the run in s", type=float)
    text = "time between output frames in s" + (
        ", a twentieth of the run by default" if every is None else ""
    )
    add("every", every, text, type=float)
    stem = Path(parser.prog).stem.removeprefix("demo_")
    add("output", f"results/{stem}", "files to write, without ending")
    add("restart", None, "checkpoint to go on from", metavar="FILE")
    text = "wall time between checkpoints, none are written by default"
    add("checkpoint_every", None, text, type=float, metavar="SECONDS")
    add("threads", 1, "threads of the transfers", type=int)
    return parser.parse_args(argv)


def run_options(args):
    """Options of `fempm.run` that `scene_arguments` read, as a dict."""
    return {name: getattr(args, name) for name in ("until", "every", "output", "restart", "checkpoint_every")}


def print_files(files):
    """Name the files that a scene wrote, one per line."""
    print("wrote:")
    for path in files:
        print(f"  {path}")
