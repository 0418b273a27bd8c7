"""Runs the command line `blender-nep` for `python -m blender_nep`."""

import sys

from blender_nep.cli import main

sys.exit(main())
