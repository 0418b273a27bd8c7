"""Finds the color that tells the object in masks that are not black and white.

Programs for segmentation write a picture in which each thing has a color, or a small number. Other people hand in the object
before black, cut out of its photo, as its mask. The color at the borders of the photos is that of the surroundings. If there
are few colors, the object has the one that is most frequent where the cameras look.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from blender_nep.capture.photos.mask_files import MaskColor
from blender_nep.messages import Message

_COLORED = 0.15
"""Channels that differ by more make a color."""
_LEAST_COLORED = 0.005
"""So much of a mask must be colored (median)."""
_STEPS = 31
"""Colors that round to the same multiple of 1 / 31 are counted together."""
_MOST_LABELS = 24
_OF_LABELS = 0.97
"""So much of the masks must have one of `_MOST_LABELS` colors, or else they are pictures."""
_LEAST_LABEL = 0.003
"""Colors of a smaller part of all masks are those of edges."""
_LABEL_TOLERANCE, _PICTURE_TOLERANCE = 0.1, 0.06
_LARGEST_NUMBER = 63 / 255
"""If all values of gray masks are at most this, they may be numbers of things."""
_LEAST_BORDER = 0.6
"""One color must have so much of the photos' borders to be that of the surroundings."""
_MIDDLE = 0.15
"""Half the side of the patch where the cameras look, as a part of the photo's shorter side"""


def find_mask_color(
    pictures: Sequence[np.ndarray], looked_at: Sequence[tuple[float, float] | None]
) -> tuple[MaskColor | None, list[Message]]:
    """The color that decides in these masks, and what is to be said about it; None where white and black decide.

    pictures: [h, w, 3] in 0..1 each, as the files store them. looked_at: where in each its camera looks, as parts of height
    and width; None: not in the picture.
    """
    numbers = _are_numbers(pictures)
    if not numbers and float(np.median([_colored(picture) for picture in pictures])) < _LEAST_COLORED:
        return None, []
    steps = 255 if numbers else _STEPS
    rounded = [np.round(picture * steps).astype(np.int64) @ [1 << 16, 1 << 8, 1] for picture in pictures]
    everywhere, border = _counts(rounded), _counts([_edges(one) for one in rounded])
    surroundings, most = max(border.items(), key=lambda one: one[1])
    common = sorted(everywhere.values(), reverse=True)[:_MOST_LABELS]
    if sum(common) < _OF_LABELS:
        if most < _LEAST_BORDER:
            return None, [Message("capture.masks_colors_unclear")]
        color = MaskColor(_value(surroundings, steps), _PICTURE_TOLERANCE, is_object=False)
        return color, [Message("capture.masks_pictures", {"color": _name(color)})]
    labels = [label for label, share in everywhere.items() if share >= _LEAST_LABEL and label != surroundings]
    if not labels:
        return None, []
    middle = _counts([patch for one, at in zip(rounded, looked_at, strict=True) if (patch := _patch(one, at)).size])
    label = max(labels, key=lambda one: (middle.get(one, 0.0), everywhere[one]))
    color = MaskColor(_value(label, steps), 0.4 / 255 if numbers else _LABEL_TOLERANCE, is_object=True)
    return color, [Message("capture.masks_labels", {"color": _name(color), "count": len(labels) + 1})]


def _colored(picture: np.ndarray) -> float:
    """The part of a mask that has a color."""
    return float((picture.max(-1) - picture.min(-1) > _COLORED).mean())


def _are_numbers(pictures: Sequence[np.ndarray]) -> bool:
    """Whether the values of gray masks are small whole numbers, at least three."""
    if max(float(picture.max()) for picture in pictures) > _LARGEST_NUMBER:
        return False
    values = np.unique(np.concatenate([np.unique(picture) for picture in pictures]))
    return len(values) > 2 and bool(np.abs(values * 255 - np.round(values * 255)).max() < 1e-3)


def _counts(parts: Sequence[np.ndarray]) -> dict[int, float]:
    """{color: its part of all pixels}"""
    values, counts = np.unique(np.concatenate([part.ravel() for part in parts]) if parts else [], return_counts=True)
    return dict(zip(values.astype(int).tolist(), (counts / max(1, counts.sum())).tolist(), strict=True))


def _edges(picture: np.ndarray) -> np.ndarray:
    return np.concatenate([picture[0], picture[-1], picture[:, 0], picture[:, -1]])


def _patch(picture: np.ndarray, at: tuple[float, float] | None) -> np.ndarray:
    """The pixels where the camera looks; none if that is not in the picture."""
    if at is None:
        return np.zeros(0, np.int64)
    height, width = picture.shape
    row, column, half = int(at[0] * height), int(at[1] * width), max(1, round(_MIDDLE * min(height, width)))
    return picture[max(0, row - half) : row + half + 1, max(0, column - half) : column + half + 1]


def _value(rounded: int, steps: int) -> tuple[float, float, float]:
    return tuple(part / steps for part in (rounded >> 16, rounded >> 8 & 255, rounded & 255))  # type: ignore[return-value]


def _name(color: MaskColor) -> str:
    return " ".join(str(round(255 * part)) for part in color.value)
