"""Reads the CSV file of RealityScan and RealityCapture: *Internal/External camera parameters*.

Its line of names is `#name,x,y,alt,heading,pitch,roll,f,px,py,k1,k2,k3,k4,t1,t2`. Newer versions call four of them `yaw`,
`f_35mm`, `px_norm` and `py_norm`. The coordinates are x to the east, y to the north, z up.

With all angles 0, the camera looks down, and the top of its photo is in the north. The matrix from the camera (x right, y
up, z back) to the world is Rz(-heading) Rx(pitch) Ry(roll). A camera of which RealityCapture wrote both a CSV and an XMP
file agrees with this to 0.0001.

Scripts write other angles into the same columns: headings that count the other way round or from another direction, and a
pitch of the other sign. If most cameras look away from each other by RealityScan's angles, these are tried. Another reading
counts if it is the only one by which nearly all cameras look at a common place, with the tops of their photos up.

The focal length is that for film of 36 mm. RealityScan's own templates for exports make pixels of it and of the principal
point by one factor, the longer side: f / 36 * side, and px * side + width / 2. By the template for OpenCV, t1 is OpenCV's
p2, and t2 is its p1. The file does not say whether k1 is that of the model Division. That differs from ours in higher orders
only.
"""

from __future__ import annotations

import csv
from dataclasses import replace
from functools import partial
from itertools import product
from pathlib import Path

import numpy as np

from blender_nep.capture.cameras.common_place import common_place
from blender_nep.capture.cameras.lens import Lens
from blender_nep.capture.description import MINIMUM_VIEWS, CaptureDescription, check_number
from blender_nep.capture.formats.peers.assembly import AGAIN, Intrinsics, PeerCamera, described, files_with, number, only
from blender_nep.capture.formats.poses import FROM_OPENCV
from blender_nep.errors import CaptureError
from blender_nep.messages import Message
from blender_nep.safety.plain_files import MEGABYTE, read_text

_MARKS = (b"#name,x,y,alt,", b",roll,f")
"""A log of flights, which RealityScan reads, has no focal lengths."""
_MOST_BYTES = 16 * MEGABYTE
_OTHER_NAMES = {"yaw": "heading", "f_35mm": "f", "px_norm": "px", "py_norm": "py"}
_NEEDED = ("name", "x", "y", "alt", "heading", "pitch", "roll", "f")
_OPTIONAL = ("px", "py", "k1", "k2", "k3", "k4", "t1", "t2")
_LEAST_COSINE = 0.5
"""A camera looks away from a place that is farther than 60 degrees from its optical axis."""
_NEARLY_ALL, _NEAR = 0.9, 0.98
"""By another reading, so many cameras must have a common place within 11 degrees of their optical axis."""
_FAR = 1e4
"""Cameras that are so many times as far from the origin as from each other are moved to the origin."""


def recognizes(folder: Path) -> bool:
    """Whether the folder holds such a file."""
    return bool(_exports(folder))


def _exports(folder: Path) -> list[Path]:
    return files_with(folder, ("*.csv",), *_MARKS)


def read(folder: Path) -> CaptureDescription:
    """What the file says; photos are opened only for their size. Raises CaptureError."""
    path = only(_exports(folder), "exports of RealityScan")
    rows = _rows(path)
    check_number(len(rows), path.name)
    positions = np.array([[row["x"], row["y"], row["alt"]] for _, row in rows]).reshape(-1, 3)
    _check_meters(positions, path.name)
    origin = _origin(positions)
    angles = np.array([[row["heading"], row["pitch"], row["roll"]] for _, row in rows]).reshape(-1, 3)
    rotations, said = _read_angles(angles, positions - origin, path.name)
    cameras = [
        PeerCamera(name, rotation, position - origin, partial(_intrinsics, row))
        for (name, row), rotation, position in zip(rows, rotations, positions, strict=True)
    ]
    found = described(folder, [path], cameras)
    return replace(found, warnings=[*found.warnings, *said])


def _rows(path: Path) -> list[tuple[str, dict[str, float]]]:
    """The photo's name and the numbers of each line."""
    try:
        lines = list(csv.reader(read_text(path, _MOST_BYTES, "utf-8-sig").splitlines()))
    except (OSError, ValueError, csv.Error) as error:
        raise CaptureError(f"{path.name} cannot be read ({error})", AGAIN) from error
    first = next((n for n, line in enumerate(lines) if line and line[0].strip() == "#name"), None)
    if first is None:
        raise CaptureError(f"{path.name} has no line of names that begins with #name", AGAIN)
    names = [_OTHER_NAMES.get(name, name) for name in (word.strip().lower().removeprefix("#") for word in lines[first])]
    missing = [name for name in _NEEDED if name not in names]
    if missing:
        raise CaptureError(
            f"{path.name} has no column {', '.join(missing)}",
            "In RealityScan, export Registration > Internal/External camera parameters.",
        )
    rows = []
    for n, line in enumerate(lines[first + 1 :], first + 2):
        if not line or line[0].startswith("#"):
            continue
        if len(line) != len(names):
            raise CaptureError(f"{path.name}, line {n}: {len(line)} values instead of {len(names)}", AGAIN)
        said = dict(zip(names, line, strict=True))
        values = {name: number(said.get(name, 0), f"{path.name}, line {n}: {name}") for name in (*_NEEDED[1:], *_OPTIONAL)}
        rows.append((said["name"].strip(), values))
    return rows


