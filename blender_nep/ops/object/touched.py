"""The mean square of the touched entries of a gradient. The body is Numba's on the CPU, and plain torch elsewhere.

On the CPU, torch.count_nonzero is much slower than one pass over the entries.
"""

from __future__ import annotations

import numpy as np
import torch
from numba import prange

from blender_nep.ops.compilation import kernel
from blender_nep.ops.precision import at_least_float32

PART = 1 << 16
"""Number of entries in one part. The number is fixed, so that the result does not depend on the number of threads."""


@kernel(parallel=True, fastmath={"reassoc", "contract"})
def _sums(values, squares, touched):
    """Fill squares and touched [parts]: of each part of values [n], the sum of squares and the number of nonzero entries."""
    for part in prange(squares.shape[0]):
        # Numba handles negative indices, but not where an index counts from 0. So this becomes vector instructions.
        own = values[part * PART : (part + 1) * PART]
        total, count = 0.0, 0.0
        for i in range(own.shape[0]):
            value = own[i]
            total += value * value
            count += 1.0 if value != 0 else 0.0
        squares[part], touched[part] = total, count


@torch.no_grad()
def touched_mean_square(gradient: torch.Tensor, body: str = "auto") -> torch.Tensor:
    """The mean square [] of the entries of `gradient` that are not 0. It is 0 if all entries are 0.

    body: "auto" (Numba on the CPU, torch elsewhere), "numba" or "torch".
    """
    (gradient,) = at_least_float32(gradient)
    if body == "torch" or (body == "auto" and gradient.device.type != "cpu"):
        flat = gradient.flatten()
        return flat.dot(flat) / torch.count_nonzero(flat).clamp(min=1)
    values = gradient.contiguous().flatten().numpy()
    parts = -(-len(values) // PART)
    squares, touched = np.empty(parts, np.float64), np.empty(parts, np.int64)
    _sums(values, squares, touched)
    return gradient.new_tensor(squares.sum() / max(1, int(touched.sum())))
