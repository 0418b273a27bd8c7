"""Estimates the object's bounding sphere from the cameras and the masks, and checks it against the cameras."""

from __future__ import annotations

import numpy as np

from blender_nep.capture.cameras.camera import Camera
from blender_nep.capture.cameras.common_place import common_place
from blender_nep.errors import BoundsError
from blender_nep.messages import Message

_HINT = (
    "Move and scale the sphere so that it holds the object and no camera "
    "(object_center and object_radius in transforms.json, or --object-center and --object-radius)."
)

_STRAY = 0.1
"""A camera stands where the object is, if it is nearer to it than this, relative to the median of all."""
_MOST_STRAYS = 0.1
"""If more of the cameras stand there, the place is wrong."""


def sphere_from_cameras(cameras: list[Camera]) -> tuple[np.ndarray, float]:
    """Center [3] nearest to all optical axes, and radius of the largest sphere that a tenth of the cameras see whole.

    A tenth is enough: photos from farther away usually show the whole object. A sphere that is somewhat too large costs
    resolution; a sphere that is too small cuts the object. `common_place` finds the center. The radius is at most 0.7 of the
    distance to the nearest camera. Raises BoundsError when the axes are parallel, or when fewer than two cameras see the
    center.
    """
    position = np.stack([c.position for c in cameras])
    axis = np.stack([c.optical_axis for c in cameras])
    center = common_place(position, axis)
    if center is None:
        raise BoundsError("the cameras' optical axes are parallel: the object's place cannot be estimated", _HINT)
    seen = np.array([c.side_distances(center).min() for c in cameras])
    in_front = ((center - position) * axis).sum(1) > 0
    if (in_front & (seen > 0)).sum() < 2:
        raise BoundsError("the cameras do not look at a common place: the object cannot be located", _HINT)
    radius = np.percentile(seen[in_front & (seen > 0)], 90)
    return center, float(min(radius, 0.7 * np.linalg.norm(position - center, axis=1).min()))


def stray_cameras(cameras: list[Camera]) -> list[int]:
    """The cameras that stand at the place at which the others look, if they are few; else none."""
    position = np.stack([c.position for c in cameras])
    center = common_place(position, np.stack([c.optical_axis for c in cameras]))
    if center is None:
        return []
    distance = np.linalg.norm(position - center, axis=1)
    strays = np.flatnonzero(distance < _STRAY * np.median(distance))
    return strays.tolist() if len(strays) <= max(1, _MOST_STRAYS * len(cameras)) else []


def sphere_from_masks(
    cameras: list[Camera], masks: list[np.ndarray], center: np.ndarray, radius: float, resolution: int = 48
) -> tuple[np.ndarray, float] | None:
    """Center [3] and radius of a sphere around a coarse visual hull, or None when no voxel agrees with the masks.

    The first grid covers the cube of half side 1.5 `radius` around `center`; the second grid covers the voxels that the
    first one kept. A voxel is kept when at least half of the cameras have it in their frame, and in 95 % of those photos
    the mask covers it. It is not 100 %, because masks may have errors. Masks that show nothing do not count. `masks` [h, w]
    are in 0..1, of any resolution.
    """
    hull = hull_of_masks(cameras, masks, center, radius, resolution)
    if hull is None:
        return None
    kept, voxel = hull
    middle = (kept.min(0) + kept.max(0)) / 2
    return middle, float(1.05 * np.linalg.norm(kept - middle, axis=1).max() + np.linalg.norm(voxel) / 2)


def hull_of_masks(
    cameras: list[Camera], masks: list[np.ndarray], center: np.ndarray, radius: float, resolution: int = 48
) -> tuple[np.ndarray, np.ndarray] | None:
    """The middles [n, 3] of the voxels of a coarse visual hull, and the sides [3] of a voxel: see `sphere_from_masks`."""
    low, high = center - 1.5 * radius, center + 1.5 * radius
    for _ in range(2):
        axes = [np.linspace(low[i], high[i], resolution) for i in range(3)]
        points = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
        _, inside = carve(cameras, masks, points)
        if not inside.any():
            return None
        voxel = (high - low) / (resolution - 1)
        kept = points[inside]
        low, high = kept.min(0) - 2 * voxel, kept.max(0) + 2 * voxel
    return kept, voxel


def carve(cameras: list[Camera], masks: list[np.ndarray], points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Which of the points [n, 3] enough photos show [n] bool, and which the masks keep, too [n] bool.

    `sphere_from_masks` says when.
    """
    shown = [(camera, mask) for camera, mask in zip(cameras, masks, strict=True) if (mask > 0.5).any()]
    framed, covered = np.zeros(len(points)), np.zeros(len(points))
    for camera, mask in shown:
        x, y, depth = camera.project(points)
        with np.errstate(invalid="ignore"):
            row = np.floor(y * mask.shape[0] / camera.height).astype(np.int64)
            column = np.floor(x * mask.shape[1] / camera.width).astype(np.int64)
        ok = (depth > 0) & (row >= 0) & (row < mask.shape[0]) & (column >= 0) & (column < mask.shape[1])
        framed += ok
        covered[ok] += mask[row[ok], column[ok]] > 0.5
    enough = framed >= 0.5 * max(1, len(shown))
    return enough, enough & (covered >= 0.95 * framed)


def check_sphere(names: list[str], cameras: list[Camera], center: np.ndarray, radius: float) -> list[Message]:
    """Warnings about the sphere. Raises BoundsError when a camera stands inside the sphere or no photo shows it."""
    distance = np.array([np.linalg.norm(c.position - center) for c in cameras])
    inside = np.flatnonzero(distance <= radius)
    if len(inside):
        raise BoundsError(
            f"{len(inside)} of {len(cameras)} cameras stand inside the object's sphere (the first: {names[inside[0]]}, "
            f"{distance[inside[0]]:.4g} from the center, radius {radius:.4g})",
            _HINT,
        )
    seen = np.array([sees_sphere(c, center, radius) for c in cameras])
    if not seen.any():
        raise BoundsError(f"no photo sees the object's sphere (center {_text(center)}, radius {radius:.4g})", _HINT)
    warnings: list[Message] = []
    if not seen.all():
        blind = [names[i] for i in np.flatnonzero(~seen)]
        warnings.append(Message("capture.sphere_not_seen", {"count": len(blind), "photos": len(cameras), "names": blind}))
    if np.median(distance) > 10 * radius:
        warnings.append(Message("capture.cameras_far", {"radii": float(np.median(distance) / radius)}))
    cut = np.array([c.side_distances(center).min() < 0.5 * radius for c in cameras])
    if cut[seen].mean() > 0.5:
        warnings.append(Message("capture.sphere_cut"))
    return warnings


def sees_sphere(camera: Camera, center: np.ndarray, radius: float) -> bool:
    """Whether some part of the sphere can lie in the camera's frame. Near the frame's corners this may be wrongly True."""
    sides = camera.side_distances(center)
    depth = (camera.position - center) @ camera.camera_to_world[:3, 2]
    return bool(sides.min() > -radius and depth > -radius)


def _text(point: np.ndarray) -> str:
    return "(" + ", ".join(f"{x:.4g}" for x in point) + ")"
