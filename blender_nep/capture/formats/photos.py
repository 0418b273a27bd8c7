"""What all formats check about a photo: whether it can be read, and whether its size fits its camera."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from blender_nep.capture.cameras.camera import Camera
from blender_nep.capture.photos.photo_files import SUFFIXES, image_size, quarter_turns
from blender_nep.errors import CaptureError
from blender_nep.messages import Message


def check_readable(image: Path, name: str) -> None:
    """Raises CaptureError if photos with the ending of `image` cannot be read."""
    if image.suffix.lower() not in SUFFIXES:
        allowed = ", ".join(suffix[1:] for suffix in SUFFIXES)
        raise CaptureError(f"{name}: only {allowed} photos can be read", "Convert the photos.")


def fitted(
    camera: Camera, image: Path, name: str, source: str, rescaled: list[str], turned: list[str] | None = None
) -> Camera:
    """The camera with the size of its photo. If that differs from what `source` says, the name is added to `rescaled`.

    Many programs turn photos upright by EXIF's orientation. A camera for a photo that lies in its file, and that EXIF says
    to turn by a quarter, is turned to the stored pixels, and the name is added to `turned`. Raises CaptureError if the
    aspect differs otherwise.
    """
    size = image_size(image)
    if (camera.width, camera.height) == size:
        return camera
    if not _same_aspect(camera, size):
        turns = quarter_turns(image)
        if not turns % 2 or camera.lens.skew or not _same_aspect(camera, (size[1], size[0])):
            raise CaptureError(
                f"{name} is {size[0]} x {size[1]} pixels, but {source} says {camera.width} x {camera.height}",
                "The aspect differs, so the intrinsics cannot be rescaled: correct the size, or the photo.",
            )
        camera = camera.as_stored(turns)
        if turned is not None:
            turned.append(name)
        if (camera.width, camera.height) == size:
            return camera
    rescaled.append(name)
    return camera.scaled(*size)


def _same_aspect(camera: Camera, size: tuple[int, int]) -> bool:
    return abs(size[0] * camera.height / (size[1] * camera.width) - 1) <= 0.01


def rescaled_warnings(rescaled: list[str], turned: Sequence[str] = ()) -> list[Message]:
    """The warnings about photos whose cameras were rescaled or turned; none without such photos."""
    out = [Message("capture.photos_rescaled", {"count": len(rescaled), "names": rescaled})] if rescaled else []
    if turned:
        out.append(Message("capture.cameras_of_upright", {"count": len(turned), "names": list(turned)}))
    return out
