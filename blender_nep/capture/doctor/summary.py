"""The doctor: what `blender-nep info` says about a capture, and what is wrong with it."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from blender_nep.capture.capture import Capture
from blender_nep.capture.doctor.camera_checks import SphereSize, camera_outliers
from blender_nep.capture.doctor.coverage import LARGEST_GAP, Coverage
from blender_nep.capture.doctor.coverage_picture import refuse_foreign_picture, write_picture
from blender_nep.capture.doctor.sharpness import blurred
from blender_nep.capture.doctor.turns import Turns
from blender_nep.capture.doctor.turntable import still_share
from blender_nep.capture.exposure.from_exif import exif_gains, exposures_of
from blender_nep.capture.exposure.other_light import other_light
from blender_nep.capture.exposure.sessions import times_of
from blender_nep.capture.exposure.surroundings import Comparison, Exposures, compare_exposures, stops
from blender_nep.capture.loading import load_capture
from blender_nep.capture.photos.mask_files import MaskMeaning
from blender_nep.capture.rays.pixel_rays import PixelRays
from blender_nep.capture.rays.pixel_store import PixelMemory
from blender_nep.capture.turntable.motions import in_unit_frame
from blender_nep.messages import Message, shortened
from blender_nep.safety.printed_text import one_line

MOST_CLIPPED = 0.02
"""Share of clipped pixels from which on an artist is told to expose less."""


def summarize(
    folder: Path,
    picture: Path | None = None,
    sphere: tuple[Sequence[float], float] | None = None,
    *,
    use_masks: bool = True,
    mask_meaning: MaskMeaning | None = None,
    turntable: bool | None = None,
) -> dict:
    """Facts about a capture as plain values, ready for JSON. Every photo is read once, or twice where a turntable's camera
    moved.

    picture: where a PNG of the directions of the photos is written. sphere: the object's (center [3], radius), which
    then counts instead of the capture's. use_masks, mask_meaning: as in `load_capture`. turntable: whether the object
    turned; None: as the capture says, or as the photos show. Raises CaptureError,
    BoundsError and OutputError, and UsageError where `picture` is another file that is there.
    """
    if picture is not None:
        refuse_foreign_picture(picture)
    capture = load_capture(folder, use_masks=use_masks, mask_meaning=mask_meaning, sphere=sphere)
    coverage = Coverage.of(capture)
    if picture is not None:
        write_picture(coverage, picture)
    rays = PixelRays.from_capture(capture, 250_000, use_masks, memory=PixelMemory(most=32_000_000))
    cameras = [v.camera for v in capture.views]
    distance = np.array([np.linalg.norm(c.position - capture.object_center) for c in cameras]) / capture.object_radius
    angles = [math.degrees(c.field_of_view) for c in cameras]
    sizes = Counter(f"{c.width} x {c.height}" for c in cameras)
    radiance = rays.radiance[rays.valid][:: max(1, rays.count // 1_000_000)].float()
    size = SphereSize.of(capture)
    still = still_share(rays)
    turns = Turns.of(capture, still, turntable)
    seen, photos = rays, capture
    if turns.capture is not None:
        photos = turns.capture
        if turns.left_out:  # a job does not see these photos either
            seen = PixelRays.from_capture(photos, 250_000, use_masks, memory=PixelMemory(most=32_000_000))
        seen = seen.with_turntable(in_unit_frame(photos, photos.views[0]))
    compared = compare_exposures(seen)
    exposures = exposures_of(photos, compared)
    has_masks = use_masks and any(view.mask_path for view in capture.views)
    found: dict[str, Any] = {
        "folder": str(folder),
        "photos": len(capture.views),
        "camera_files": [path.name for path in capture.files],
        "sizes": dict(sizes),
        "formats": dict(Counter(v.image_path.suffix.lower()[1:] for v in capture.views)),
        "color_space": capture.color_space,
        "field_of_view_deg": [round(min(angles), 2), round(max(angles), 2)],
        "masks": rays.mask is not None,
        "mask_coverage": None if rays.mask is None else round(float(rays.mask.float().mean()) / 255, 4),
        "mask_meaning": str(capture.mask_reading.meaning) if has_masks else None,
        "cut_outs": not rays.background,
        "object_center": [round(float(x), 6) for x in capture.object_center],
        "object_radius": round(capture.object_radius, 6),
        "bounds_source": capture.bounds_source,
        "camera_distance_radii": [round(float(distance.min()), 2), round(float(distance.max()), 2)],
        "directions_covered": round(coverage.share, 3),
        "z_up": coverage.z_up,
        "largest_hole": coverage.largest_hole().message().to_dict(),
        "sphere_pixels": round(len(rays.sphere) / rays.count, 4),
        "sphere_width": round(size.pixels, 1),
        "sphere_cut": round(size.cut, 4),
        "invalid_pixels": int((~rays.valid).sum()),
        "clipped": round(_clipped(rays), 4),
        "exposure_stops": _exposure_stops(photos, exposures, compared),
        "corner_stops": _corner_stops(exposures),
        "turntable": turns.turntable,
        "surroundings_still": None if still is None else round(still, 3),
        "radiance": {
            "median": round(float(radiance.median()), 5),
            "99_9_percent": round(float(np.quantile(radiance.numpy(), 0.999)), 4),
            "largest": round(rays.brightest, 4),
        },
    }
    warnings = [*capture.warnings, *rays.warnings, *turns.messages, *camera_outliers(capture), *size.messages()]
    warnings += [*_photo_outliers(photos, seen, compared, exposures.warning), *_holes(coverage), *_doubts(found)]
    found["warnings"] = [warning.to_dict() for warning in warnings]
    return found


def _clipped(rays: PixelRays) -> float:
    """Share of the sphere's pixels that are burnt out, 0 .. 1. 0 where files can store more than white."""
    return float(rays.burnt_out(rays.sphere[:: max(1, len(rays.sphere) // 300_000)]).float().mean())


def _exposure_stops(capture: Capture, exposures: Exposures, compared: Comparison | None) -> float | None:
    """Stops between the photos with the lowest and the highest exposure; 0 if all are about equal, None if nobody knows."""
    if exposures.gain is not None:
        return round(float(np.ptp(stops(exposures.gain))), 2)
    if compared is None:
        return None if exif_gains(capture) is None else 0.0
    return None if exposures.warning == Message("capture.exposure_unclear") else 0.0


def _corner_stops(exposures: Exposures) -> float:
    """Stops by which the photos' corners are brighter than their middles: negative, or 0 if there is no vignetting."""
    return 0.0 if exposures.vignetting is None else round(exposures.vignetting.corner_stops, 2)


def _photo_outliers(
    capture: Capture, rays: PixelRays, compared: Comparison | None, warning: Message | None
) -> list[Message]:
    """Messages on blurred photos, and on photos whose exposure differs from the others'."""
    names = [view.name for view in capture.views]
    soft = [names[i] for i in blurred(rays)]
    found = [Message("capture.photos_blurred", {"count": len(soft), "names": soft})] if soft else []
    if compared is None:
        return found
    evening = other_light(compared, times_of(capture))
    if evening:
        found.append(Message("capture.other_light", {"count": len(evening), "names": [names[i] for i in evening]}))
    off = {photo: stop for photo, stop in compared.outliers().items() if photo not in evening}
    dark = [names[i] for i, stop in off.items() if stop < 0]
    bright = [names[i] for i, stop in off.items() if stop > 0]
    if dark:
        most = -min(off.values())
        found.append(Message("capture.photos_darker", {"count": len(dark), "names": dark, "stops": most}))
    if bright:
        most = max(off.values())
        found.append(Message("capture.photos_brighter", {"count": len(bright), "names": bright, "stops": most}))
    return found + ([warning] if warning else [])


def _holes(coverage: Coverage) -> list[Message]:
    """The largest hole above the horizon, if it is large. A table hides the directions below."""
    hole = coverage.largest_hole(least_elevation=0.0)
    return [hole.message()] if hole.degrees > LARGEST_GAP else []


def _doubts(found: dict) -> list[Message]:
    doubts: list[Message] = []
    if found["photos"] < 12:
        doubts.append(Message("capture.few_photos", {"photos": found["photos"]}))
    if found["directions_covered"] < 0.25:
        doubts.append(Message("capture.few_directions"))
    if found["clipped"] > MOST_CLIPPED:
        doubts.append(Message("capture.sphere_clipped", {"percent": round(100 * found["clipped"], 1)}))
    if found["color_space"] == "srgb":
        doubts.append(Message("capture.highlights_clipped"))
    if found["cut_outs"]:
        doubts.append(Message("capture.cut_outs"))
    return doubts


def describe(found: dict) -> str:
    """The facts of `summarize` as text for people. Control characters in names are escaped."""
    stops_apart = found["exposure_stops"]
    exposure = (
        "not known" if stops_apart is None else f"up to {stops_apart} stops apart" if stops_apart else "no clear difference"
    )
    if found["corner_stops"]:
        exposure += f", corners {-found['corner_stops']} stops darker"
    lines = [
        f"{found['folder']}: {found['photos']} photos ({_counts(found['formats'])}), {_counts(found['sizes'])} pixels, "
        f"cameras of {shortened(found['camera_files'], 2)}",
        f"  color          {found['color_space']}; median {found['radiance']['median']}, 99.9 % below "
        f"{found['radiance']['99_9_percent']}, largest {found['radiance']['largest']}",
        f"  exposure       {exposure}; {found['clipped']:.1%} of the pixels around the object are clipped",
        f"  field of view  {found['field_of_view_deg'][0]} to {found['field_of_view_deg'][1]} degrees",
        f"  object         center {found['object_center']}, radius {found['object_radius']} (from {found['bounds_source']})",
        f"  cameras        {found['camera_distance_radii'][0]} to {found['camera_distance_radii'][1]} radii away, "
        f"{found['directions_covered']:.0%} of directions within 30 degrees of a camera",
        f"  largest hole   {found['largest_hole']['message']}" + ("" if found["z_up"] else " (up as in the photos, not z)"),
        f"  sphere         about {found['sphere_width']:.0f} pixels wide, {found['sphere_pixels']:.0%} of the pixels; "
        f"{found['sphere_cut']:.0%} of the photos cut it off",
        f"  turntable      {'the object turned' if found['turntable'] else 'no'}",
        f"  pixels         {found['invalid_pixels']} unusable",
        "  masks          "
        + (f"the object covers {found['mask_coverage']:.0%} of the pixels" if found["masks"] else "none")
        + (" (cut-outs)" if found["cut_outs"] else "")
        + (", white is what may be used" if found["mask_meaning"] == MaskMeaning.USABLE else ""),
    ]
    lines += [f"  warning: {w['message']}" for w in found["warnings"]] or ["  nothing looks wrong"]
    return "\n".join(map(one_line, lines))


def _counts(counts: dict[str, int]) -> str:
    return ", ".join(f"{n} {name}" if len(counts) > 1 else str(name) for name, n in counts.items())
