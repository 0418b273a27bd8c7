"""Reads arrays of numpy's files. Their type and shape are checked before the numbers are read. No pickle is read."""

from __future__ import annotations

import io
import math
import re
import tokenize
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.lib import format as npy

from blender_nep.safety.plain_files import MEGABYTE, open_plain

DAMAGED = (
    *(OSError, ValueError, TypeError, EOFError, AttributeError, KeyError, NotImplementedError, RuntimeError),
    *(SyntaxError, OverflowError, RecursionError, MemoryError, tokenize.TokenError, zipfile.BadZipFile, zlib.error),
)
"""What numpy and zipfile raise for files that are damaged or too large"""
_MOST_BYTES = 128 * MEGABYTE
"""Of a file"""
_HEADER = 4096
"""Bytes before the numbers, at most. numpy itself writes 128."""

Fits = Callable[[tuple[int, ...]], bool]
"""Whether an array of this shape is wanted"""


def read_npy(path: Path, fits: Fits) -> np.ndarray:
    """The array of a .npy file as float64. Raises one of `DAMAGED`, ValueError where its shape does not fit."""
    with open_plain(path, _MOST_BYTES) as file:
        return _read(file, fits)


def read_npz(path: Path, names: re.Pattern[str], fits: Fits) -> dict[str, np.ndarray]:
    """The arrays of a .npz file whose names match, as float64. Raises one of `DAMAGED`, ValueError for another shape."""
    found = {}
    with open_plain(path, _MOST_BYTES) as file, zipfile.ZipFile(file) as archive:
        for member in archive.infolist():
            name = member.filename.removesuffix(".npy")
            if not names.fullmatch(name):
                continue
            if member.compress_type not in (
                zipfile.ZIP_STORED,
                zipfile.ZIP_DEFLATED,
            ):  # others have no limit while inflating
                raise ValueError(f"{name} has a compression that numpy does not write")
            with archive.open(member) as packed:
                found[name] = _read(packed, fits)  # type: ignore[arg-type]  # zipfile's files are no BinaryIO
    return found


def _read(file: BinaryIO, fits: Fits) -> np.ndarray:
    """The array that begins at the place of `file`."""
    start = io.BytesIO(file.read(_HEADER))
    version = npy.read_magic(start)
    readers = {(1, 0): npy.read_array_header_1_0, (2, 0): npy.read_array_header_2_0}
    if version not in readers:
        raise ValueError(f"its version of numpy's format is {version}")
    shape, by_columns, kind = readers[version](start)
    if kind.kind not in "fiu":
        raise ValueError(f"it holds {kind} instead of numbers")
    if not fits(shape):
        raise ValueError(f"it holds {' x '.join(map(str, shape)) or 'one'} numbers")
    size = math.prod(shape) * kind.itemsize
    content = start.read(size)
    content += file.read(size - len(content))
    if len(content) < size:
        raise ValueError("it ends too early")
    values = np.frombuffer(content, kind, math.prod(shape)).reshape(shape, order="F" if by_columns else "C")
    return np.asarray(values, np.float64)
