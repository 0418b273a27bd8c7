"""The radiance that surface points send to the eye for a map of unseen light, and the adjoint of that linear function.

Every cone reads four texels (taps) of the map's pyramid. The radiance is an affine function of the albedo; each of its two
lines (offset and slope) has a response in three colors. The taps stay the same while the materials change.
"""

from __future__ import annotations

from copy import copy

import numpy as np
import torch
from torch import Tensor

from blender_nep.ops.materials.cone_transport import collect, send
from blender_nep.shading.unseen_light import UncoveredCones, level_sizes, taps

_PARTS = 32
"""Number of parts in which the adjoint is summed; each part has a map of its own."""


class UnseenTransport:
    """Transports the light of a map to n surface points, through their uncovered cones.

    The map lies at `radius`; photos do not show `missing` [rows, 2 rows] of its texels. position [n, 3] are the points, in
    the room's frame. The work is done on the CPU, whatever the device of the cones.
    """

    def __init__(self, missing: Tensor, radius: float, cones: UncoveredCones, position: Tensor) -> None:
        index, weight = taps(missing, radius, position[cones.row], cones.direction, cones.half_angle)
        self.texels = sum(2 * size * size for size in level_sizes(len(missing)))
        self._texel = index.int().cpu().numpy()
        self._weight = (weight * cones.share[:, None]).float().cpu().numpy()
        ends = torch.bincount(cones.row, minlength=len(position)).cumsum(0).cpu().numpy()
        self._starts = np.concatenate([[0], ends])
        # all parts have about the same number of cones
        self._bounds = np.searchsorted(self._starts, np.linspace(0, len(cones), _PARTS + 1))
        self._bounds[0], self._bounds[-1] = 0, len(position)

    def of(self, cones: np.ndarray) -> UnseenTransport:
        """The transport through the chosen cones only. cones [k]: whether each is chosen."""
        some = copy(self)
        some._texel, some._weight = self._texel[cones], self._weight[cones]
        some._starts = np.concatenate([[0], np.cumsum(cones)])[self._starts]
        return some

    def sent(self, response: np.ndarray, levels: np.ndarray) -> np.ndarray:
        """Radiance [n, L, 3] that the points send to the eye for a pyramid `levels` [texels, 3], on each of L lines.

        response [k, L, 3] is the radiance that a point sends for a radiance of 1 in one of the k cones. All arrays are
        float32. Raises ValueError when the pyramid has another number of texels.
        """
        if levels.shape != (self.texels, 3):
            raise ValueError(f"a pyramid of {self.texels} texels is needed, not of {levels.shape}")
        out = np.zeros((len(self._starts) - 1, *response.shape[1:]), np.float32)
        send(self._starts, self._texel, self._weight, response, levels, out)
        return out

    def adjoint(self, response: np.ndarray, gradient: np.ndarray) -> np.ndarray:
        """The gradient [texels, 3] by the pyramid, from the gradient [n, L, 3] by the radiance that `sent` returns."""
        parts = np.zeros((_PARTS, self.texels, 3), np.float32)
        collect(self._starts, self._bounds, self._texel, self._weight, response, np.ascontiguousarray(gradient), parts)
        return parts.sum(0)
