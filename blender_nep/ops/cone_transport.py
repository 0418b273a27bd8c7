"""Products of a sparse matrix that is never written down, and of its adjoint, on the CPU: fused Numba kernels.

Every cone of a surface point has four taps in a map; what it brings is spread over the lines of an affine function, with a
response for each line and color. Points are independent, and the adjoint is summed in parts that do not depend on the
number of threads: neither do results.
"""

from __future__ import annotations

import numpy as np
from numba import njit, prange


@njit(cache=True, parallel=True, fastmath=True)
def send(starts, texel, weight, response, levels, out):
    """Adds to out [n,L,3] what points, whose cones are starts[i] to starts[i + 1], receive of levels [texels,3].

    texel, weight [k,4] taps of the cones, response [k,L,3].
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


@njit(cache=True, parallel=True, fastmath=True)
def collect(starts, bounds, texel, weight, response, gradient, parts):
    """Adds to parts [P,texels,3] the adjoint of `send` for gradient [n,L,3]; part p is of points bounds[p] to
    bounds[p + 1]."""
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
