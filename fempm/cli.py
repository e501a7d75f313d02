"""Command lines of scenes: the options that all demos share."""

import argparse
import os
import sys
from pathlib import Path

from .parallel import Ranks

PETSC = ("-ksp_", "-pc_")


def scene_arguments(description, argv=None, *, until, every=None, threads=True, **options):
    """Parse the command line of a scene; from here on only the first of several MPI ranks prints.

    Parameters
    ----------
    description : what the scene shows
    argv : arguments, those of the program when not given; PETSc's options (-ksp_..., -pc_...) among them
        are left to the pressure solver of a gas
    until : default end of the run, None where the scene has its own
    every : default time between output frames, a twentieth of the run when not given
    threads : whether there is an option for the threads of the transfers; not where there are no particles
    options : name -> (default, help text), further options; a tuple default lists the choices, the
        first one being the default

    Returns
    -------
    argparse.Namespace
        with the given options, those for `run_options`, and perhaps `threads`
    """
    if Ranks().rank > 0:
        sys.stdout = open(os.devnull, "w")
    more = None if threads else "Options of PETSc, such as -ksp_monitor, go to the solver of the pressure."
    parser = argparse.ArgumentParser(description=description, epilog=more)

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
    add("until", None if until is None else float(until), "end of the run in s", type=float)
    text = "time between output frames in s" + (
        ", a twentieth of the run by default" if every is None else ""
    )
    add("every", every, text, type=float)
    stem = Path(parser.prog).stem.removeprefix("demo_")
    add("output", f"results/{stem}", "files to write, without ending")
    add("restart", None, "checkpoint to go on from", metavar="FILE")
    text = "wall time between checkpoints, none are written by default"
    add("checkpoint_every", None, text, type=float, metavar="SECONDS")
    if threads:
        add("threads", 1, "threads of the transfers", type=int)
    return parser.parse_args(split_petsc(sys.argv[1:] if argv is None else argv)[0])


def split_petsc(argv):
    """The arguments without PETSc's options -ksp_... and -pc_..., and these as pairs (name, value or "")."""
    kept, petsc, open_option = [], [], False
    for word in argv:
        if word.startswith(PETSC):
            petsc.append((word[1:], ""))
            open_option = True
        elif open_option and (not word.startswith("-") or word[1:2].isdigit()):
            petsc[-1] = (petsc[-1][0], word)
            open_option = False
        else:
            kept.append(word)
            open_option = False
    return kept, petsc


def run_options(args):
    """Options of `fempm.run` that `scene_arguments` read, as a dict."""
    return {name: getattr(args, name) for name in ("until", "every", "output", "restart", "checkpoint_every")}


def print_files(files):
    """Name the files that a scene wrote, one per line."""
    print("wrote:")
    for path in files:
        print(f"  {path}")
