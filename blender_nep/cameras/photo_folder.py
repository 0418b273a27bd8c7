"""The photos of a folder, what their files say of the lens, and small gray copies of them for structure from motion."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from PIL import Image

from blender_nep.cameras.reduction import Reduction
from blender_nep.cameras.video.kept_frames import frames_folder
from blender_nep.capture.capture import Capture
from blender_nep.capture.description import check_number
from blender_nep.capture.formats.mask_search import find_masks, masks_beside
from blender_nep.capture.formats.photo_search import without_second_files
from blender_nep.capture.loading import MINIMUM_VIEWS
from blender_nep.capture.photos.mask_files import MaskRaster, MaskReading, same_aspect
from blender_nep.capture.photos.photo_files import (
    QUARTER_TURNS,
    SUFFIXES,
    Raster,
    exif,
    file_kind,
    image_size,
    open_image,
)
from blender_nep.capture.without_cameras import (
    find_cameras,
    only_videos,
    photos_below,
    unreadable_kinds,
    unreadable_photos,
    videos_in,
)
from blender_nep.color import linear_to_srgb, to_bytes
from blender_nep.errors import CaptureError
from blender_nep.safety.pictures import DAMAGED, open_picture

_MAKE, _MODEL, _ORIENTATION = 0x010F, 0x0110, 0x0112
_FOCAL_LENGTH, _FILM_LENGTH, _LENS_MODEL = 0x920A, 0xA405, 0xA434
_FILM_DIAGONAL = 43.2666
"""mm, of film 36 x 24. A focal length "in 35 mm film" is for the same diagonal angle."""
_STRIP = 64
"""Rows of a photo that are made gray at a time"""
_EXPOSURE_ROWS = 500
"""About so many rows of a photo decide its exposure."""
_LIT = 0.01
"""A pixel counts as lit if it has this part of the radiance that a tenth of the pixels exceed."""


@dataclass(frozen=True)
class Photo:
    """A photo as its file stores it. EXIF's orientation is not applied: all photos of a camera have the same lens then.

    HEIC is the exception: its decoder turns the pixels, so that upright and lying photos of a phone have a lens each.
    """

    path: Path
    width: int
    height: int
    focal_length: float | None
    """In pixels, as EXIF says; None: EXIF does not say it"""
    camera: tuple[str, ...]
    """What EXIF says of the camera and its lens. Photos with the same words and the same size share one lens."""
    quarter_turns: int = 0
    """By how many quarter turns clockwise the stored image must be turned to stand upright"""
    mask: Path | None = None
    has_exif: bool = False
    """Whether the file has any EXIF"""
    mask_reading: MaskReading = field(default_factory=MaskReading)

    @property
    def lens(self) -> tuple[object, ...]:
        """Photos with equal keys were taken with the same lens."""
        return (self.width, self.height, *self.camera)


def find_photos(folder: Path, masked: bool = False) -> list[Photo]:
    """The photos in `folder`, or in its folder `images`, sorted by name, with their masks (capture/formats/mask_search.py).

    If frames of a video were taken again, those count that transforms.json names (`frames_folder`).

    A file that is no photo is passed over if its ending is none of a photo. Raises CaptureError if the folder is missing, if
    a photo cannot be read, or if there are too few photos. A mask that cannot be read, or has another aspect than its photo,
    is left out; where masks are wanted (`masked`), it raises CaptureError, too.
    """
    if not folder.is_dir():
        raise CaptureError(f"there is no folder {folder}", "Check the path of the folder with photos.", "capture.no_folder")
    try:
        paths = _photo_files(folder)
        inner = frames_folder(folder)
        if len(paths) < MINIMUM_VIEWS and inner.is_dir():  # a picture may lie beside the folder of photos
            paths = _photo_files(inner) or paths
    except OSError as error:
        reason = error.strerror or str(error)
        message = f"{folder} cannot be read ({reason})"
        raise CaptureError(
            message, "Change its permissions.", "capture.folder_unreadable", folder=folder, reason=reason
        ) from error
    place, inside = photos_below(folder)
    if len(paths) < MINIMUM_VIEWS <= len(inside):
        raise CaptureError(
            f"{folder} holds {len(paths)} photo{'' if len(paths) == 1 else 's'}, but {place} holds {len(inside)}",
            f"Name that folder: {find_cameras(place)}",
            "capture.photos_elsewhere",
            folder=place,
            photos=len(inside),
        )
    if len(paths) < MINIMUM_VIEWS and (videos := videos_in(folder)):
        raise only_videos(folder, videos, "no photos or too few")
    if len(paths) < MINIMUM_VIEWS and (kinds := unreadable_kinds(folder)):
        raise unreadable_photos(folder, kinds, f"has {len(paths) or 'no'} others")
    if len(paths) < MINIMUM_VIEWS:
        allowed = ", ".join(suffix[1:] for suffix in SUFFIXES)
        raise CaptureError(
            f"{folder} holds {len(paths)} photo{'' if len(paths) == 1 else 's'}: at least {MINIMUM_VIEWS} are needed",
            f"20 and more photos ({allowed}) all around the object work well.",
            "capture.too_few_photos",
            photos=len(paths),
        )
    check_number(len(paths), str(folder))
    masks = find_masks(folder, paths).masks
    return [_photo(path, mask, masked) for path, mask in zip(paths, masks, strict=True)]


def photos_of(capture: Capture) -> list[Photo]:
    """The photos of a capture. Raises CaptureError where a photo cannot be read."""
    found = []
    for view in capture.views:
        width, height = _size(view.image_path)
        found.append(Photo(view.image_path, width, height, None, (), mask=view.mask_path))
    return found


def _photo_files(folder: Path) -> list[Path]:
    """The photos in a folder, sorted by name. Masks beside their photos and second files of a photo do not count."""
    named = (path for path in folder.iterdir() if path.suffix.lower() in SUFFIXES and not path.name.startswith("."))
    present = {path for path in named if path.is_file()}
    return sorted(without_second_files(present - masks_beside(present)))


def _photo(path: Path, mask: Path | None, masked: bool) -> Photo:
    width, height = _size(path)
    if mask is not None and not masked and not _fits(mask, (width, height)):
        mask = None
    if mask is not None and not same_aspect(size := _size(mask), (width, height)):
        raise CaptureError(
            f"the mask {mask.name} is {size[0]} x {size[1]} pixels, but {path.name} is {width} x {height}",
            "A mask needs the aspect of its photo, as the file stores it: EXIF's orientation is not applied.",
            "capture.mask_size",
            mask=mask.name,
            photo=path.name,
            mask_size=f"{size[0]} x {size[1]}",
            photo_size=f"{width} x {height}",
        )
    try:
        tags = exif(path)
    except CaptureError:  # damaged EXIF; whether the pixels are sound is seen when they are read
        tags = {}
    words = tuple(str(tags.get(tag, "")).strip("\0 ") for tag in (_MAKE, _MODEL, _LENS_MODEL, _FOCAL_LENGTH, _FILM_LENGTH))
    turns = QUARTER_TURNS.get(tags.get(_ORIENTATION, 1), 0)  # type: ignore[call-overload]
    return Photo(path, width, height, _focal_length(tags, width, height), words, turns, mask, has_exif=bool(tags))


def _fits(mask: Path, size: tuple[int, int]) -> bool:
    try:
        return same_aspect(image_size(mask), size)
    except CaptureError:
        return False


def _size(path: Path) -> tuple[int, int]:
    try:
        return image_size(path)
    except CaptureError as error:
        raise _unreadable(path, error) from error


def _unreadable(path: Path, error: Exception) -> CaptureError:
    known = isinstance(error, CaptureError)
    return CaptureError(
        str(error) if known else f"{path.name} cannot be read as an image ({error})",
        "Take it out, or copy it again.",
        "capture.photo_unreadable",
        photo=path.name,
    )


def _focal_length(tags: dict[int, object], width: int, height: int) -> float | None:
    """The focal length in pixels that EXIF gives for film 36 x 24 mm; None where it is missing or cannot be right."""
    try:
        film = float(tags.get(_FILM_LENGTH, 0))  # type: ignore[arg-type]
    except (TypeError, ValueError, ZeroDivisionError):
        return None
    return film / _FILM_DIAGONAL * float(np.hypot(width, height)) if 5 < film < 1000 else None


def gray_copy(photo: Photo, reduction: Reduction) -> np.ndarray:
    """The photo's copy as gray sRGB values [h, w] uint8.

    Photos with radiance get an exposure that shows the median of what is lit at half of white. Raises CaptureError.
    """
    try:
        image = _opened(photo.path) if file_kind(photo.path) == "pillow" else Image.fromarray(_gray(photo.path))
    except (*DAMAGED, CaptureError) as error:
        raise _unreadable(photo.path, error) from error
    return np.asarray(reduction.copy(image, Image.Resampling.LANCZOS))


def _gray(path: Path) -> np.ndarray:
    """The photo as gray sRGB values [H, W] uint8."""
    raster = open_image(path, "srgb")
    has_radiance = raster.is_float or not raster.encoding.curves
    factor = _exposure(raster) if has_radiance else 1.0
    strips = (_linear_gray(raster, start, start + _STRIP) for start in range(0, raster.size[0], _STRIP))
    return np.concatenate([to_bytes(linear_to_srgb(factor * strip)) for strip in strips])


def _exposure(raster: Raster) -> float:
    """The factor that brings the median of what is lit to 0.2. A dark background does not count. Some rows are enough."""
    height = raster.size[0]
    some = np.concatenate([_linear_gray(raster, y, y + 1) for y in range(0, height, max(1, height // _EXPOSURE_ROWS))])
    lit = some[some > _LIT * np.quantile(some, 0.9)]
    return 0.2 / max(float(np.median(lit)) if lit.size else 0.0, 1e-6)


def _linear_gray(raster: Raster, start: int, end: int) -> np.ndarray:
    """Mean of red, green and blue [h, W], linear, at least 0, in the rows start to end - 1."""
    return np.clip(np.nan_to_num(raster.rows(start, end)[0]), 0, None).mean(-1)


def _opened(path: Path) -> Image.Image:
    with open_picture(path) as image:
        if image.mode.startswith("I"):  # 16 bits
            return Image.fromarray((np.asarray(image, np.float32) / 257).clip(0, 255).astype(np.uint8))
        return image.convert("L")


def mask_copy(photo: Photo, reduction: Reduction) -> np.ndarray | None:
    """Where the mask shows the object in the photo's copy, [h, w] bool; None without a mask. Raises CaptureError."""
    if photo.mask is None:
        return None
    try:
        mask = MaskRaster.of(photo.mask, photo.mask_reading).fitted(photo.height, photo.width)
        starts = range(0, mask.size[0], _STRIP)
        gray = np.concatenate([to_bytes(mask.rows(start, start + _STRIP)) for start in starts])
    except (CaptureError, *DAMAGED) as error:
        raise _unreadable(photo.mask, error) from error
    return np.asarray(reduction.copy(Image.fromarray(gray), Image.Resampling.BOX)) > 127
