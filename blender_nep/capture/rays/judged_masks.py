"""Judges the masks of a capture: which photos lack a usable one, and what the user is told."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from blender_nep.capture.cameras.camera import Camera
from blender_nep.capture.capture import Capture
from blender_nep.capture.description import MINIMUM_VIEWS, MOST_LACKING
from blender_nep.capture.mask_meaning import alpha_shows_object
from blender_nep.capture.photos.mask_files import MaskMeaning
from blender_nep.capture.rays.decoded_photos import PhotoFacts
from blender_nep.errors import CaptureError
from blender_nep.messages import Message


@dataclass(frozen=True)
class JudgedMasks:
    """What the masks are good for."""

    usable: bool
    """Whether the masks are used: all photos have one, but for those that are left out"""
    unusable: frozenset[int]
    """The photos in which it is not known where the object is. Their pixels are not used."""
    warnings: list[Message]


def judged_masks(capture: Capture, facts: list[PhotoFacts], lacking: list[int], use_masks: bool) -> JudgedMasks:
    """Judge the masks by the facts of all photos. `lacking` are `photos_without_masks`.

    Raises CaptureError if all masks are empty.
    """
    warnings: list[Message] = []

    def names_of(photos: list[int]) -> list[str]:
        return [capture.views[i].name for i in photos]

    cut_out = any(p.cut_out for p in facts)
    masked = use_masks and all(p.has_mask for p in facts)
    if use_masks and not masked and any(p.has_mask for p in facts):
        missing = [i for i, p in enumerate(facts) if not p.has_mask]
        warnings.append(Message("capture.masks_missing", {"count": len(missing), "names": names_of(missing)}))
    if cut_out and not masked:
        warnings.append(Message("capture.cut_outs_need_masks"))
    if masked and not any(p.covered for p in facts):
        raise CaptureError(
            "the masks are empty: no pixel belongs to the object",
            "Check mask_path and the masks' polarity (white is object), or the photos' alpha (0 is not the object).",
        )
    cameras = [view.camera for view in capture.views]
    unknown = [i for i, p in enumerate(facts) if masked and not p.covered and _sees_center(capture, cameras[i])]
    full = _full(facts) if masked and not cut_out else []
    empty = [i for i in unknown if i not in lacking]
    if lacking:
        warnings.append(Message("capture.masks_lacking", {"count": len(lacking), "names": names_of(lacking)}))
    if full:
        warnings.append(Message("capture.masks_full", {"count": len(full), "names": names_of(full)}))
    if empty:
        warnings.append(Message("capture.masks_empty", {"count": len(empty), "names": names_of(empty)}))
    return JudgedMasks(masked, frozenset({*unknown, *lacking, *full}), warnings)


def photos_masked_by_alpha(capture: Capture) -> list[int]:
    """The photos without a mask file that are cut-outs, if others have one: their alpha is their mask.

    Raises CaptureError where a photo cannot be read.
    """
    if capture.mask_reading.meaning not in (MaskMeaning.OBJECT, MaskMeaning.BACKGROUND):
        return []
    without = [i for i, view in enumerate(capture.views) if view.mask_path is None]
    return [i for i in without if alpha_shows_object(capture, i)] if len(without) < len(capture.views) else []


def photos_without_masks(capture: Capture, by_alpha: list[int]) -> list[int]:
    """The photos that have no mask, if nearly all others have one. Many such photos would be too many to leave out.

    by_alpha: the photos whose alpha is their mask
    """
    if capture.mask_reading.meaning not in (MaskMeaning.OBJECT, MaskMeaning.BACKGROUND):
        return []
    without = [i for i, view in enumerate(capture.views) if view.mask_path is None and i not in by_alpha]
    enough = len(without) <= MOST_LACKING * len(capture.views) and len(capture.views) - len(without) >= MINIMUM_VIEWS
    return without if enough else []


def _full(facts: list[PhotoFacts]) -> list[int]:
    """The photos whose masks are white everywhere, if those of others show an object: what made the masks failed there."""
    full = [i for i, p in enumerate(facts) if p.covered >= 0.999]
    others = [p.covered for p in facts if p.covered < 0.999]
    return full if 2 * len(full) <= len(facts) and len(others) >= MINIMUM_VIEWS and np.median(others) < 0.5 else []


def _sees_center(capture: Capture, camera: Camera) -> bool:
    """Whether the middle of the object's sphere lies in the camera's picture."""
    return bool(camera.side_distances(capture.object_center).min() > 0)
