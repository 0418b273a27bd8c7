"""What surface points send to their eyes for each texel of the map of unseen light, and the adjoint: fused Numba kernels.

A sparse matrix that is never written down: every cone has four taps in the map's pyramid and, for each line of an affine
function of the albedo, a response in three colours. The taps stay while materials change. Results do not depend on the
number of threads: points are independent, and the adjoint is summed in a fixed number of parts.
"""

from __future__ import annotations

import numpy as np
import torch
from numba import njit, prange
from torch import Tensor

from blender_nep.shading.unseen_light import OpenCones, UnseenLight, level_sizes, taps

_PARTS = 8
"""In which the adjoint is summed, each into a map of its own."""


class UnseenTransport:
    """From a map like `light` to n surface points, through their open cones.

    position [n, 3] of the points; on the CPU, whatever the device of the cones.
    """

    def __init__(self, light: UnseenLight, cones: OpenCones, position: Tensor) -> None:
        index, weight = taps(len(light.radiance), light.radius, position[cones.row], cones.direction, cones.half_angle)
        self.texels = sum(2 * size * size for size in level_sizes(len(light.radiance)))
        self._texel = index.int().cpu().numpy()
        self._weight = (weight * cones.share[:, None]).float().cpu().numpy()
        ends = torch.bincount(cones.row, minlength=len(position)).cumsum(0).cpu().numpy()
        self._starts = np.concatenate([[0], ends])

    def sent(self, response: np.ndarray, levels: np.ndarray) -> np.ndarray:
        """Radiance [n, L, 3] for a pyramid [texels, 3]; response [k, L, 3]: what a point sends for a light of 1 in one of
        its k cones, on each of L lines. All float32."""
        out = np.zeros((len(self._starts) - 1, *response.shape[1:]), np.float32)
        _send(self._starts, self._texel, self._weight, response, levels, out)
        return out

    def adjoint(self, response: np.ndarray, gradient: np.ndarray) -> np.ndarray:
        """From a gradient by radiance [n, L, 3] to one by the pyramid [texels, 3]."""
        parts = np.zeros((_PARTS, self.texels, 3), np.float32)
        _collect(self._starts, self._texel, self._weight, response, np.ascontiguousarray(gradient), parts)
        return parts.sum(0)


@njit(cache=True, parallel=True, fastmath=True)
def _send(starts, texel, weight, response, levels, out):
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
def _collect(starts, texel, weight, response, gradient, parts):
    count, lines = len(gradient), response.shape[1]
    for part in prange(len(parts)):
        total = parts[part]
        for i in range(part * count // len(parts), (part + 1) * count // len(parts)):
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
