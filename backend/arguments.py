"""Reads the command line of a script that runs as `blender -b -P SCRIPT -- ...` or as `python SCRIPT ...`."""

import argparse
import sys
from pathlib import Path


def path_argument(text: str) -> Path:
    """A path that is named on the command line. Raises ArgumentTypeError where it is empty."""
    if not text:  # Path would take it for the current folder
        raise argparse.ArgumentTypeError("must not be empty; a point is the current folder")
    return Path(text)


def script_arguments() -> list[str]:
    """The script's own arguments: those after `--` if there is a `--`, otherwise those after the script's name."""
    if "--" in sys.argv:
        return sys.argv[sys.argv.index("--") + 1 :]
    return sys.argv[1:]
