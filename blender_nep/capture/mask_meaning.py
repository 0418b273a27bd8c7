"""Recognizes what the masks of a capture mean.

White should be the object. Other programs write other masks: white is the background, or white is all that may be used
(black are people, logos, blemishes or the rim of a lens), or there is one mask for all photos, or white is the value 1. Such
masks would say that nearly everything is the object.

What masks mean is decided for the capture as a whole, from some of its masks. The object lies where the cameras look. It
seldom fills the borders of most photos. And its silhouettes agree: a body that all of them show stands there. Each side of
the masks, white and black, is asked whether it can be such an object.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy import ndimage

from blender_nep.capture.bounds import carve, hull_of_masks, sphere_from_masks
from blender_nep.capture.cameras.camera import Camera
from blender_nep.capture.capture import Capture
from blender_nep.capture.mask_colors import find_mask_color
from blender_nep.capture.photos.mask_files import MaskColor, MaskMeaning, MaskRaster, MaskReading
from blender_nep.errors import CaptureError
from blender_nep.messages import Message

_MOST_MASKS = 24
"""So many masks are looked at. They are spread over the capture."""
_ROWS = 100
"""The longer side of a mask that is looked at has this to twice this many pixels."""
_GRID = 32
"""Points along each side of the cube where the space that silhouettes leave is measured"""
_DIM = 0.75
"""If no mask has a value above this, masks of two values have another white than the largest value of their files."""
_WHITE_EVERYWHERE = 0.999
_LEAST_OBJECT = 0.005
"""A smaller part of the photo is a blemish and no object."""
_BORDER = 0.8
"""If white covers so much of the photos' borders, white is not the object."""
_FILL = 0.6
"""If the silhouettes leave so much of the space around the object, they show no object."""
_FILL_INSIDE = 0.85
"""... and this much where white does not cover most of the border: a large object may fill a photo."""
_MOSTLY_USABLE = 0.95
"""Black that covers less than the rest of a photo is left out, even where a body might explain it."""
_RECTANGLE = 0.97
"""White that covers so much of the rectangle around it is the inside of a frame."""
_LARGEST = 1.8
"""A body with a larger sphere, in radii of the sphere where the object is looked for, is no object."""
_LOOKED_AT = 0.8
"""If so much is white where the cameras look, black is not the object, or it has a hole there."""
_EXPLAINED = 0.6
"""So much of the silhouettes must lie in the sphere around the body that they agree on."""
_FITS, _HARDLY_FITS = 0.9, 0.7
"""A body explains so much of the silhouettes of right masks. Less than the second: the masks are of other photos."""
_LEAST_MASKS = 6
"""Fewer silhouettes hardly contradict each other."""
_CLEARLY = 0.7
"""So much white where its camera looks, and none at the border, tells the sort of a single mask, or so much black there."""
_NO_COLORS = 1e-3
"""Colors that differ by less are one color."""
_PATCH = 0.05
"""Half the side of the patch where the cameras look, as a part of the photo's shorter side"""


@dataclass(frozen=True)
class Judgment:
    """How masks are to be read, and why."""

    reading: MaskReading
    messages: list[Message]


def read_masks(capture: Capture, told: MaskMeaning | None = None) -> list[Message]:
    """Set `capture.mask_reading` as its masks look, or as the user has `told`, and say what was assumed.

    The capture's sphere must be known, at least as the cameras suggest it. Raises CaptureError where a mask cannot be read.
    """
    masked = [i for i, view in enumerate(capture.views) if view.mask_path is not None]
    if not masked:
        return []
    chosen = [masked[k] for k in np.unique(np.linspace(0, len(masked) - 1, _MOST_MASKS).round().astype(int))]
    first = {i: seen for i in chosen if (mask := capture.open_mask(i)) is not None and (seen := _first_look(mask))}
    places = [_looked_at(capture.views[i].camera, capture.object_center) for i in first]
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
        step = 1 if mask is None else _step(mask)
        alpha = photo.alpha(step)
        if mask is not None and alpha is not None and (shown := mask.coverage(step) > 0.5).any():
            hidden.append(float((alpha[shown] < 0.5).mean()))
    return bool(hidden) and float(np.median(hidden)) > 0.5


