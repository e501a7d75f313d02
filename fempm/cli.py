"""Command lines of scenes: the options that all demos share."""

import argparse
from pathlib import Path


def scene_arguments(description, argv=None, **options):
    """Parse the command line of a scene.

    Parameters
    ----------
    description : what the scene shows
    argv : arguments, those of the program when not given
    options : name -> (default, help text), further options; a tuple default lists the choices, the
        first one being the default

    Returns
    -------
    argparse.Namespace
        with the given options, `output` (path without ending) and `threads`
    """
    formatter = argparse.ArgumentDefaultsHelpFormatter
    parser = argparse.ArgumentParser(description=description, formatter_class=formatter)
    for name, (default, text) in options.items():
        flag = f"--{name.replace('_', '-')}"
        if isinstance(default, tuple):
            parser.add_argument(flag, choices=default, default=default[0], help=text)
        elif isinstance(default, bool):
            parser.add_argument(flag, action="store_true", help=text)
        else:
            parser.add_argument(flag, type=type(default), default=default, help=text)
    stem = Path(parser.prog).stem.removeprefix("demo_")
    parser.add_argument("--output", default=f"results/{stem}", help="files to write, without ending")
    parser.add_argument("--threads", type=int, default=1, help="threads of the transfers")
    return parser.parse_args(argv)


def print_files(files):
    """Name the files that a scene wrote, one per line."""
    print("wrote:")
    for path in files:
        print(f"  {path}")
