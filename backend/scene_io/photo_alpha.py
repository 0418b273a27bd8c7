"""Photos that are shown whole although they have transparent pixels.

Usually transparent is what surrounds the object. Some photos mean the opposite, or leave out a corner. The engine recognizes
them (blender_nep/capture/mask_meaning.py) and takes them as whole photos. Here one mark is enough: most of their border is
opaque, which is so with hardly any cut-out.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..plain_files import open_plain
from .capture_files import Frame
from .image_files import load_pixels
from .photos.formats import HEIF, RAW

MOST_PHOTOS = 5  # so many are read, spread over all; a capture without transparent pixels shows it in the first one
BORDER = 0.8  # as in blender_nep/capture/mask_looks.py
_WITHOUT_ALPHA = (".jpg", ".jpeg", *HEIF, *RAW)
_PNG, _COLOR_TYPE, _GRAY_OR_RGB = b"\x89PNG\r\n\x1a\n", 25, (0, 2)


def shown_whole(frames: Sequence[Frame]) -> list[Frame]:
    """The frames, with `ignores_alpha` where their photos are whole ones. Photos that cannot be read do not count."""
    chosen = np.unique(np.linspace(0, len(frames) - 1, MOST_PHOTOS).round().astype(int)) if frames else ()
    borders = []
    for number in chosen:
        alpha = _alpha(frames[number])
        if alpha is None:
            continue
        if alpha.min() >= 0.5:
            return list(frames)
        opaque = alpha > 0.5
        borders.append(np.concatenate([opaque[0], opaque[-1], opaque[:, 0], opaque[:, -1]]).mean())
    whole = bool(borders) and float(np.median(borders)) >= BORDER
    return [replace(frame, ignores_alpha=True) for frame in frames] if whole else list(frames)


def _alpha(frame: Frame) -> np.ndarray | None:
    """Alpha [H,W] of a photo, 1 where the format has none; None where Blender cannot read the photo."""
    if frame.path.suffix.lower() in _WITHOUT_ALPHA:
        return np.ones((1, 1))
    try:
        with open_plain(frame.path, 1 << 62) as file:
            head = file.read(_COLOR_TYPE + 1)
        if head.startswith(_PNG) and head[-1] in _GRAY_OR_RGB:  # the whole photo need not be read
            return np.ones((1, 1))
        return load_pixels(frame.path)[..., 3]
    except OSError:
        return None
