"""Command line of a script that runs under `blender -b -P SCRIPT -- ...` as well as `python SCRIPT ...`."""

import sys


def script_arguments() -> list[str]:
    """The arguments after `--` if there is a `--`; otherwise those after the script's name."""
    if "--" in sys.argv:
        return sys.argv[sys.argv.index("--") + 1 :]
    return sys.argv[1:]
