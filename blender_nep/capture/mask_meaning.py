"""Recognizes what the masks of a capture mean, and its photos' alpha.

White should be the object. Other programs write other masks: white is the background, or white is all that may be used
(black are people, logos, blemishes or the rim of a lens), or there is one mask for all photos, or white is the value 1. Such
masks would say that nearly everything is the object.

What masks mean is decided for the capture as a whole, from some of its masks: by their colors (mask_colors.py), by what
white and black look like (mask_looks.py), and by whether they show one body.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from blender_nep.capture.cameras.camera import Camera
from blender_nep.capture.capture import Capture
from blender_nep.capture.mask_colors import find_mask_color
from blender_nep.capture.mask_looks import (
    BORDER,
    LEAST_OBJECT,
    Judgment,
    Sides,
    border_share,
    judge,
    judged_inverted,
    patch_at,
    place_looked_at,
)
from blender_nep.capture.photos.mask_files import MaskColor, MaskMeaning, MaskRaster, MaskReading
from blender_nep.errors import CaptureError
from blender_nep.messages import Message

_MOST_MASKS = 24
"""So many masks are looked at. They are spread over the capture."""
_ROWS = 100
"""The longer side of a mask that is looked at has this to twice this many pixels."""
_DIM = 0.75
"""If no mask has a value above this, masks of two values have another white than the largest value of their files."""
_FITS, _HARDLY_FITS = 0.9, 0.7
"""A body explains so much of the silhouettes of right masks. Less than the second: the masks are of other photos."""
_CLEARLY = 0.7
"""So much white where its camera looks, and none at the border, tells the sort of a single mask, or so much black there."""
_NO_COLORS = 1e-3
"""Colors that differ by less are one color."""


def read_masks(capture: Capture, told: MaskMeaning | None = None) -> list[Message]:
    """Set `capture.mask_reading` as its masks look, or as the user has `told`, and say what was assumed.

    The capture's sphere must be known, at least as the cameras suggest it. Raises CaptureError where a mask cannot be read.
    """
    masked = [i for i, view in enumerate(capture.views) if view.mask_path is not None]
    if not masked:
        return []
    chosen = [masked[k] for k in np.unique(np.linspace(0, len(masked) - 1, _MOST_MASKS).round().astype(int))]
    first = {i: _first_look(mask) for i in chosen if (mask := capture.open_mask(i)) is not None}
    places = [place_looked_at(capture.views[i].camera, capture.object_center) for i in first]
    color, of_color = _color([seen.colors for seen in first.values()], places)
    raw = {i: seen.coverage for i, seen in first.items()}
    if color is not None:
        capture.mask_reading = MaskReading(color=color)
        raw = {i: again for i in first if (again := _coarse(capture, i)) is not None}
    white, messages = _white(list(raw.values()))
    masks = [np.clip(mask / white, 0, 1) > 0.5 for mask in raw.values()]
    cameras = [capture.views[i].camera for i in raw]
    sorts = [_sort(camera, mask, capture.object_center) for camera, mask in zip(cameras, masks, strict=True)]
    usual = 1 if sum(sorts) >= 0 else -1
    masks = [~mask if sort == -usual else mask for mask, sort in zip(masks, sorts, strict=True)]
    told_apart = [k for k, mask in enumerate(masks) if not mask.all()]  # a white mask is one that failed
    if 2 * len(told_apart) >= len(masks):
        cameras, masks = [cameras[k] for k in told_apart], [masks[k] for k in told_apart]
    sides = Sides(cameras, masks, capture.object_center, capture.object_radius)
    one_file = len(masked) > 1 and len({capture.views[i].mask_path for i in masked}) == 1
    looks = judge(sides, one_file) if any(mask.any() for mask in masks) else Judgment(MaskReading(), [])
    if told is None:
        meaning, said = looks.reading.meaning, looks.messages
    else:
        meaning = told
        differs = looks.reading.meaning not in (told, MaskMeaning.NOTHING)
        said = [Message("capture.masks_as_told", {"meaning": str(told)})] if differs else []
    capture.mask_reading = MaskReading(meaning, white, color)
    if -usual in sorts and meaning in (MaskMeaning.OBJECT, MaskMeaning.BACKGROUND):
        said = said + _turn(capture, masked, usual)
    if meaning in (MaskMeaning.OBJECT, MaskMeaning.BACKGROUND):
        said = said + _judge_fit(capture, sides, told)
    if capture.mask_reading.meaning != MaskMeaning.NOTHING and _alpha_hides(capture, chosen):
        capture.ignores_alpha = True
        said = [*said, Message("capture.alpha_inverted")]
    return of_color + messages + said


def _judge_fit(capture: Capture, sides: Sides, told: MaskMeaning | None) -> list[Message]:
    """Whether the masks show one body from the places of their cameras. If they clearly do not, they are passed over."""
    covered = sides.covered(sides.white if capture.mask_reading.meaning == MaskMeaning.OBJECT else sides.black)
    if covered is None or covered >= _FITS:
        return []
    if not covered and capture.bounds_source != "cameras":  # the given sphere may be elsewhere
        return []
    percent = 100 * covered
    if covered >= _HARDLY_FITS or told is not None:
        return [Message("capture.masks_hardly_fit", {"percent": percent})]
    capture.mask_reading = replace(capture.mask_reading, meaning=MaskMeaning.NOTHING)
    return [Message("capture.masks_do_not_fit", {"percent": percent})]


def _alpha_hides(capture: Capture, chosen: Sequence[int]) -> bool:
    """Whether the photos are transparent where their masks show the object, so that alpha means something else."""
    if capture.mask_reading.meaning == MaskMeaning.USABLE or capture.open_photo(chosen[0]).least_alpha() >= 0.5:
        return False
    hidden = []
    for i in chosen:
        photo, mask = capture.open_photo(i), capture.open_mask(i)
        step = 1 if mask is None else _step(mask.size)
        alpha = photo.alpha(step)
        if mask is not None and alpha is not None and (shown := mask.coverage(step) > 0.5).any():
            hidden.append(float((alpha[shown] < 0.5).mean()))
    return bool(hidden) and float(np.median(hidden)) > 0.5


def _sort(camera: Camera, mask: np.ndarray, center: np.ndarray) -> int:
    """1 if a mask is clearly white where its camera looks and black at the border, -1 the other way round; else 0."""
    at = place_looked_at(camera, center)
    if at is None:
        return 0
    border, middle = border_share([mask]), float(patch_at(mask, at).mean())
    if border >= BORDER and middle <= 1 - _CLEARLY:
        return -1
    return 1 if border <= 1 - BORDER and middle >= _CLEARLY else 0


def _turn(capture: Capture, masked: Sequence[int], usual: int) -> list[Message]:
    """Turn the masks that are not of the usual sort, and say so."""
    inverted = capture.mask_reading.meaning == MaskMeaning.BACKGROUND
    odd = []
    for i in masked:
        coverage = _coarse(capture, i)
        if coverage is None:
            continue
        white = (coverage > 0.5) != inverted
        if _sort(capture.views[i].camera, white, capture.object_center) == -usual:
            odd.append(i)
    turned = frozenset(path for i in odd if (path := capture.views[i].mask_path) is not None)
    capture.mask_reading = replace(capture.mask_reading, turned=turned)
    return [Message("capture.masks_turned", {"count": len(odd), "names": [capture.views[i].name for i in odd]})]


def read_alpha(capture: Capture) -> list[Message]:
    """Recognize photos whose alpha is no cut-out of the object. Then it becomes their mask.

    It may be 0 where the object is, and 1 in the surroundings, or 0 in a part that may not be used, such as a corner. For
    captures without mask files. Raises CaptureError where the photos have lost the colors of the object.
    """
    views = capture.views
    if any(view.mask_path is not None for view in views) or not capture.open_photo(0).has_alpha:
        return []
    chosen = np.unique(np.linspace(0, len(views) - 1, _MOST_MASKS).round().astype(int)).tolist()
    masks = []
    for i in chosen:
        photo = capture.open_photo(i)
        step = _step(photo.size)
        alpha = photo.alpha(step)
        if alpha is None or photo.least_alpha() >= 0.5:
            return []
        masks.append(alpha > 0.5)
    sides = Sides([views[i].camera for i in chosen], masks, capture.object_center, capture.object_radius)
    looks = judge(sides, one_file=False)
    if looks.reading.meaning == MaskMeaning.USABLE:
        capture.views = [replace(view, mask_path=view.image_path) for view in views]
        capture.mask_reading, capture.ignores_alpha = looks.reading, True
        return [Message("capture.alpha_usable", {"percent": 100 * (1 - sides.mean_share)})]
    if looks.reading.meaning != MaskMeaning.BACKGROUND:
        return []
    if not any(_has_colors(capture, i, mask) for i, mask in zip(chosen, masks, strict=True)):
        raise CaptureError(
            "the photos are transparent where the object is, and have no colors there: their alpha is inverted",
            "Export them again with the surroundings transparent, or without transparency.",
        )
    capture.views = [replace(view, mask_path=view.image_path) for view in views]
    capture.mask_reading, capture.ignores_alpha = MaskReading(MaskMeaning.BACKGROUND), True
    return [Message("capture.alpha_inverted")]


def alpha_shows_object(capture: Capture, i: int) -> bool:
    """Whether photo `i` is a cut-out that clearly shows the object where its camera looks. Raises CaptureError."""
    photo = capture.open_photo(i)
    alpha = photo.alpha(_step(photo.size))
    if alpha is None or photo.least_alpha() >= 0.5:
        return False
    return _sort(capture.views[i].camera, alpha > 0.5, capture.object_center) == 1


def _has_colors(capture: Capture, i: int, opaque: np.ndarray) -> bool:
    """Whether photo `i` has colors where it is transparent. opaque: [h, w] bool of some pixels."""
    photo = capture.open_photo(i)
    step = _step(photo.size)
    kept = range(step // 2, photo.size[0], step)
    hidden = np.concatenate([photo.rows(row, row + 1)[0][:, step // 2 :: step] for row in kept])[~opaque]
    return len(hidden) > 0 and bool(np.ptp(np.nan_to_num(hidden), axis=0).max() >= _NO_COLORS)


class _Seen(NamedTuple):
    """What is looked at of a mask."""

    coverage: np.ndarray
    """[h, w] as `MaskRaster.coverage` has it"""
    colors: np.ndarray | None
    """[h, w, 3] as `MaskRaster.colors` has them"""


def _first_look(mask: MaskRaster) -> _Seen:
    return _Seen(*mask.look(_step(mask.raster.size)))


def _color(
    pictures: Sequence[np.ndarray | None], looked_at: Sequence[tuple[float, float] | None]
) -> tuple[MaskColor | None, list[Message]]:
    """The color that decides; None where alpha decides in some masks."""
    known = [picture for picture in pictures if picture is not None]
    return find_mask_color(known, looked_at) if known and len(known) == len(pictures) else (None, [])


def _opened(path: Path, reading: MaskReading | None = None) -> MaskRaster:
    """The mask of a photo without a camera. Raises CaptureError."""
    try:
        return MaskRaster.of(path, reading)
    except CaptureError as error:
        hint = "Take it out, or copy it again."
        raise CaptureError(str(error), hint, "capture.photo_unreadable", photo=path.name) from error


def read_photo_masks(paths: Sequence[Path]) -> tuple[MaskReading, list[Message]]:
    """How the masks of photos without cameras are read, and what was assumed.

    The middle of a photo counts as the place where its camera looks. Only inverted masks, masks with another white and
    colored masks are recognized. Raises CaptureError where a mask cannot be read.
    """
    chosen = np.unique(np.linspace(0, len(paths) - 1, _MOST_MASKS).round().astype(int))
    first = [_first_look(_opened(paths[k])) for k in chosen]
    color, of_color = _color([seen.colors for seen in first], [(0.5, 0.5)] * len(first))
    raw = [seen.coverage for seen in first]
    if color is not None:
        raw = [mask.coverage(_step(mask.size)) for k in chosen if (mask := _opened(paths[k], MaskReading(color=color)))]
    white, messages = _white(raw)
    messages = of_color + messages
    masks = [mask / white > 0.5 for mask in raw]
    middles = [mask[len(mask) // 3 : -(len(mask) // 3), mask.shape[1] // 3 : -(mask.shape[1] // 3)] for mask in masks]
    middle = float(np.median([part.mean() for part in middles]))
    black = 1 - float(np.median([mask.mean() for mask in masks]))
    inverted = len(set(paths)) > 1 and border_share(masks) >= BORDER and black >= LEAST_OBJECT and middle < 0.5
    if inverted:
        return MaskReading(MaskMeaning.BACKGROUND, white, color), [*messages, *judged_inverted().messages]
    return MaskReading(white=white, color=color), messages


def _coarse(capture: Capture, i: int) -> np.ndarray | None:
    """Values [h, w] in 0..1 of some pixels of mask `i`, as its file stores them."""
    mask = capture.open_mask(i)
    return None if mask is None else mask.coverage(_step(mask.size))


def _step(size: tuple[int, int]) -> int:
    """Every so many pixels of a picture of this size (H, W), one is looked at along each axis."""
    return max(1, min(max(size) // _ROWS, min(size)))


def _white(masks: list[np.ndarray]) -> tuple[float, list[Message]]:
    """The value that counts as white, and a message if that is not the largest value of the files."""
    largest = max((float(mask.max()) for mask in masks), default=0.0)
    between = [float(((mask > 0.25 * largest) & (mask < 0.75 * largest)).mean()) for mask in masks]
    if not 0 < largest < _DIM or np.mean(between) > 0.05:
        return 1.0, []
    return largest, [Message("capture.masks_dim", {"percent": 100 * largest})]
