"""Reads the `.nvm` file of VisualSFM (NVM_V3).

A line of a camera has the photo's name (a space in it is written as a quote), the focal length in pixels, a quaternion w x
y z that turns the world to the camera, the camera's position, one term of distortion, and 0. The camera's axes are OpenCV's.
The principal point is the photo's middle, unless the first line says `FixedK fx cx fy cy r`.

VisualSFM's distortion leads from the photo to the ray: a place u in the photo, in focal lengths from the middle, shows the
direction u (1 + r |u|^2). Our lens leads from the ray to the photo, so its terms are fitted to the inverse.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from pathlib import Path

import numpy as np

from blender_nep.capture.cameras.lens import NO_DISTORTION, Lens
from blender_nep.capture.description import CaptureDescription, check_number
from blender_nep.capture.formats.peers.assembly import (
    AGAIN,
    Intrinsics,
    PeerCamera,
    described,
    files_with,
    only,
    rotation_of_quaternion,
)
from blender_nep.errors import CaptureError
from blender_nep.safety.plain_files import MEGABYTE, open_plain

_MOST_BYTES = 4096 * MEGABYTE
_LONGEST_LINE = 16 * MEGABYTE
"""Bytes. A line may list all photos that see a point."""
_SAMPLES = 200


def recognizes(folder: Path) -> bool:
    """Whether the folder holds such a file."""
    return bool(_models(folder))


def _models(folder: Path) -> list[Path]:
    return files_with(folder, ("*.nvm",), b"NVM_V3")


def read(folder: Path) -> CaptureDescription:
    """What the file says of its largest model; photos are opened only for their size. Raises CaptureError."""
    path = only(_models(folder), "models of VisualSFM")
    try:
        lines = _lines(path)
        fixed = _fixed(next(lines, ""))
        models = _cameras(lines, path.name)
    except (OSError, ValueError, IndexError, OverflowError) as error:
        raise CaptureError(f"{path.name} cannot be read ({error})", AGAIN) from error
    largest = max(models, key=len)
    cameras = [
        PeerCamera(
            name,
            rotation_of_quaternion(values[1:5].tolist(), f"{path.name}: {name}").T,
            values[5:8],
            partial(_intrinsics, values, fixed),
        )
        for name, values in largest
    ]
    placed = {name for name, _ in largest}
    without = [name for model in models for name, _ in model if name not in placed]
    return described(folder, [path], cameras, without=without)


def _lines(path: Path) -> Iterator[str]:
    """The lines of the file that are not empty."""
    with open_plain(path, _MOST_BYTES) as file:
        while line := file.readline(_LONGEST_LINE):
            if len(line) == _LONGEST_LINE:
                raise ValueError("a line is too long")
            if line.strip() and not line.startswith(b"#"):
                yield line.decode("utf-8-sig")


def _fixed(line: str) -> tuple[float, float, float, float] | None:
    """fx, cx, fy and cy in pixels, where the first line says them."""
    words = line.split()
    if "FixedK" not in words:
        return None
    begin = words.index("FixedK") + 1
    fx, cx, fy, cy = (float(word) for word in words[begin : begin + 4])
    if not np.isfinite([fx, cx, fy, cy]).all() or min(fx, fy) <= 0:
        raise ValueError("FixedK must have positive focal lengths")
    return fx, cx, fy, cy


def _cameras(rows: Iterator[str], file: str) -> list[list[tuple[str, np.ndarray]]]:
    """The photo's name and the ten numbers of each camera, for each model. The lines of the points are passed over."""
    models = []
    for row in rows:
        count = int(row)
        if count <= 0:
            break
        check_number(count, file)
        model = []
        for _ in range(count):
            words = next(rows, "").rsplit(maxsplit=10)
            if len(words) != 11:
                raise ValueError("a line of a camera has not 11 parts")
            values = np.array([float(word) for word in words[1:]])
            if not np.isfinite(values).all():
                raise ValueError("a number is not finite")
            model.append((words[0].strip().replace('"', " "), values))
        models.append(model)
        for _ in range(int(next(rows, "0"))):
            next(rows, "")
    if not models:
        raise ValueError("it has no cameras")
    return models


def _intrinsics(values: np.ndarray, fixed: tuple[float, float, float, float] | None, width: int, height: int) -> Intrinsics:
    focal, radial = float(values[0]), float(values[8])
    fl_y, cx, cy = focal, width / 2, height / 2
    if fixed is not None:
        fx, cx, fy, cy = fixed
        fl_y = focal * fy / fx
    if focal <= 0:
        return Intrinsics(width, height, focal, fl_y, cx, cy)
    reach = np.hypot(max(cx, width - cx) / focal, max(cy, height - cy) / fl_y)
    return Intrinsics(width, height, focal, fl_y, cx, cy, _lens(radial, float(reach)))


def _lens(radial: float, reach: float) -> Lens:
    """Our lens for VisualSFM's term, fitted for places up to `reach` focal lengths from the middle."""
    if radial == 0:
        return NO_DISTORTION
    if radial < 0:  # beyond this place, u (1 + r u^2) falls again
        reach = min(reach, 0.95 * float(np.sqrt(-1 / (3 * radial))))
    place = np.linspace(0, reach, _SAMPLES + 1)[1:]
    ray = place * (1 + radial * place**2)
    scale = ray[-1]
    terms = (ray / scale)[:, None] ** np.array([3, 5, 7, 9])
    found = np.linalg.lstsq(terms, (place - ray) / scale, rcond=None)[0]
    return Lens(*(found / scale ** np.array([2, 4, 6, 8])).tolist())
