"""Packs files and folders into one block of bytes, and unpacks it below another root."""

from __future__ import annotations

import io
import os
import shutil
import tarfile
from collections.abc import Iterable
from pathlib import Path, PurePosixPath

from blender_nep.files import is_link
from blender_nep.job.folders.own_files import ENTRIES


def pack(paths: Iterable[Path], root: Path, run: Path | None = None) -> bytes:
    """The files `paths` of a capture, and what our run has in its folder `run`, with their paths relative to `root`.

    What is not there is left out. In the place of a symbolic link in a capture, what it leads to is packed: the job looks
    for it under the path of the link. Of the run's folder, links and the files of others are left out.
    """
    packed, base = io.BytesIO(), os.path.abspath(root)
    with tarfile.open(fileobj=packed, mode="w", dereference=True) as archive:
        for path in dict.fromkeys(Path(os.path.abspath(one)) for one in paths):
            if path.exists():
                archive.add(path, path.relative_to(base))
        archive.dereference = False
        for own in () if run is None else (Path(os.path.abspath(run)) / name for name in ENTRIES):
            if own.exists():
                archive.add(own, own.relative_to(base), filter=lambda member: None if member.issym() else member)
    return packed.getvalue()


def unpack(packed: bytes, root: Path) -> None:
    """Write what was packed below `root`. Files that are there are replaced, and so are links.

    Only files and folders are unpacked. Raises ValueError for a path that leaves `root`, also through a link. The filters of
    tarfile are newer than the first releases of Python 3.11.
    """
    inside = root.resolve()
    with tarfile.open(fileobj=io.BytesIO(packed)) as archive:
        for member in archive:
            path = PurePosixPath(member.name)
            target = root.joinpath(*path.parts)
            if path.is_absolute() or ".." in path.parts or not target.parent.resolve().is_relative_to(inside):
                raise ValueError(f"{member.name} leads out of the folder")
            if is_link(target):
                target.unlink()
            content = archive.extractfile(member) if member.isreg() else None
            if content is not None:
                target.parent.mkdir(parents=True, exist_ok=True)
                with open(target, "wb") as file:
                    shutil.copyfileobj(content, file)
                os.utime(target, (member.mtime, member.mtime))
            elif member.isdir():
                target.mkdir(parents=True, exist_ok=True)
