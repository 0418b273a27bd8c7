"""Finds where masks do not show the object because something stands before it.

Masks show the part of the object that is visible. Where a thing stands between the camera and the object, the mask looks
like free space, and learning would dig a pit into the object. But the masks of the other photos outvote it: the ray goes
through the core of their visual hull. There the mask says nothing about the object.

A hole through which few photos see is outvoted, too. But there F_e explains the photo, and before the object it does not.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch
from scipy import ndimage
from torch import Tensor

from blender_nep.capture.rays.pixel_rays import PixelRays
from blender_nep.evidence.sdf_grid import SdfGrid
from blender_nep.fields.refinements.refinement import Change
from blender_nep.fields.stage import StageOne
from blender_nep.fields.visual_hull import mask_silhouettes
from blender_nep.messages import Message, Part

CORE = 0.06
"""Depth of the hull's core below its surface, in object radii. Outside the core, the mask may be right and not the hull."""
UNEXPLAINED = 2.0
"""Something stands before the object if F_e's error is larger there by this factor than F_e's mean error beside the object.
Measured on six captures: 0.3 to 1.0 in holes, 3.3 to 48 where something stands before the object. A hole through which one
sees the table under the object counts as hidden: F_e does not know the table in the object's sphere."""
_ROWS = 64
"""Rows of the maps in which masks and hull are compared, about. So a cell of the hull is hardly larger than a block."""
_PIXELS = 300
"""About so many pixels of a part of a photo are asked of F_e."""


class HiddenPixels:
    """Leaves out what masks say where something stands before the object."""

    name = Part.HIDDEN_PIXELS
    at = (0.0,)

    def skipped(self, stage: StageOne) -> Message | None:
        if not stage.scene.photos.masks:
            return Message("reason.no_masks")
        if not stage.schedule.background_steps:
            return Message("reason.few_pixels_beside")
        return None if stage.hull is not None else Message("reason.no_hull")

    def apply(self, stage: StageOne) -> Change:
        assert stage.hull is not None
        stage.hidden_pixels = hidden_pixels(stage.rays, stage.hull.sdf, stage.unexplained_by_environment())
        count = len(stage.hidden_pixels)
        return Change(count > 0, {"pixels": count} if count else {})


def hidden_pixels(rays: PixelRays, hull: np.ndarray, unexplained: Callable[[Tensor], Tensor]) -> Tensor:
    """Indices [m] int64, rising, of the pixels whose masks do not show the object although it is there.

    hull [n, n, n] is the SDF of the visual hull, at the centers of n^3 cells of [-1, 1]^3. unexplained(index [k]) is the
    error [k] of F_e behind the object at pixels, as a multiple of its mean error beside the object. Raises ValueError for
    rays without masks.
    """
    if rays.mask is None:
        raise ValueError("hidden pixels need masks")
    grid = SdfGrid(hull)
    solid, core = (
        torch.from_numpy(grid.centers_of(hull < -depth).astype(np.float32)).to(rays.mask.device) for depth in (0.0, CORE)
    )
    found = []
    for view, (height, width) in enumerate(rays.size):
        block = max(1, round(height / _ROWS))
        missing = (mask_silhouettes(rays, block, [view])[0] < 0.5).cpu().numpy()
        before = missing & _shown(rays, view, solid, missing.shape)
        labels, _ = ndimage.label(before)
        rows = np.arange(height) * missing.shape[0] // height
        columns = np.arange(width) * missing.shape[1] // width
        for part in np.unique(labels[before & _shown(rays, view, core, missing.shape)]):
            pixels = torch.from_numpy(np.flatnonzero((labels == part)[np.ix_(rows, columns)])).to(rays.mask.device)
            pixels = pixels + rays.offset[view]
            if float(unexplained(pixels[:: max(1, len(pixels) // _PIXELS)]).median()) > UNEXPLAINED:
                found.append(pixels)
    if not found:
        return torch.empty(0, dtype=torch.int64, device=rays.mask.device)
    index = torch.cat(found).sort()[0]
    return index[rays.mask[index] < 255]


def _shown(rays: PixelRays, view: int, points: Tensor, shape: tuple[int, ...]) -> np.ndarray:
    """Which blocks [rows, columns] bool of a photo show one of the points [k, 3]; small gaps between them are closed."""
    place, ahead = rays.project(view, points)
    row, column = (
        (((place[:, axis] + 1) / 2 * size).floor().long().cpu().numpy()) for axis, size in ((1, shape[0]), (0, shape[1]))
    )
    inside = ahead.cpu().numpy() & (row >= 0) & (row < shape[0]) & (column >= 0) & (column < shape[1])
    shown = np.zeros(shape, bool)
    shown[row[inside], column[inside]] = True
    return ndimage.binary_closing(np.pad(shown, 2), iterations=2)[2:-2, 2:-2]
