"""`python -m blender_nep` is `blender-nep`."""

import sys

from blender_nep.cli import main

sys.exit(main())
