"""The texels of an unwrapped mesh: finds the surface point of each texel, reads textures, fills texels outside the charts.

Row 0 of a texture is its top (v = 1). The center of texel (i, j) of an [H, W] texture is at uv = ((j + 0.5) / W,
1 - (i + 0.5) / H).
"""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from blender_nep.ops.compilation import kernel


def rasterize(uv: np.ndarray, faces: np.ndarray, size: int) -> tuple[np.ndarray, np.ndarray]:
    """The surface point of every texel of a square texture.

    uv [V, 2] in 0..1, faces [F, 3], size in texels. Returns face [size, size] int32 (-1: no surface there) and barycentric
    [size, size, 3] float32. A texel belongs to the face that contains its center; where charts overlap, to the last one.
    """
    corners = np.empty((len(uv), 2))
    corners[:, 0] = uv[:, 0] * size - 0.5
    corners[:, 1] = (1 - uv[:, 1]) * size - 0.5
    face = np.full((size, size), -1, np.int32)
    barycentric = np.zeros((size, size, 3), np.float32)
    _rasterize(corners, np.ascontiguousarray(faces, np.int64), face, barycentric)
    return face, barycentric


@kernel()
def _rasterize(corners, faces, face, barycentric):
    height, width = face.shape
    for f in range(len(faces)):
        ax, ay = corners[faces[f, 0]]
        bx, by = corners[faces[f, 1]]
        cx, cy = corners[faces[f, 2]]
        area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
        if abs(area) < 1e-12:
            continue
        i0 = max(0, int(np.ceil(min(ay, by, cy) - 1e-6)))
        i1 = min(height - 1, int(np.floor(max(ay, by, cy) + 1e-6)))
        j0 = max(0, int(np.ceil(min(ax, bx, cx) - 1e-6)))
        j1 = min(width - 1, int(np.floor(max(ax, bx, cx) + 1e-6)))
        for i in range(i0, i1 + 1):
            for j in range(j0, j1 + 1):
                u = ((bx - j) * (cy - i) - (by - i) * (cx - j)) / area
                v = ((cx - j) * (ay - i) - (cy - i) * (ax - j)) / area
                w = 1.0 - u - v
                if u >= -1e-9 and v >= -1e-9 and w >= -1e-9:
                    face[i, j] = f
                    barycentric[i, j, 0] = u
                    barycentric[i, j, 1] = v
                    barycentric[i, j, 2] = w


def look_up(texture: np.ndarray, uv: np.ndarray) -> np.ndarray:
    """Bilinear values [n, C] of a texture [H, W] or [H, W, C] at uv [n, 2]. Beyond the edge, the edge's value is used."""
    height, width = texture.shape[:2]
    texture = texture.reshape(height, width, -1)
    x, y = uv[:, 0] * width - 0.5, (1 - uv[:, 1]) * height - 0.5
    column, row = np.floor(x).astype(np.int64), np.floor(y).astype(np.int64)
    fx, fy = (x - column)[:, None], (y - row)[:, None]

    def at(j: np.ndarray, i: np.ndarray) -> np.ndarray:
        return texture[j.clip(0, height - 1), i.clip(0, width - 1)]

    top = at(row, column) * (1 - fx) + at(row, column + 1) * fx
    return top * (1 - fy) + (at(row + 1, column) * (1 - fx) + at(row + 1, column + 1) * fx) * fy


def nearest_known(known: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Row and column, both [H, W], of the known texel that is nearest to each texel; known is [H, W] bool.

    A known texel gets its own row and column; if no texel is known, every texel does. `texture[nearest_known(known)]` is the
    texture with its charts dilated, so that filtering mixes in no foreign color at a seam, as far as charts are apart.
    """
    if not known.any():
        return tuple(np.indices(known.shape, np.int32))
    return tuple(ndimage.distance_transform_edt(~known, return_distances=False, return_indices=True))
