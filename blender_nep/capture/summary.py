"""The facts that `blender-nep info` prints about a capture."""

from __future__ import annotations

import math
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np

from blender_nep.capture.loading import load_capture
from blender_nep.capture.pixel_rays import PixelRays
from blender_nep.capture.pixel_store import PixelMemory
from blender_nep.messages import Message


def summarise(folder: Path) -> dict:
    """Facts about a capture as plain values, ready for JSON. Every photo is read once. Raises CaptureError, BoundsError."""
    capture = load_capture(folder)
    rays = PixelRays.from_capture(capture, 250_000, use_masks=True, memory=PixelMemory(most=32_000_000))
    cameras = [v.camera for v in capture.views]
    unit = np.stack([(c.position - capture.object_center) / capture.object_radius for c in cameras])
    distance = np.linalg.norm(unit, axis=1)
    angles = [math.degrees(2 * math.atan(0.5 * c.width / c.fl_x)) for c in cameras]
    sizes = Counter(f"{c.width} x {c.height}" for c in cameras)
    radiance = rays.radiance[rays.valid][:: max(1, rays.count // 1_000_000)].float()
    found: dict[str, Any] = {
        "folder": str(folder),
        "photos": len(capture.views),
        "sizes": dict(sizes),
        "formats": dict(Counter(v.image_path.suffix.lower()[1:] for v in capture.views)),
        "color_space": capture.color_space,
        "field_of_view_deg": [round(min(angles), 2), round(max(angles), 2)],
        "masks": rays.mask is not None,
        "mask_coverage": None if rays.mask is None else round(float(rays.mask.float().mean()) / 255, 4),
        "cut_outs": not rays.background,
        "object_center": [round(float(x), 6) for x in capture.object_center],
        "object_radius": round(capture.object_radius, 6),
        "bounds_source": capture.bounds_source,
        "camera_distance_radii": [round(float(distance.min()), 2), round(float(distance.max()), 2)],
        "directions_covered": round(_directions_covered(unit), 3),
        "sphere_pixels": round(len(rays.sphere) / rays.count, 4),
        "invalid_pixels": int((~rays.valid).sum()),
        "radiance": {
            "median": round(float(radiance.median()), 5),
            "99_9_percent": round(float(np.quantile(radiance.numpy(), 0.999)), 4),
            "largest": round(rays.brightest, 4),
        },
        "warnings": [warning.told() for warning in capture.warnings + rays.warnings],
    }
    found["warnings"] += [doubt.told() for doubt in _doubts(found)]
    return found


def _directions_covered(position: np.ndarray) -> float:
    """Share of the directions around the object that lie within 30 degrees of a camera at position [n, 3] (unit frame)."""
    rng = np.random.default_rng(0)
    probe = rng.normal(size=(4096, 3))
    probe /= np.linalg.norm(probe, axis=1, keepdims=True)
    axis = position / np.linalg.norm(position, axis=1, keepdims=True)
    return float(((probe @ axis.T).max(1) > math.cos(math.radians(30))).mean())


def _doubts(found: dict) -> list[Message]:
    doubts: list[Message] = []
    if found["photos"] < 12:
        doubts.append(Message("capture.few_photos", {"photos": found["photos"]}))
    if found["directions_covered"] < 0.25:
        doubts.append(Message("capture.few_directions"))
    if found["color_space"] == "srgb":
        doubts.append(Message("capture.highlights_clipped"))
    if found["cut_outs"]:
        doubts.append(Message("capture.cut_outs"))
    return doubts


def describe(found: dict) -> str:
    """The facts of `summarise` as text for people."""
    lines = [
        f"{found['folder']}: {found['photos']} photos ({_counts(found['formats'])}), {_counts(found['sizes'])} pixels",
        f"  color         {found['color_space']}; median {found['radiance']['median']}, 99.9 % below "
        f"{found['radiance']['99_9_percent']}, largest {found['radiance']['largest']}",
        f"  field of view  {found['field_of_view_deg'][0]} to {found['field_of_view_deg'][1]} degrees",
        f"  object         centre {found['object_center']}, radius {found['object_radius']} (from {found['bounds_source']})",
        f"  cameras        {found['camera_distance_radii'][0]} to {found['camera_distance_radii'][1]} radii away, "
        f"{found['directions_covered']:.0%} of directions within 30 degrees of a camera",
        f"  pixels         {found['sphere_pixels']:.0%} look at the object's sphere, {found['invalid_pixels']} unusable",
        "  masks          "
        + (f"the object covers {found['mask_coverage']:.0%} of the pixels" if found["masks"] else "none")
        + (" (cut-outs)" if found["cut_outs"] else ""),
    ]
    return "\n".join(lines + ([f"  warning: {w['message']}" for w in found["warnings"]] or ["  nothing looks wrong"]))


def _counts(counts: dict[str, int]) -> str:
    return ", ".join(f"{n} {name}" if len(counts) > 1 else str(name) for name, n in counts.items())