def _sort(camera: Camera, mask: np.ndarray, center: np.ndarray) -> int:
    """1 if a mask is clearly white where its camera looks and black at the border, -1 the other way round; else 0."""
    at = _looked_at(camera, center)
    if at is None:
        return 0
    border, middle = _border([mask]), float(_patch(mask, at).mean())
    if border >= _BORDER and middle <= 1 - _CLEARLY:
        return -1
    return 1 if border <= 1 - _BORDER and middle >= _CLEARLY else 0


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
        step = max(1, min(max(photo.size) // _ROWS, min(photo.size)))
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


def _has_colors(capture: Capture, i: int, opaque: np.ndarray) -> bool:
    """Whether photo `i` has colors where it is transparent. opaque: [h, w] bool of some pixels."""
    photo = capture.open_photo(i)
    step = max(1, min(max(photo.size) // _ROWS, min(photo.size)))
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
    size = mask.raster.size
    return _Seen(*mask.look(max(1, min(max(size) // _ROWS, min(size)))))


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
        raw = [mask.coverage(_step(mask)) for k in chosen if (mask := _opened(paths[k], MaskReading(color=color)))]
    white, messages = _white(raw)
    messages = of_color + messages
    masks = [mask / white > 0.5 for mask in raw]
    middles = [mask[len(mask) // 3 : -(len(mask) // 3), mask.shape[1] // 3 : -(mask.shape[1] // 3)] for mask in masks]
    middle = float(np.median([part.mean() for part in middles]))
    black = 1 - float(np.median([mask.mean() for mask in masks]))
    inverted = len(set(paths)) > 1 and _border(masks) >= _BORDER and black >= _LEAST_OBJECT and middle < 0.5
    if inverted:
        return MaskReading(MaskMeaning.BACKGROUND, white, color), [*messages, *_background().messages]
    return MaskReading(white=white, color=color), messages


def _border(masks: Sequence[np.ndarray]) -> float:
    """The part of a photo's border that is white, 0..1 (median). masks: [h, w] bool each."""
    return float(np.median([np.concatenate([m[0], m[-1], m[:, 0], m[:, -1]]).mean() for m in masks]))


def _coarse(capture: Capture, i: int) -> np.ndarray | None:
    """Values [h, w] in 0..1 of some pixels of mask `i`, as its file stores them."""
    mask = capture.open_mask(i)
    return None if mask is None else mask.coverage(_step(mask))


def _step(mask: MaskRaster) -> int:
    """So many pixels of a mask are passed over from one that is looked at to the next one."""
    return max(1, min(max(mask.size) // _ROWS, min(mask.size)))


def _looked_at(camera: Camera, center: np.ndarray) -> tuple[float, float] | None:
    """Where the photo shows `center` [3], as parts of its height and width; None where it does not."""
    x, y, depth = (float(value[0]) for value in camera.project(center[None]))
    if depth > 0 and 0 <= x < camera.width and 0 <= y < camera.height:
        return y / camera.height, x / camera.width
    return None


def _patch(mask: np.ndarray, at: tuple[float, float]) -> np.ndarray:
    """The pixels around the place `at`, given as parts of height and width."""
    height, width = mask.shape
    row, column, half = int(at[0] * height), int(at[1] * width), max(1, round(_PATCH * min(height, width)))
    return mask[max(0, row - half) : row + half + 1, max(0, column - half) : column + half + 1]


def _white(masks: list[np.ndarray]) -> tuple[float, list[Message]]:
    """The value that counts as white, and a message if that is not the largest value of the files."""
    largest = max((float(mask.max()) for mask in masks), default=0.0)
    between = [float(((mask > 0.25 * largest) & (mask < 0.75 * largest)).mean()) for mask in masks]
    if not 0 < largest < _DIM or np.mean(between) > 0.05:
        return 1.0, []
    return largest, [Message("capture.masks_dim", {"percent": 100 * largest})]


class Sides:
    """The white and the black side of masks, each of which may be the object."""

    def __init__(self, cameras: Sequence[Camera], masks: Sequence[np.ndarray], center: np.ndarray, radius: float) -> None:
        """masks: [h, w] bool each, white. center [3], radius: of the sphere where the object is looked for."""
        self.cameras, self.white, self.center, self.radius = list(cameras), list(masks), center, radius

    @cached_property
    def black(self) -> list[np.ndarray]:
        """[h, w] bool of each mask"""
        return [~mask for mask in self.white]

    @cached_property
    def share(self) -> float:
        """The part of a photo that is white, 0..1 (median)."""
        return float(np.median([mask.mean() for mask in self.white]))

    @cached_property
    def mean_share(self) -> float:
        """The part of all photos that is white, 0..1."""
        return float(np.mean([mask.mean() for mask in self.white]))

    @cached_property
    def border(self) -> float:
        """The part of a photo's border that is white, 0..1 (median)."""
        return _border(self.white)

    @cached_property
    def looked_at(self) -> float:
        """How much is white where the cameras look, 0..1 (median); 0.5 if no photo shows that place."""
        found = []
        for camera, mask in zip(self.cameras, self.white, strict=True):
            at = _looked_at(camera, self.center)
            if at is not None:
                found.append(float(_patch(mask, at).mean()))
        return float(np.median(found)) if found else 0.5

    @cached_property
    def alike(self) -> bool:
        """All masks are the same picture, and it is neither all white nor all black."""
        first = self.white[0]
        same = all(mask.shape == first.shape and (mask == first).all() for mask in self.white)
        return bool(len(self.white) > 1 and same and first.any() and not first.all())

    @cached_property
    def touches(self) -> bool:
        """White reaches opposite borders of the first mask."""
        first = self.white[0]
        return bool((first[0].any() and first[-1].any()) or (first[:, 0].any() and first[:, -1].any()))

    @cached_property
    def is_framed(self) -> bool:
        """White is a rectangle in most photos."""
        rows, columns = ([mask.any(axis).sum() for mask in self.white] for axis in (1, 0))
        parts = [m.sum() / max(1, r * c) for m, r, c in zip(self.white, rows, columns, strict=True)]
        return float(np.median(parts)) >= _RECTANGLE

    @cached_property
    def black_agrees(self) -> bool:
        """Black may be a body: most photos show it, and there is a place that is black in all of them."""
        shown = np.mean([mask.any() for mask in self.black])
        scaled = [mask.astype(np.float32) for mask in self.black]
        return bool(shown >= 0.5) and sphere_from_masks(self.cameras, scaled, self.center, self.radius) is not None

    def fill(self, masks: list[np.ndarray]) -> float:
        """The part of the space around the object that silhouettes leave, 0..1."""
        axis = np.linspace(-1.5, 1.5, _GRID) * self.radius
        points = self.center + np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), -1).reshape(-1, 3)
        framed, kept = carve(self.cameras, masks, points)
        return float(kept.sum() / max(1, framed.sum()))

    def covered(self, masks: list[np.ndarray]) -> float | None:
        """The part of a silhouette that the body explains on which all silhouettes agree, 0..1 (median).

        Right silhouettes have 0.98 and more, those of other photos 0.2 to 0.85. None: there are too few.
        """
        if sum(mask.any() for mask in masks) < _LEAST_MASKS:
            return None
        scaled = [mask.astype(np.float32) for mask in masks]
        hull = hull_of_masks(self.cameras, scaled, self.center, self.radius)
        if hull is None:
            return 0.0
        points, voxel = hull
        parts = []
        for camera, mask in zip(self.cameras, masks, strict=True):
            height, width = mask.shape
            x, y, depth = camera.project(points)
            with np.errstate(invalid="ignore"):
                row, column = np.floor(y * height / camera.height), np.floor(x * width / camera.width)
            ok = (depth > 0) & (row >= 0) & (row < height) & (column >= 0) & (column < width)
            if mask.any() and ok.any():
                body = np.zeros_like(mask)
                body[row[ok].astype(int), column[ok].astype(int)] = True
                pixels = voxel.max() * camera.fl_x * width / camera.width / float(np.median(depth[ok]))
                body = ndimage.binary_dilation(body, iterations=max(1, min(width, math.ceil(pixels))))
                parts.append(float((mask & body).sum() / mask.sum()))
        return float(np.median(parts)) if parts else None

    def is_body(self, masks: list[np.ndarray]) -> bool:
        """Whether the silhouettes agree on a body around the place where the cameras look, and show little beside it."""
        scaled = [mask.astype(np.float32) for mask in masks]
        sphere = sphere_from_masks(self.cameras, scaled, self.center, self.radius)
        if sphere is None or sphere[1] > _LARGEST * self.radius or self.fill(masks) > _FILL:
            return False
        if np.linalg.norm(sphere[0] - self.center) > 1.5 * sphere[1]:
            return False
        explained = []
        for camera, mask in zip(self.cameras, masks, strict=True):
            if mask.any():
                rows, columns = np.nonzero(mask)
                x, y = (columns + 0.5) * camera.width / mask.shape[1], (rows + 0.5) * camera.height / mask.shape[0]
                to_center = sphere[0] - camera.position
                along = camera.directions(x, y) @ to_center
                beside = np.sqrt(np.maximum((to_center**2).sum() - along**2, 0))
                explained.append(float(((along > 0) & (beside < sphere[1])).mean()))
        return bool(explained) and float(np.median(explained)) >= _EXPLAINED


def judge(sides: Sides, one_file: bool) -> Judgment:
    """What masks mean by what they look like. one_file: all photos have the same file."""
    if one_file:
        return _usable(sides, Message("capture.masks_one_for_all"))
    if min(mask.mean() for mask in sides.white) >= _WHITE_EVERYWHERE:
        return Judgment(MaskReading(MaskMeaning.NOTHING), [Message("capture.masks_white")])
    if sides.alike:
        return _judge_alike(sides)
    if sides.border < 0.5:
        # black is a frame around the photo, or silhouettes leave everything; an object that fills the photo leaves less
        if sides.share >= 0.5 and (sides.is_framed or sides.fill(sides.white) >= _FILL_INSIDE):
            return _usable(sides)
        # the object's own silhouettes show it where the cameras look, if it has no hole there
        if sides.looked_at < 0.3 and sides.is_body(sides.black) and not sides.is_body(sides.white):
            return _background()
        return Judgment(MaskReading(), [])
    if _is_inverted(sides):
        return _background() if sides.looked_at <= _LOOKED_AT else _doubtful(sides)
    if sides.share >= 0.5 and (
        sides.border >= _BORDER or sides.fill(sides.white) >= _FILL or not sides.is_body(sides.white)
    ):
        if sides.mean_share < _MOSTLY_USABLE and sides.black_agrees:  # it may be the object all the same
            return _doubtful(sides)
        return _usable(sides)
    return _unclear(sides)


def _is_inverted(sides: Sides) -> bool:
    """Whether black may be the object. An object that fills the photos has no silhouettes, but black where cameras look."""
    if 1 - sides.share < _LEAST_OBJECT:
        return False
    fills = sides.looked_at <= 0.2 and sides.fill(sides.black) >= 0.1
    return fills or sides.is_body(sides.black)


def _judge_alike(sides: Sides) -> Judgment:
    """Masks that are all the same picture: of a ball in the middle, or of a rig that every photo shows at the same place."""
    alike = Message("capture.masks_alike")
    if sides.share <= 0.5 and sides.border < 0.5 and not sides.touches:
        return Judgment(MaskReading(), [] if _is_disc(sides.white[0]) else [alike])
    if sides.border >= _BORDER and sides.looked_at < 0.5 and 1 - sides.share >= 0.05 and _is_inverted(sides):
        return Judgment(MaskReading(MaskMeaning.BACKGROUND), [*_background().messages, alike])
    return _usable(sides)


def _is_disc(mask: np.ndarray) -> bool:
    """Whether white is about as round as a ball in the middle of a photo, which looks alike from everywhere."""
    height, width = mask.any(1).sum(), mask.any(0).sum()
    return bool(abs(height - width) <= 0.15 * width and abs(mask.sum() / (height * width) - np.pi / 4) < 0.1)


def _background() -> Judgment:
    return Judgment(MaskReading(MaskMeaning.BACKGROUND), [Message("capture.masks_background")])


def _usable(sides: Sides, why: Message | None = None) -> Judgment:
    """White is what may be used. Masks that would leave out most of the photos are passed over."""
    percent = 100 * (1 - sides.mean_share)
    said = [why] if why else []
    if sides.share < 0.5:
        return Judgment(MaskReading(MaskMeaning.NOTHING), [*said, Message("capture.masks_not_used", {"percent": percent})])
    return Judgment(MaskReading(MaskMeaning.USABLE), [*said, Message("capture.masks_usable", {"percent": percent})])


def _unclear(sides: Sides) -> Judgment:
    """Nothing says that white is not the object. So it is believed."""
    return Judgment(MaskReading(), [Message("capture.masks_unclear", {"percent": 100 * sides.share})])


def _doubtful(sides: Sides) -> Judgment:
    """White cannot be the object, and black may be it. So black must not be left out, and it is not believed either."""
    return Judgment(MaskReading(MaskMeaning.NOTHING), [Message("capture.masks_doubtful", {"percent": 100 * sides.share})])
