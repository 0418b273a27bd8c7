"""Numba kernels on the CPU for the product with a sparse matrix, and with its adjoint. The matrix is never stored.

Every cone of a surface point reads four texels (taps) of a map. Its radiance is multiplied by a response for each line of an
affine function and each color. Results do not depend on the number of threads: points are independent, and the adjoint is
summed in a fixed number of parts.
"""

from __future__ import annotations

import numpy as np
from numba import prange

from blender_nep.ops.compilation import kernel


@kernel(parallel=True, fastmath=True)
def send(starts, texel, weight, response, levels, out):
    """Add to out [n, L, 3] the radiance that the points send for the map `levels` [texels, 3], on L lines.

    Point i has the cones starts[i] to starts[i + 1] - 1, starts [n + 1]. texel, weight [k, 4] are the taps of the cones;
    response [k, L, 3].
    """
    lines = response.shape[1]
    for i in prange(len(out)):
        for c in range(starts[i], starts[i + 1]):
            red = green = blue = np.float32(0)
            for tap in range(4):
                w, j = weight[c, tap], texel[c, tap]
                red += w * levels[j, 0]
                green += w * levels[j, 1]
                blue += w * levels[j, 2]
            for line in range(lines):
                out[i, line, 0] += response[c, line, 0] * red
                out[i, line, 1] += response[c, line, 1] * green
                out[i, line, 2] += response[c, line, 2] * blue


@kernel(parallel=True, fastmath=True)
def collect(starts, bounds, texel, weight, response, gradient, parts):
    """Add the adjoint of `send` for gradient [n, L, 3] to parts [P, texels, 3]. The sum over the parts is the result.

    Part p holds the points bounds[p] to bounds[p + 1] - 1, bounds [P + 1].
    """
    lines = response.shape[1]
    for part in prange(len(parts)):
        total = parts[part]
        for i in range(bounds[part], bounds[part + 1]):
            for c in range(starts[i], starts[i + 1]):
                red = green = blue = np.float32(0)
                for line in range(lines):
                    red += response[c, line, 0] * gradient[i, line, 0]
                    green += response[c, line, 1] * gradient[i, line, 1]
                    blue += response[c, line, 2] * gradient[i, line, 2]
                for tap in range(4):
                    w, j = weight[c, tap], texel[c, tap]
                    total[j, 0] += w * red
                    total[j, 1] += w * green
                    total[j, 2] += w * blue
