"""The hot kernels: Numba for the CPU, and plain torch beside those of stage 1, with one signature.

Numba reads its settings from a file in the current folder when it is imported, if PyYAML is installed. They may name a
folder of a stranger, from which Numba would load compiled kernels. So Numba is imported here, in a neutral folder.
"""

import contextlib

from blender_nep.safety.isolated_python import NEUTRAL_FOLDER

with contextlib.chdir(NEUTRAL_FOLDER):
    import numba

__all__ = ["numba"]
