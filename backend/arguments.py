"""Command line of a script that runs under `blender -b -P SCRIPT -- ...` as well as `python SCRIPT ...`."""

import sys


def script_arguments() -> list[str]:
    """What stands after `--` where there is one; after the script's name otherwise."""
    if "--" in sys.argv:
        return sys.argv[sys.argv.index("--") + 1 :]
    return sys.argv[1:]
