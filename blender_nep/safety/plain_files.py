"""Reads files that somebody else may have made: no pipes and devices, and not more than a limit.

A pipe in the place of a file never ends, and a file of a few kilobytes on the disk can say that it has terabytes.
`backend/plain_files.py` repeats this for Blender's Python. A test compares the two.
"""

from __future__ import annotations

import errno
import json
import os
import stat
import string
from pathlib import Path
from typing import Any, BinaryIO

MEGABYTE = 1 << 20
MOST_JSON = 256 * MEGABYTE
"""Bytes of a JSON file. 20,000 photos take about 12 MB in transforms.json."""


def open_plain(path: Path, most: int) -> BinaryIO:
    """Open a file of at most `most` bytes for reading. Raises OSError, also where it is larger, or no file on a disk."""
    flags = sum(getattr(os, name, 0) for name in ("O_NONBLOCK", "O_BINARY", "O_CLOEXEC"))
    descriptor = os.open(path, os.O_RDONLY | flags)
    try:
        state = os.fstat(descriptor)
        if not stat.S_ISREG(state.st_mode):
            raise OSError(errno.EINVAL, "it is no file on a disk", str(path))
        if state.st_size > most:
            raise _too_large(path, most)
        return os.fdopen(descriptor, "rb")
    except BaseException:
        os.close(descriptor)
        raise


def read_bytes(path: Path, most: int) -> bytes:
    """The content of a file of at most `most` bytes. Raises OSError as `open_plain` does."""
    with open_plain(path, most) as file:
        content = file.read(most + 1)  # some files of the system say that they are empty
    if len(content) > most:
        raise _too_large(path, most)
    return content


def read_text(path: Path, most: int, encoding: str = "utf-8") -> str:
    """The text of a file of at most `most` bytes. Raises OSError as `open_plain` does, and ValueError for other bytes."""
    return read_bytes(path, most).decode(encoding).replace("\r\n", "\n").replace("\r", "\n")


def read_json(path: Path, encoding: str | None = "utf-8", most: int = MOST_JSON) -> Any:
    """What a JSON file holds. Raises OSError as `open_plain` does, and ValueError where it is no JSON.

    `encoding` None: any Unicode, as the file begins. Some editors write a byte order mark, and PowerShell writes UTF-16.
    """
    if encoding is None:
        content = read_bytes(path, most)
        return parse_json(content.decode(json.detect_encoding(content)))
    return parse_json(read_text(path, most, encoding))


def parse_json(text: str | bytes) -> Any:
    """What a JSON text holds. Raises ValueError, also for one that is nested so deeply that Python cannot hold it."""
    try:
        return json.loads(text)
    except RecursionError as error:
        raise ValueError("it is nested too deeply") from error


def is_on_other_computer(name: str, folder: Path) -> bool:
    r"""Whether a path that a file in `folder` names leads to another computer, such as \\server\share\photo.png.

    Windows would tell that computer the user's name, and a hash of the password. The computers of `folder` itself and of
    connected drives know both already.
    """
    wanted = _share(name)
    return bool(wanted) and wanted not in {_share(os.path.abspath(folder)), *_connected()}


def _share(path: str) -> str:
    r"""The beginning \\server\share of a path, in lower case; empty where the path is one of this computer."""
    parts = str(path).replace("/", "\\").lower().split("\\")
    return "\\".join(parts[:4]) if parts[:2] == ["", ""] and len(parts) > 2 else ""


def _connected() -> set[str]:
    """The shares that have a drive's letter."""
    drives = [f"{letter}:\\" for letter in string.ascii_uppercase] if os.name == "nt" else []
    return {_share(os.path.realpath(drive)) for drive in drives if os.path.exists(drive)} - {""}


def _too_large(path: Path, most: int) -> OSError:
    return OSError(errno.EFBIG, f"it has more than {most // MEGABYTE} MB", str(path))
