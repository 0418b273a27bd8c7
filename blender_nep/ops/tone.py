"""The tone mapping (`tone_mapping.tone_map`) for Numba kernels."""

from __future__ import annotations

import math

import numpy as np

from blender_nep.ops.compilation import kernel

_LOG5 = np.float32(math.log(5.0))


@kernel(inline="always", fastmath=True, error_model="numpy")
def tone(light):
    """`tone_mapping.tone_map` with log, which is three times as fast as log1p. Its error near black, 1e-7, is harmless."""
    return math.log(np.float32(1) + np.float32(4) * light) / _LOG5
