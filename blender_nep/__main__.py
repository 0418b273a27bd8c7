"""Runs the command line `blender-nep` for `python -m blender_nep`."""

import sys

if not sys.flags.safe_path:
    del sys.path[0]  # the current folder, which may hold files of strangers: `python -m` has put it before all packages

from blender_nep.cli import main

sys.exit(main())