def _rotation(heading: float, pitch: float, roll: float) -> np.ndarray:
    """The matrix [3, 3] from the camera to the world, by OpenCV's axes, for angles in degrees."""
    (ch, cp, cr), (sh, sp, sr) = (f(np.radians([-heading, pitch, roll])) for f in (np.cos, np.sin))
    around_z = np.array([[ch, -sh, 0], [sh, ch, 0], [0, 0, 1]])
    around_x = np.array([[1, 0, 0], [0, cp, -sp], [0, sp, cp]])
    around_y = np.array([[cr, 0, sr], [0, 1, 0], [-sr, 0, cr]])
    return around_z @ around_x @ around_y * FROM_OPENCV


def _read_angles(angles: np.ndarray, position: np.ndarray, file: str) -> tuple[np.ndarray, list[Message]]:
    """The rotations [n, 3, 3] of cameras at `position` [n, 3], and a warning if their angles [n, 3] are not RealityScan's.

    Raises CaptureError if most cameras look away from the place at which they look together, by any reading.
    """
    own = np.array([_rotation(*three) for three in angles]).reshape(-1, 3, 3)
    axes = own[:, :, 2]
    place = common_place(position, axes) if len(own) >= MINIMUM_VIEWS else None
    if place is None:
        return own, []
    away = _cosines(position, axes, place) < _LEAST_COSINE
    if away.mean() <= 0.5:
        return own, []
    others = []
    for turns, start, tilt in product((1, -1), (0, 90, 180, 270), (1, -1)):
        rotations = np.array([_rotation(turns * heading + start, tilt * pitch, roll) for heading, pitch, roll in angles])
        place = common_place(position, rotations[:, :, 2])
        upright = -rotations[:, 2, 1].mean() > 0
        if place is not None and upright:
            near = _cosines(position, rotations[:, :, 2], place) > _NEAR
            others += [rotations] if near.mean() >= _NEARLY_ALL else []
    if len(others) != 1:
        raise CaptureError(
            f"{file}: {away.sum()} of {len(away)} cameras look away from the others: its angles are not RealityScan's",
            "In RealityScan, export the registration as COLMAP or Bundler.",
        )
    return others[0], [Message("capture.realityscan_angles", {"file": file})]


def _cosines(position: np.ndarray, axis: np.ndarray, place: np.ndarray) -> np.ndarray:
    """The cosine [n] of the angle between each optical axis [n, 3] and the direction to `place` [3]."""
    to_place = place - position
    return np.einsum("ni,ni->n", to_place, axis) / np.maximum(np.linalg.norm(to_place, axis=1), 1e-300)


def _check_meters(positions: np.ndarray, file: str) -> None:
    """Raises CaptureError if x and y are degrees: then no camera is beside another, compared with their heights."""
    if len(positions) < MINIMUM_VIEWS or np.abs(positions[:, 0]).max() > 180 or np.abs(positions[:, 1]).max() > 90:
        return
    spread = np.ptp(positions, axis=0)
    if 0 < max(spread[:2]) < 1e-3 * spread[2]:
        raise CaptureError(
            f"{file}: x and y are degrees of longitude and latitude, not meters",
            "In RealityScan, choose Grid plane as the output coordinate system, and export again.",
        )


def _origin(positions: np.ndarray) -> np.ndarray:
    """What is subtracted from the positions [n, 3]: nothing, or a whole place near them if they have map coordinates.

    Millions of meters from the origin, meshes in single precision would be torn.
    """
    if not len(positions):
        return np.zeros(3)
    middle = positions.mean(0)
    spread = np.linalg.norm(positions - middle, axis=1).max()
    return np.round(middle) if np.linalg.norm(middle) > _FAR * max(spread, 1.0) else np.zeros(3)


def _intrinsics(row: dict[str, float], width: int, height: int) -> Intrinsics:
    side = max(width, height)
    focal = row["f"] / 36 * side
    lens = Lens(row["k1"], row["k2"], row["k3"], row["k4"], p1=row["t2"], p2=row["t1"])
    return Intrinsics(width, height, focal, focal, row["px"] * side + width / 2, row["py"] * side + height / 2, lens)
