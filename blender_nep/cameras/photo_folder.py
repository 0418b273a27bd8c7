"""The photos of a folder, what their files say of the lens, and small grey copies of them for structure from motion."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image

from blender_nep.capture.loading import MINIMUM_VIEWS
from blender_nep.capture.photo_files import SUFFIXES, image_size, open_image
from blender_nep.color import linear_to_srgb, to_bytes
from blender_nep.errors import CaptureError

_EXIF, _MAKE, _MODEL, _ORIENTATION = 0x8769, 0x010F, 0x0110, 0x0112
_FOCAL_LENGTH, _FILM_LENGTH, _LENS_MODEL = 0x920A, 0xA405, 0xA434
_FILM_DIAGONAL = 43.2666
"""mm, of film 36 x 24. A focal length "in 35 mm film" is for the same diagonal angle."""
_QUARTER_TURNS = {1: 0, 6: 1, 3: 2, 8: 3}
"""{EXIF orientation: by how many quarter turns clockwise the stored image must be turned to stand upright}"""
_MASKS = "masks"


@dataclass(frozen=True)
class Photo:
    """A photo as its file stores it. EXIF's orientation is not applied: all photos of a camera have the same lens then."""

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

    @property
    def lens(self) -> tuple[object, ...]:
        """Photos with equal keys were taken with the same lens."""
        return (self.width, self.height, *self.camera)


def find_photos(folder: Path) -> list[Photo]:
    """The photos in `folder`, or in its folder `images`, sorted by name. Masks lie in the folder `masks` beside them.

    A file that is no photo is passed over if its ending is none of a photo. Raises CaptureError if the folder is missing, if
    a photo cannot be read, or if there are too few.
    """
    if not folder.is_dir():
        raise CaptureError(f"there is no folder {folder}", "Check the path of the folder with photos.", "capture.no_folder")
    paths = _photo_files(folder) or (_photo_files(folder / "images") if (folder / "images").is_dir() else [])
    if len(paths) < MINIMUM_VIEWS:
        allowed = ", ".join(suffix[1:] for suffix in SUFFIXES)
        raise CaptureError(
            f"{folder} holds {len(paths)} photo{'' if len(paths) == 1 else 's'}: at least {MINIMUM_VIEWS} are needed",
            f"20 and more photos ({allowed}) all around the object work well.",
            "capture.too_few_photos",
            photos=len(paths),
        )
    return [_photo(path, folder) for path in paths]


def _photo_files(folder: Path) -> list[Path]:
    files = (path for path in folder.iterdir() if path.suffix.lower() in SUFFIXES and not path.name.startswith("."))
    return sorted(path for path in files if path.is_file())


def _photo(path: Path, folder: Path) -> Photo:
    width, height = image_size(path)
    masks = (folder / _MASKS / f"{path.name}.png", folder / _MASKS / f"{path.stem}.png")
    mask = next((mask for mask in masks if mask.is_file()), None)
    tags = _exif(path)
    words = tuple(str(tags.get(tag, "")).strip("\0 ") for tag in (_MAKE, _MODEL, _LENS_MODEL, _FOCAL_LENGTH, _FILM_LENGTH))
    turns = _QUARTER_TURNS.get(tags.get(_ORIENTATION, 1), 0)  # type: ignore[call-overload]
    return Photo(path, width, height, _focal_length(tags, width, height), words, turns, mask)


def _exif(path: Path) -> dict[int, object]:
    """What EXIF says, {tag: value}. Raises CaptureError where the photo cannot be read."""
    if path.suffix.lower() == ".exr":
        return {}
    try:
        with Image.open(path) as image:
            exif = image.getexif()
            return {**exif, **exif.get_ifd(_EXIF)}
    except (OSError, ValueError, SyntaxError) as error:
        raise _unreadable(path, error) from error


def _unreadable(path: Path, error: Exception) -> CaptureError:
    return CaptureError(f"{path.name} cannot be read as an image ({error})", "Take it out, or copy it again.")


def _focal_length(tags: dict[int, object], width: int, height: int) -> float | None:
    """The focal length in pixels that EXIF gives for film 36 x 24 mm; None where it is missing or cannot be right."""
    try:
        film = float(tags.get(_FILM_LENGTH, 0))  # type: ignore[arg-type]
    except (TypeError, ValueError, ZeroDivisionError):
        return None
    return film / _FILM_DIAGONAL * float(np.hypot(width, height)) if 5 < film < 1000 else None


def grey_copy(photo: Photo, longest: int) -> np.ndarray:
    """The photo as grey sRGB values [h, w] uint8, scaled down so that no side is longer than `longest`.

    Photos with radiance get an exposure that shows their median at half of white.
    """
    if photo.path.suffix.lower() == ".exr":
        radiance, _ = open_image(photo.path, "linear").rows()
        radiance = np.clip(np.nan_to_num(radiance), 0, None)
        exposed = radiance * (0.2 / max(float(np.median(radiance)), 1e-6))
        image = Image.fromarray(to_bytes(linear_to_srgb(exposed.mean(-1))))
    else:
        image = _opened(photo.path)
    factor = longest / max(image.size)
    if factor < 1:
        image = image.resize((round(image.width * factor), round(image.height * factor)), Image.Resampling.LANCZOS)
    return np.asarray(image)


def _opened(path: Path) -> Image.Image:
    try:
        with Image.open(path) as image:
            if image.mode.startswith("I"):  # 16 bits
                return Image.fromarray((np.asarray(image, np.float32) / 257).clip(0, 255).astype(np.uint8))
            return image.convert("L")
    except (OSError, ValueError, SyntaxError) as error:
        raise _unreadable(path, error) from error


def mask_copy(photo: Photo, size: tuple[int, int]) -> np.ndarray | None:
    """Where the mask shows the object, [h, w] bool, at `size` (width, height); None without a mask."""
    if photo.mask is None:
        return None
    with Image.open(photo.mask) as image:
        grey = image.getchannel("A") if "A" in image.getbands() else image.convert("L")
        return np.asarray(grey.resize(size, Image.Resampling.BOX)) > 127
