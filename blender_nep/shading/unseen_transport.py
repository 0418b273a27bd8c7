"""What surface points send to their eyes for each texel of the map of unseen light, and the adjoint.

Linear in the map: every cone has four taps in its pyramid and, for each line of an affine function of the albedo, a response
in three colors. The taps stay while materials change.
"""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from blender_nep.ops.cone_transport import collect, send
from blender_nep.shading.unseen_light import UncoveredCones, level_sizes, taps

_PARTS = 32
"""In which the adjoint is summed, each into a map of its own."""


class UnseenTransport:
    """From a map of `rows` rows at `radius` to n surface points at position [n, 3], through their uncovered cones.

    Computed on the CPU, whatever the device of the cones.
    """

    def __init__(self, rows: int, radius: float, cones: UncoveredCones, position: Tensor) -> None:
        index, weight = taps(rows, radius, position[cones.row], cones.direction, cones.half_angle)
        self.texels = sum(2 * size * size for size in level_sizes(rows))
        self._texel = index.int().cpu().numpy()
        self._weight = (weight * cones.share[:, None]).float().cpu().numpy()
        ends = torch.bincount(cones.row, minlength=len(position)).cumsum(0).cpu().numpy()
        self._starts = np.concatenate([[0], ends])
        # points of about as many cones in each part
        self._bounds = np.searchsorted(self._starts, np.linspace(0, len(cones), _PARTS + 1))
        self._bounds[0], self._bounds[-1] = 0, len(position)

    def sent(self, response: np.ndarray, levels: np.ndarray) -> np.ndarray:
        """Radiance [n, L, 3] for a pyramid [texels, 3]; response [k, L, 3]: what a point sends for a light of 1 in one of
        its k cones, on each of L lines. All float32. Raises ValueError when the pyramid is another map's."""
        if levels.shape != (self.texels, 3):
            raise ValueError(f"a pyramid of {self.texels} texels is needed, not of {levels.shape}")
        out = np.zeros((len(self._starts) - 1, *response.shape[1:]), np.float32)
        send(self._starts, self._texel, self._weight, response, levels, out)
        return out

    def adjoint(self, response: np.ndarray, gradient: np.ndarray) -> np.ndarray:
        """From a gradient by radiance [n, L, 3] to one by the pyramid [texels, 3]."""
        parts = np.zeros((_PARTS, self.texels, 3), np.float32)
        collect(self._starts, self._bounds, self._texel, self._weight, response, np.ascontiguousarray(gradient), parts)
        return parts.sum(0)
