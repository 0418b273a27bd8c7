"""Places objects side by side in a row along X: they stand on the ground, and the gaps between them are even."""

from collections.abc import Sequence

import bpy
import numpy as np
from mathutils import Matrix, Vector

GAP = 0.3
"""Width of a gap, in median widths of the objects"""


def move_origin_to_base(item: bpy.types.Object) -> None:
    """Move the object's origin to the middle of the underside of its bounding box. The object stays in its place.

    There it belongs for an asset that is dropped on a surface.
    """
    low, high = _box(item)
    base = Vector((*((low + high) / 2)[:2], low[2]))
    item.data.transform(Matrix.Translation(-base))
    item.location = item.location + base


def place_in_row(new: Sequence[bpy.types.Object], before: Sequence[bpy.types.Object] = ()) -> None:
    """Move the objects `new`, whose origins are at their bases, into a row on the ground, in their order.

    The row begins at the world's origin, or to the right of the objects `before`, which stay where they are.
    """
    if not new:
        return
    boxes = {item: _box(item) for item in (*before, *new)}
    gap = GAP * float(np.median([high[0] - low[0] for low, high in boxes.values()]))
    right = max(((item.matrix_basis @ Vector(corner)).x for item in before for corner in item.bound_box), default=-gap)
    for item in new:
        low, high = boxes[item]
        item.location = (right + gap - low[0], 0.0, 0.0)
        right += gap + high[0] - low[0]


def _box(item: bpy.types.Object) -> np.ndarray:
    """The lowest and the highest corner [2,3] of the mesh, in the object's own frame."""
    places = np.empty(3 * len(item.data.vertices), np.float32)
    item.data.vertices.foreach_get("co", places)
    points = places.reshape(-1, 3).astype(np.float64)
    return np.stack([points.min(axis=0), points.max(axis=0)])
