"""Reads the raw data of Polycam: a folder `keyframes` with cameras, one JSON file a photo, and images.

`corrected_cameras` and `corrected_images` count, which Polycam has improved, else `cameras` and `images`. The twelve numbers
t_00 to t_23 are the rows of the matrix from the camera to the world. The camera's axes are ours; the world's y is up, as in
ARKit. The capture's z is up: x, y, z here are Polycam's z, x, y.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from blender_nep.capture.description import MINIMUM_VIEWS, CaptureDescription, check_number
from blender_nep.capture.formats.peers.assembly import (
    Z_UP,
    Intrinsics,
    PeerCamera,
    described,
    files_with,
    json_of,
    number,
)
from blender_nep.capture.formats.photo_search import photos_in
from blender_nep.capture.formats.poses import FROM_OPENCV
from blender_nep.errors import CaptureError

_PAIRS = (
    ("keyframes/corrected_cameras", "keyframes/corrected_images"),
    ("keyframes/cameras", "keyframes/images"),
    ("corrected_cameras", "corrected_images"),  # the folder is `keyframes` itself
    ("cameras", "images"),
)


def recognizes(folder: Path) -> bool:
    """Whether the folder holds such data."""
    return bool(_files(folder))


def _files(folder: Path) -> list[Path]:
    return files_with(folder, [f"{cameras}/*.json" for cameras, _ in _PAIRS], b'"t_00"')


def read(folder: Path) -> CaptureDescription:
    """What the files say; photos are opened only for their size. Raises CaptureError."""
    files = _files(folder)
    for cameras, images in _PAIRS:
        chosen = [path for path in files if path.parent == folder / cameras]
        if len(chosen) >= MINIMUM_VIEWS and len(photos_in(folder / images)) >= MINIMUM_VIEWS:
            check_number(len(chosen), cameras)
            return described(folder, chosen, [_camera(path) for path in chosen], places=(images,), name=cameras)
    raise CaptureError(
        f"{folder / 'keyframes'} has no {MINIMUM_VIEWS} cameras with photos",
        "Export Raw Data in Polycam again, and keep its folders keyframes/images and keyframes/cameras.",
    )


def _camera(path: Path) -> PeerCamera:
    said: Any = json_of(path)
    if not isinstance(said, dict):
        raise CaptureError(f"{path.name} does not hold a JSON object", "Export Raw Data in Polycam again.")
    values = [
        number(said.get(f"t_{row}{column}"), f"{path.name}: t_{row}{column}") for row in range(3) for column in range(4)
    ]
    matrix = np.array(values).reshape(3, 4)[Z_UP]
    return PeerCamera(path.stem, matrix[:, :3] * FROM_OPENCV, matrix[:, 3], partial(_intrinsics, said, path.name))


def _intrinsics(said: dict[str, Any], file: str, width: int, height: int) -> Intrinsics:
    def value(key: str, otherwise: float | None = None) -> float:
        return number(said.get(key, otherwise), f"{file}: {key}")

    size = round(value("width", width)), round(value("height", height))
    return Intrinsics(*size, value("fx"), value("fy"), value("cx"), value("cy"))
