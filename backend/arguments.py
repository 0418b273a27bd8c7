"""Reads the command line of a script that runs as `blender -b -P SCRIPT -- ...` or as `python SCRIPT ...`."""

import sys


def script_arguments() -> list[str]:
    """The script's own arguments: those after `--` if there is a `--`, otherwise those after the script's name."""
    if "--" in sys.argv:
        return sys.argv[sys.argv.index("--") + 1 :]
    return sys.argv[1:]
