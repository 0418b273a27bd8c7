"""Inverse rendering of glossy objects: photos to a relightable mesh (NeP, CVPR 2024)."""

import os

# Torch and Numba each keep a pool of OpenMP threads. Waiting actively, as is their default, the idle pool takes the
# cores from the working one as soon as anything else runs: 2474 ms a step instead of 57 (docs/lab/openmp-waiting.md). The
# variable is read when the OpenMP library is loaded, so it has to stand before the first import of torch.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")

__version__ = "0.1.0"
