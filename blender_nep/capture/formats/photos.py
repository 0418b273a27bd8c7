"""What all formats check about a photo: whether it can be read, and whether its size fits its camera."""

from __future__ import annotations

from pathlib import Path

from blender_nep.capture.cameras.camera import Camera
from blender_nep.capture.photos.photo_files import SUFFIXES, image_size
from blender_nep.errors import CaptureError
from blender_nep.messages import Message


def check_readable(image: Path, name: str) -> None:
    """Raises CaptureError if photos with the ending of `image` cannot be read."""
    if image.suffix.lower() not in SUFFIXES:
        allowed = ", ".join(suffix[1:] for suffix in SUFFIXES)
        raise CaptureError(f"{name}: only {allowed} photos can be read", "Convert the photos.")


def fitted(camera: Camera, image: Path, name: str, source: str, rescaled: list[str]) -> Camera:
    """The camera with the size of its photo. If that differs from what `source` says, the name is added to `rescaled`.

    Raises CaptureError if the aspect differs, too.
    """
    size = image_size(image)
    if (camera.width, camera.height) == size:
        return camera
    if abs(size[0] * camera.height / (size[1] * camera.width) - 1) > 0.01:
        raise CaptureError(
            f"{name} is {size[0]} x {size[1]} pixels, but {source} says {camera.width} x {camera.height}",
            "The aspect differs, so the intrinsics cannot be rescaled: correct the size, or the photo.",
        )
    rescaled.append(name)
    return camera.scaled(*size)


def rescaled_warnings(rescaled: list[str]) -> list[Message]:
    """The warning about photos whose cameras were rescaled; none without such photos."""
    return [Message("capture.photos_rescaled", {"count": len(rescaled), "names": rescaled})] if rescaled else []
