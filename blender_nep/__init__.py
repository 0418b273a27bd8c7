"""Inverse rendering of glossy objects: photos to a relightable mesh (NeP, CVPR 2024)."""

import os

# Torch and Numba each keep a pool of OpenMP threads. By default an idle pool waits actively. As soon as another program
# runs, the idle pool then takes the cores from the working pool: 2474 ms a step instead of 57 (docs/lab/openmp-waiting.md).
# The variable is read when the OpenMP library is loaded, so it must be set before the first import of torch.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")

__version__ = "0.1.0"
