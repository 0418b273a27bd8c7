"""Reads the data sets of NeRO (Glossy Synthetic): photos `0.png`, `1.png` and so on, each with `0-camera.pkl`.

A file has a pair of arrays: the matrix [3, 4] from the world to the camera, whose axes are OpenCV's, and K [3, 3] in pixels.
A pickle may name any function of Python and have it called. Here nothing that a file names is looked up: the few names by
which NumPy pickles an array lead to classes of this file, which only keep what they are given, and all others are refused.
"""

from __future__ import annotations

import io
import math
import pickle
import struct
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from blender_nep.capture.cameras.lens import Lens
from blender_nep.capture.description import CaptureDescription, check_number
from blender_nep.capture.formats.peers.assembly import Intrinsics, PeerCamera, described, numbers
from blender_nep.errors import CaptureError
from blender_nep.safety.plain_files import read_bytes

_ENDING = "-camera.pkl"
_MOST_BYTES = 1 << 16
_DAMAGED = (
    *(OSError, pickle.UnpicklingError, struct.error, ValueError, TypeError, LookupError, AttributeError, EOFError),
    *(ArithmeticError, MemoryError, RecursionError),
)


class _Kept:
    """What stands for an array or its type: the arguments and the state that a pickle gives it."""

    def __init__(self, *arguments: object) -> None:
        self.arguments = arguments
        self.state: Any = ()

    def __setstate__(self, state: object) -> None:
        self.state = state


def _encoded(text: str, encoding: str = "latin1") -> bytes:
    """The bytes that protocol 2 writes as text."""
    if encoding != "latin1":
        raise pickle.UnpicklingError(f"it encodes text as {encoding}")
    return text.encode("latin1")


_NAMES: dict[tuple[str, str], Any] = {
    ("numpy", "ndarray"): _Kept,
    ("numpy", "dtype"): _Kept,
    ("numpy.core.multiarray", "_reconstruct"): _Kept,
    ("numpy._core.multiarray", "_reconstruct"): _Kept,
    ("numpy.core.numeric", "_frombuffer"): _Kept,
    ("numpy._core.numeric", "_frombuffer"): _Kept,
    ("_codecs", "encode"): _encoded,
}


class _Reader(pickle._Unpickler):  # type: ignore[name-defined,misc]
    """Python's own reader in Python. The one in C takes as much memory as a file asks for."""

    def find_class(self, module: str, name: str) -> Any:
        if (module, name) not in _NAMES:
            raise pickle.UnpicklingError(f"it names {module}.{name}, which no array needs")
        return _NAMES[module, name]


def recognizes(folder: Path) -> bool:
    """Whether the folder holds such files."""
    return bool(_files(folder))


def _files(folder: Path) -> list[Path]:
    return sorted(path for path in folder.glob(f"*{_ENDING}") if not path.name.startswith("."))


def read(folder: Path) -> CaptureDescription:
    """What the files say; photos are opened only for their size. Raises CaptureError."""
    files = _files(folder)
    check_number(len(files), f"*{_ENDING}")
    return described(folder, files, [_camera(path) for path in files], name=f"*{_ENDING}")


def _camera(path: Path) -> PeerCamera:
    try:
        pair = _Reader(io.BytesIO(read_bytes(path, _MOST_BYTES))).load()
        pose, k = (_array(kept) for kept in pair)
    except _DAMAGED as error:
        raise CaptureError(
            f"{path.name} cannot be read ({str(error) or type(error).__name__})",
            "It must hold the arrays pose and K, as in NeRO.",
        ) from error
    pose, k = numbers(pose, (3, 4), f"{path.name}: pose"), numbers(k, (3, 3), f"{path.name}: K")
    rotation = pose[:, :3].T
    return PeerCamera(path.name.removesuffix(_ENDING), rotation, -rotation @ pose[:, 3], partial(_intrinsics, k))


def _array(kept: object) -> np.ndarray:
    """The array of numbers that was kept. Raises ValueError and TypeError for anything else."""
    if not isinstance(kept, _Kept):
        raise ValueError("it holds no array")
    if kept.state:
        _, shape, kind, is_fortran, content = kept.state
    else:  # as protocol 5 has it
        content, kind, shape, order = kept.arguments
        is_fortran = order == "F"
    name, bytes_order = kind.arguments[0], kind.state[1]
    if name not in ("f4", "f8", "i4", "i8") or bytes_order not in ("<", ">") or not isinstance(content, bytes | bytearray):
        raise ValueError("its array is not of numbers")
    if math.prod(shape) > 16:
        raise ValueError("its array is too large")
    return np.frombuffer(content, np.dtype(bytes_order + name)).reshape(shape, order="F" if is_fortran else "C")


def _intrinsics(k: np.ndarray, width: int, height: int) -> Intrinsics:
    lens = Lens(skew=float(k[0, 1] / k[0, 0])) if k[0, 0] > 0 else Lens()
    return Intrinsics(width, height, float(k[0, 0]), float(k[1, 1]), float(k[0, 2]), float(k[1, 2]), lens)
