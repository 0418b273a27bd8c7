"""Robust fits of one albedo to each pixel and its neighbors on the CPU, with a fused Numba kernel.

The estimate is that of `material_fit`, for pixels whose roughness and metallic are known. One thread does a whole pixel, so
that results do not depend on the number of threads.
"""

from __future__ import annotations

import numpy as np
from numba import prange

from blender_nep.ops.compilation import kernel
from blender_nep.ops.tone import tone


@kernel(parallel=True, fastmath=True, error_model="numpy")
def fit_local_albedos(index, weight, offset, slope, metallic, goal, clip, iterations, albedo, residual):
    """Fill albedo [m, 3] in 0..1 and residual [m] for m pixels; all arrays but `index` are float32.

    The radiance of pixel i is offset[i] + slope[i] * albedo (`plenoptic.affine_in_albedo`), [n, 3] each; goal [n, 3] is the
    linear radiance of its photo, and metallic [n] its metallic. index [m, N] int64 holds the neighbors of each pixel, and
    weight [m, N] how much they count. The least squares are reweighted in each of `iterations`. A residual above 2 * `clip`
    does not count. The residual of a pixel is the weighted mean of its neighbors' tone-mapped residuals, each at most
    `clip`.
    """
    for i in prange(len(index)):
        a = np.full(3, np.float32(0.5))
        for c in range(3):
            for k in range(iterations):
                top = bottom = 0.0
                for j in range(index.shape[1]):
                    n = index[i, j]
                    light = max(offset[n, c] + slope[n, c] * a[c], np.float32(0))
                    robust = weight[i, j]
                    if k == 0:
                        mean = goal[n, c]
                    else:
                        mean = np.float32(0.5) * (light + goal[n, c])
                        error = abs(tone(light) - tone(goal[n, c]))
                        if error >= 2 * clip:
                            continue
                        robust /= max(error, np.float32(0.02))
                    robust /= (np.float32(1) + np.float32(4) * mean) ** 2
                    instrument = metallic[n] * mean + (np.float32(1) - metallic[n]) * slope[n, c]
                    top += robust * instrument * (goal[n, c] - offset[n, c])
                    bottom += robust * instrument * slope[n, c]
                if bottom > 0:
                    a[c] = min(max(top / bottom, 0.0), 1.0)
            albedo[i, c] = a[c]
        left = total = 0.0
        for j in range(index.shape[1]):
            n = index[i, j]
            error = np.float32(0)
            for c in range(3):
                error += abs(tone(max(offset[n, c] + slope[n, c] * a[c], np.float32(0))) - tone(goal[n, c]))
            left += weight[i, j] * min(error / np.float32(3), clip)
            total += weight[i, j]
        residual[i] = left / max(total, 1e-9)
