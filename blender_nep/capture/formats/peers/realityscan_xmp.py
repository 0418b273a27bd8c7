"""Reads the `.xmp` files that RealityScan and RealityCapture write beside the photos: *Metadata (XMP)*.

`Rotation` is the matrix from the world to the camera, row after row, and `Position` the camera's place. The camera's axes
are OpenCV's. Focal length, principal point and the order of the distortion's terms (k1 k2 k3 k4 t1 t2) are those of the CSV
file: see `realityscan.py`. Values are attributes or elements.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from blender_nep.capture.cameras.lens import Lens
from blender_nep.capture.description import CaptureDescription, check_number
from blender_nep.capture.formats.peers.assembly import AGAIN, Intrinsics, PeerCamera, described, files_with, number, numbers
from blender_nep.errors import CaptureError
from blender_nep.safety.plain_files import MEGABYTE, open_plain

_SPACE = "{http://www.capturingreality.com/ns/xcr/1.1#}"
_PATTERNS = ("*.xmp", "images/*.xmp")
_MODELS = ("perspective", "brown3", "brown4", "brown3t2", "brown4t2")
_DAMAGED = (OSError, ElementTree.ParseError, LookupError, ValueError, RecursionError)


def recognizes(folder: Path) -> bool:
    """Whether the folder holds such files with poses."""
    return any(files_with(folder, (pattern,), b"xcr:Rotation") for pattern in _PATTERNS)


def read(folder: Path) -> CaptureDescription:
    """What the files say; photos are opened only for their size. Raises CaptureError."""
    files = files_with(folder, _PATTERNS, b"capturingreality.com/ns/xcr")
    check_number(len(files), "XMP")
    cameras, without = [], []
    for path in files:
        said = _values(path)
        if "Rotation" not in said or "Position" not in said:
            without.append(path.stem)
            continue
        rotation = numbers(said["Rotation"].split(), (3, 3), f"{path.name}: Rotation")
        position = numbers(said["Position"].split(), (3,), f"{path.name}: Position")
        cameras.append(PeerCamera(path.stem, rotation.T, position, partial(_intrinsics, said, path.name)))
    return described(folder, files, cameras, without=without, name="the XMP files")


def _values(path: Path) -> dict[str, str]:
    """{name: text} of all that RealityScan says in the file."""
    found: dict[str, str] = {}
    try:
        with open_plain(path, MEGABYTE) as file:
            for element in ElementTree.parse(file).iter():
                said = [*element.attrib.items(), (element.tag, element.text or "")]
                found |= {key.removeprefix(_SPACE): text for key, text in said if key.startswith(_SPACE)}
    except _DAMAGED as error:
        raise CaptureError(f"{path.name} cannot be read ({error})", AGAIN) from error
    return found


def _intrinsics(said: dict[str, str], file: str, width: int, height: int) -> Intrinsics:
    def value(name: str, otherwise: float | None) -> float:
        return number(said.get(name, otherwise), f"{file}: {name}")

    terms = numbers(said.get("DistortionCoeficients", "0 0 0 0 0 0").split(), (6,), f"{file}: DistortionCoeficients")
    model = said.get("DistortionModel", "perspective")
    if model not in _MODELS and np.any(terms):
        raise CaptureError(
            f"{file}: the distortion model {model} is not supported",
            "Choose Brown3 in RealityScan's alignment settings, align again, and export the metadata again.",
        )
    if abs(value("Skew", 0)) > 1e-9 or abs(value("AspectRatio", 1) - 1) > 1e-6:
        raise CaptureError(
            f"{file}: pixels that are not square (Skew, AspectRatio) are not supported",
            "Choose a distortion model without K+ in RealityScan's alignment settings, and align again.",
        )
    side = max(width, height)
    focal = value("FocalLength35mm", None) / 36 * side
    cx, cy = value("PrincipalPointU", 0) * side + width / 2, value("PrincipalPointV", 0) * side + height / 2
    k1, k2, k3, k4, t1, t2 = (0.0,) * 6 if model == "perspective" else terms.tolist()
    return Intrinsics(width, height, focal, focal, cx, cy, Lens(k1, k2, k3, k4, p1=t2, p2=t1))
