"""Reads photos as linear radiance with Rec.709 primaries: OpenEXR, PNG, JPEG, WebP, TIFF, HEIC and camera raw.

OpenEXR, raw files and TIFF files with floats are linear. All others are encoded as their tags say (an ICC profile, EXIF, or
a format's own tags), sRGB without tags, and linear whatever they say if the capture says linear.

A photo's pixels are used as they are stored. EXIF's orientation is never applied, neither here nor by structure from motion:
a capture's cameras fit the stored pixels, and all photos of a camera have the same lens then. The pixels of HEIF are those
that its decoder gives (heif_files.py). `exif` gives the orientation of the pixels that `open_image` gives.

A file's content says which format it has, because files with another format's ending are common; only OpenEXR and raw files
go by their ending. Blender's Python lacks the packages of this file and cannot import it: backend/scene_io/image_size.py is
its copy of `image_size` for the formats that Blender shows.
"""

from __future__ import annotations

import sys
from datetime import datetime
from pathlib import Path

from PIL import ExifTags

from blender_nep.capture.photos import photo_lookup
from blender_nep.capture.photos.formats import exr_files, heif_files, pillow_files, raw_files, tiff_files
from blender_nep.capture.photos.formats.raster import Raster
from blender_nep.capture.photos.photo_lookup import PhotoLookup
from blender_nep.errors import CaptureError
from blender_nep.safety.pictures import DAMAGED
from blender_nep.safety.plain_files import is_on_other_computer, open_plain

SUFFIXES = photo_lookup.ENDINGS

_LFS = b"version https://git-lfs"
"""The beginning of a file whose content Git LFS has not fetched"""
QUARTER_TURNS = {1: 0, 2: 0, 6: 1, 5: 1, 3: 2, 4: 2, 8: 3, 7: 3}
"""{EXIF orientation: by how many quarter turns clockwise the stored image must be turned to stand upright}

The second of two equal ones says that the image is mirrored too, which does not change where its top is.
"""


def find_image(folder: Path, name: str) -> Path | None:
    """The path of the image `name` in `folder`, or None if there is no such file. See `PhotoLookup.at`.

    Raises CaptureError where the name leads to another computer.
    """
    refuse_other_computer(folder, name)
    return PhotoLookup(folder).at(name)


def refuse_other_computer(folder: Path, name: str) -> None:
    """Raises CaptureError where the name of a photo, which a file in `folder` says, leads to another computer."""
    if is_on_other_computer(name, folder):
        hint = "Copy the photos and masks into the capture's folder, or connect that computer as a drive."
        raise CaptureError(f"{name} lies on another computer", hint)


def file_kind(path: Path) -> str:
    """'exr', 'raw', 'tiff', 'heif', or 'pillow' for all that Pillow reads. Raises OSError where the file cannot be read."""
    suffix = path.suffix.lower()
    with open_plain(path, sys.maxsize) as file:
        start = file.read(12)
    if suffix in raw_files.SUFFIXES:
        return "raw"
    if suffix == ".exr":
        return "exr"
    if tiff_files.recognizes(start):
        return "tiff"
    return "heif" if heif_files.recognizes(start) else "pillow"


def image_size(path: Path) -> tuple[int, int]:
    """(width, height) in pixels, from the file's header. Raises CaptureError."""
    sizes = {"exr": exr_files.size, "raw": raw_files.size, "tiff": tiff_files.size, "heif": heif_files.size}
    try:
        size = sizes.get(file_kind(path), pillow_files.size)(path)
    except DAMAGED as error:
        raise _unreadable(path, error) from error
    if min(size) < 1:
        raise _unreadable(path, ValueError("it has no pixels"))
    return size


def is_linear(path: Path) -> bool:
    """Whether the format alone says that the values are linear: OpenEXR, raw, and TIFF with floats and without a profile.

    Raises CaptureError.
    """
    try:
        kind = file_kind(path)
        return kind in ("exr", "raw") or (kind == "tiff" and tiff_files.is_linear(path))
    except DAMAGED as error:
        raise _unreadable(path, error) from error


def open_image(path: Path, color_space: str) -> Raster:
    """Open an image file; its values stay as stored. Raises CaptureError if it cannot be read as an image."""
    tagged = color_space != "linear"
    reads = {"tiff": tiff_files.read, "heif": heif_files.read}
    try:
        kind = file_kind(path)
        if kind == "exr":
            raster = exr_files.read(path)
        elif kind == "raw":
            raster = raw_files.read(path)
        else:
            raster = reads.get(kind, pillow_files.read)(path, tagged)
    except DAMAGED as error:
        raise _unreadable(path, error) from error
    if not raster.stored.size:
        raise _unreadable(path, ValueError("it has no pixels"))
    return raster


def exif(path: Path) -> dict[int, object]:
    """What EXIF says of the pixels that `open_image` gives, {tag: value}; empty without EXIF.

    Raises CaptureError where the photo cannot be read.
    """
    tags = {"exr": lambda _: {}, "raw": raw_files.tags, "tiff": tiff_files.tags, "heif": heif_files.tags}
    try:
        return tags.get(file_kind(path), pillow_files.tags)(path)
    except DAMAGED as error:
        raise _unreadable(path, error) from error


def quarter_turns(path: Path) -> int:
    """By how many quarter turns clockwise EXIF says to turn the stored pixels; 0 without EXIF, or if it is damaged."""
    try:
        return QUARTER_TURNS.get(exif(path).get(ExifTags.Base.Orientation, 1), 0)  # type: ignore[call-overload]
    except CaptureError:
        return 0


def time_taken(path: Path) -> datetime | None:
    """When a photo was taken, as EXIF says; None where it does not. Raises CaptureError where the photo cannot be read."""
    tags = exif(path)
    said = tags.get(ExifTags.Base.DateTimeOriginal) or tags.get(ExifTags.Base.DateTime)
    try:
        return datetime.strptime(str(said).strip("\0 "), "%Y:%m:%d %H:%M:%S")
    except ValueError:
        return None


def _unreadable(path: Path, error: Exception) -> CaptureError:
    reason, hint = str(error), "Replace the file, or take it out."
    try:
        with open_plain(path, sys.maxsize) as file:
            start = file.read(len(_LFS))
    except OSError:
        start = None
    if start == b"":
        reason, hint = "it is empty", "Copy it again, or take it out."
    elif start == _LFS:
        reason, hint = "it is only a pointer of Git LFS", "Fetch the photos: git lfs pull"
    return CaptureError(f"{path.name} cannot be read as an image ({reason})", hint)
