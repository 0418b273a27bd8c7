"""Packs files and folders into one block of bytes, and unpacks it below another root."""

from __future__ import annotations

import io
import os
import tarfile
from collections.abc import Iterable
from pathlib import Path


def pack(paths: Iterable[Path], root: Path) -> bytes:
    """The files and folders `paths`, with their paths relative to `root`. What is not there is left out.

    In the place of a symbolic link, what it leads to is packed: the job looks for it under the path of the link.
    """
    packed = io.BytesIO()
    with tarfile.open(fileobj=packed, mode="w", dereference=True) as archive:
        for path in dict.fromkeys(Path(os.path.abspath(one)) for one in paths):
            if path.exists():
                archive.add(path, path.relative_to(os.path.abspath(root)))
    return packed.getvalue()


def unpack(packed: bytes, root: Path) -> None:
    """Write what was packed below `root`. Files that are there are replaced. Paths that leave `root` are refused."""
    with tarfile.open(fileobj=io.BytesIO(packed)) as archive:
        archive.extractall(root, filter="data")
