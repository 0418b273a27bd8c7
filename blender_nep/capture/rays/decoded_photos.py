"""Decodes the photos of a capture: linear pixels, scaled down, and what is wrong with them."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
import torch

from blender_nep.capture.capture import Capture
from blender_nep.capture.rays.downscaling import box
from blender_nep.errors import CaptureError
from blender_nep.messages import Message
from blender_nep.profiling import profiled

MAXIMUM_RADIANCE = 6e4
"""Larger radiance is clipped to this value: the largest half float is 65504."""
_BLACK = 1e-6
"""A photo without a brighter value counts as black."""
STRIP_PIXELS = 1 << 18
"""Pixels that are handled at a time; this many fit into the processor's cache."""
_DECODED_PIXELS = 50_000_000
"""Pixels of all photos that are decoded at the same time. A photo with more pixels is decoded alone."""


@dataclass
class PhotoFacts:
    """What the pixels of a photo and of its mask are like."""

    repaired: dict[str, int]
    """Numbers of pixels in the file that are not finite ("bad"), that have a negative channel ("negative"), and that have a
    channel above MAXIMUM_RADIANCE ("blinding")"""
    empty: bool
    """No pixel is left that can be used, and some pixels are not finite."""
    brightest: float
    cut_out: bool
    has_mask: bool
    covered: float
    """The part of the photo that the mask shows as the object, 0 .. 1"""


@dataclass
class DecodedPhoto:
    """The pixels of a photo, and those of its mask."""

    radiance: np.ndarray
    """[h * w, 3] float32, linear, downscaled"""
    valid: np.ndarray
    """[h * w] bool"""
    mask: np.ndarray | None
    """[h * w] uint8"""
    facts: PhotoFacts


def decoded(capture: Capture, factors: list[int], use_masks: bool) -> Iterator[DecodedPhoto]:
    """The photos in their order. As many are decoded at the same time as `_DECODED_PIXELS` allows."""
    largest = max(v.camera.height * v.camera.width for v in capture.views)
    workers = max(1, min(torch.get_num_threads(), _DECODED_PIXELS // largest))
    with ThreadPoolExecutor(workers) as pool:
        ahead: deque = deque()
        try:
            for i, factor in enumerate(factors):
                ahead.append(pool.submit(_load, capture, i, factor, use_masks))
                if len(ahead) > 2 * workers:
                    yield _wait(ahead.popleft())
            while ahead:
                yield _wait(ahead.popleft())
        finally:
            for waiting in ahead:
                waiting.cancel()


@profiled("decode photos")
def _wait(future: Future) -> DecodedPhoto:
    return future.result()


def _load(capture: Capture, i: int, factor: int, use_masks: bool) -> DecodedPhoto:
    """Photo `i`, made linear and downscaled by `factor`, strip by strip."""
    photo = capture.open_photo(i)
    has_alpha = photo.has_alpha  # looks at every pixel
    cut_out = has_alpha and photo.least_alpha() < 0.5
    coverage = capture.open_mask(i) if use_masks else None
    usable = capture.open_usable(i) if use_masks else None
    height, width = photo.size
    rows = factor * max(1, STRIP_PIXELS // (factor * width))
    strips, repaired, brightest = [], dict.fromkeys(("bad", "negative", "blinding"), 0), 0.0
    for start in range(0, height, rows):
        raw, alpha = photo.rows(start, start + rows)
        if photo.is_float:
            finite = np.isfinite(raw).all(-1)
            repaired["bad"] += int((~finite).sum())
            repaired["negative"] += int((finite & (raw < 0).any(-1)).sum())
            repaired["blinding"] += int((finite & (raw > MAXIMUM_RADIANCE).any(-1)).sum())
            radiance = np.clip(raw, 0, MAXIMUM_RADIANCE)
            radiance[~finite] = 0
        else:
            finite, radiance = np.ones(raw.shape[:2], bool), raw
        brightest = max(brightest, float(radiance.max(initial=0.0)))
        if cut_out and alpha is not None:
            # At the edge of a cut-out, a pixel mixes the object with surroundings that were removed: its radiance is
            # neither the object's nor the surroundings'.
            finite &= (alpha > 0.98) | (alpha < 0.02)
            radiance[alpha < 0.02] = 0
        if usable is not None:
            finite &= usable.rows(start, start + rows) > 0.5
        if finite.all():
            radiance = box(radiance, factor)
            valid = np.ones(radiance.shape[:2], bool)
        else:
            weight = box(finite.astype(np.float32)[..., None], factor)
            radiance = box(radiance * finite[..., None], factor) / np.maximum(weight, 1e-6)
            valid = weight[..., 0] >= 0.5
            radiance[~valid] = 0
        mask = coverage.rows(start, start + rows) if coverage is not None else alpha if has_alpha else None
        if not use_masks or mask is None:
            mask = None
        else:
            mask = np.round(255 * box(mask[..., None], factor)[..., 0]).astype(np.uint8).ravel()
        strips.append((radiance.reshape(-1, 3), valid.ravel(), mask))
    radiance, valid = (np.concatenate([s[k] for s in strips]) for k in (0, 1))
    mask = None if strips[0][2] is None else np.concatenate([s[2] for s in strips])
    facts = PhotoFacts(
        repaired,
        bool(repaired["bad"]) and not valid.any(),
        brightest,
        cut_out,
        mask is not None,
        0.0 if mask is None else float((mask > 127).mean()),
    )
    if brightest <= _BLACK:
        valid[:] = False
    return DecodedPhoto(radiance, valid, mask, facts)


def judged(capture: Capture, photos: list[PhotoFacts]) -> list[Message]:
    """Warnings about the pixels. Raises CaptureError for a photo without finite pixels, or when every photo is black."""
    names = [v.image_path.name for v in capture.views]
    warnings: list[Message] = []
    for name, photo in zip(names, photos, strict=True):
        if photo.empty:
            raise CaptureError(
                f"{name} holds no finite pixel (all NaN or Inf)",
                "Render or export it again, or take its frame out of transforms.json.",
            )
    for kind in ("bad", "negative", "blinding"):
        found = [(n, p.repaired[kind]) for n, p in zip(names, photos, strict=True) if p.repaired[kind]]
        if found:
            warnings.append(_repair(kind, sum(count for _, count in found), [n for n, _ in found]))
    black = [n for n, p in zip(names, photos, strict=True) if p.brightest <= _BLACK]
    if len(black) == len(photos):
        raise CaptureError("all photos are black", "Check the exposure, and that the files hold color in R, G, B.")
    if black:
        warnings.append(Message("capture.photos_black", {"count": len(black), "names": black}))
    return warnings


def _repair(kind: str, pixels: int, names: list[str]) -> Message:
    """The warning for one kind of `PhotoFacts.repaired`: the number of pixels, and the photos that have them."""
    if kind == "bad":
        return Message("capture.pixels_not_finite", {"pixels": pixels, "photos": len(names), "names": names})
    if kind == "negative":
        return Message("capture.pixels_negative", {"pixels": pixels, "photos": len(names), "names": names})
    limit = MAXIMUM_RADIANCE
    return Message("capture.pixels_too_bright", {"pixels": pixels, "photos": len(names), "names": names, "limit": limit})
