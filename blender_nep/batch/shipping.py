"""Packs files and folders into one block of bytes, and unpacks it below another root."""

from __future__ import annotations

import io
import tarfile
from collections.abc import Iterable
from pathlib import Path


def pack(paths: Iterable[Path], root: Path) -> bytes:
    """The files and folders `paths`, with their paths relative to `root`. What is not there is left out."""
    packed = io.BytesIO()
    with tarfile.open(fileobj=packed, mode="w") as archive:
        for path in dict.fromkeys(one.resolve() for one in paths):
            if path.exists():
                archive.add(path, path.relative_to(root))
    return packed.getvalue()


def unpack(packed: bytes, root: Path) -> None:
    """Write what was packed below `root`. Files that are there are replaced. Paths that leave `root` are refused."""
    with tarfile.open(fileobj=io.BytesIO(packed)) as archive:
        archive.extractall(root, filter="data")
