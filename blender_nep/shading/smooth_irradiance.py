"""Means of the irradiance over surface points that lie side by side and face the same way.

The cones of each surface point are placed at random, so its irradiance is noisy: on a teapot in a room with lamps, 32 cones
differ from 256 by 9 %. The irradiance itself hardly changes from a point to its neighbors. So a mean over them is better.
"""

from __future__ import annotations

import numpy as np
import torch
from scipy.spatial import cKDTree
from torch import Tensor

from blender_nep.shading.plenoptic import SurfacePoints

_COUNT = 16
"""Most points that a mean is taken over, the point itself included."""
_BEND = 0.2
"""Distance on the surface, in the unit frame, that counts as much as a turn of the normal by one radian."""
_REACH = 0.05
"""Largest distance of a neighbor, in the unit frame. Where points are sparse, there are fewer neighbors."""


class IrradianceMean:
    """Takes the mean of values at n surface points over the neighbors of each point."""

    @classmethod
    def over(cls, points: SurfacePoints) -> IrradianceMean:
        """The mean over surface points.

        If the object turned, the irradiance of a place changes from photo to photo with its normal in the room. The object
        hides light from the place as before. So neighbors lie side by side on the object, and face the same way in the room.
        """
        return cls(points.position, points.in_room(points.normal))

    def __init__(self, position: Tensor, normal: Tensor) -> None:
        """position [n, 3] in the unit frame; normal [n, 3] unit vectors, as the light sees them."""
        n = len(position)
        place = np.concatenate([position.cpu().numpy(), _BEND * normal.cpu().numpy()], 1)
        if n == 0:
            index = np.zeros((0, 1), np.int64)
        else:
            workers = torch.get_num_threads()
            _, index = cKDTree(place).query(place, min(_COUNT, n), distance_upper_bound=_REACH, workers=workers)
            index = index.reshape(n, -1)
        # The tree gives the index n where there is no further neighbor.
        self._index = torch.from_numpy(np.minimum(index, max(n - 1, 0)).astype(np.int64)).to(position.device)
        known = torch.from_numpy(index < n).to(position.device, torch.float32)
        self._weight = known / known.sum(1, keepdim=True).clamp_min(1)

    def __call__(self, values: Tensor) -> Tensor:
        """The means [n, C] of values [n, C]."""
        out = torch.zeros_like(values)
        for k in range(self._index.shape[1]):
            out += self._weight[:, k : k + 1] * values[self._index[:, k]]
        return out
