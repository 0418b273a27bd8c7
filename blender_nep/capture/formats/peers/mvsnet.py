"""Reads `cams/*_cam.txt` of MVSNet and of the data set BlendedMVS, with photos in `blended_images/` or `images/`.

A file has the word `extrinsic` and a matrix [4, 4] from the world to the camera, whose axes are OpenCV's, then the word
`intrinsic` and a matrix [3, 3] in pixels of the photo, then depths. `00000012_cam.txt` belongs to the photo `00000012`.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path

import numpy as np

from blender_nep.capture.cameras.lens import Lens
from blender_nep.capture.description import CaptureDescription, check_number
from blender_nep.capture.formats.peers.assembly import AGAIN, Intrinsics, PeerCamera, described, files_with, numbers
from blender_nep.errors import CaptureError
from blender_nep.safety.plain_files import MEGABYTE, read_text

_PLACES = ("blended_images", "images", "image", "")
_ENDING = "_cam"


def recognizes(folder: Path) -> bool:
    """Whether the folder holds such files."""
    return bool(_files(folder))


def _files(folder: Path) -> list[Path]:
    return files_with(folder, ("cams/*_cam.txt",), b"extrinsic", b"intrinsic")


def read(folder: Path) -> CaptureDescription:
    """What the files say; photos are opened only for their size. Raises CaptureError."""
    files = _files(folder)
    check_number(len(files), "cams")
    return described(folder, files, [_camera(path) for path in files], places=_PLACES, name="cams")


def _camera(path: Path) -> PeerCamera:
    try:
        words = read_text(path, MEGABYTE).split()
        pose = numbers(words[words.index("extrinsic") + 1 :][:16], (4, 4), f"{path.name}: extrinsic")
        k = numbers(words[words.index("intrinsic") + 1 :][:9], (3, 3), f"{path.name}: intrinsic")
    except (OSError, ValueError) as error:
        raise CaptureError(f"{path.name} cannot be read ({error})", AGAIN) from error
    rotation = pose[:3, :3].T
    return PeerCamera(path.stem.removesuffix(_ENDING), rotation, -rotation @ pose[:3, 3], partial(_intrinsics, k))


def _intrinsics(k: np.ndarray, width: int, height: int) -> Intrinsics:
    lens = Lens(skew=float(k[0, 1] / k[0, 0])) if k[0, 0] > 0 else Lens()
    return Intrinsics(width, height, float(k[0, 0]), float(k[1, 1]), float(k[0, 2]), float(k[1, 2]), lens)
