"""Finds the captures that are named on the command line, and looks how large they are."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from blender_nep.cameras.photo_folder import find_photos
from blender_nep.capture.formats.photo_search import photos_in
from blender_nep.capture.loading import MINIMUM_VIEWS, describe, recognized
from blender_nep.capture.photos.photo_lookup import PLACES
from blender_nep.capture.without_cameras import find_cameras, is_video, photos_below, video_hint, videos_in
from blender_nep.errors import UsageError
from blender_nep.job.folders.own_files import is_ours
from blender_nep.messages import Message
from blender_nep.safety.plain_files import MEGABYTE, read_text

_MOST_LIST = 16 * MEGABYTE
_PARTS = {"images", "image", "masks", "mask", "train_mask", "train_masks", "test", "test_mask", "test_masks", "gt", "sparse"}
"""Folders that belong to a capture, and are none themselves"""


@dataclass(frozen=True)
class FoundCapture:
    """A folder of which an asset is to be made."""

    path: Path
    """Absolute"""
    photos_alone: bool
    """Whether its cameras must be found first"""


@dataclass(frozen=True)
class Size:
    """How large a capture is."""

    photos: int
    pixels: int
    """Of all photos together, as the files have them"""
    files: tuple[Path, ...] = ()
    """All files that a job reads: photos, masks and the capture's own files"""

    def to_dict(self) -> dict[str, int]:
        """The plain values for batch.json."""
        return {"photos": self.photos, "pixels": self.pixels}


def find_captures(named: Sequence[Path], out: Path) -> list[FoundCapture]:
    """The captures that `named` means, each once, in their order. The folder `out` of the batch is passed over.

    Raises UsageError where a path is neither a folder nor a list, or where nothing is found in it.
    """
    found: dict[Path, FoundCapture] = {}
    for path in named:
        if is_video(path):
            raise UsageError(f"{path} is a video, and no capture", video_hint([path]), "usage.no_captures", path=path)
        if path.is_file():
            here = [one for line in _listed(path) for one in _in_list(line, out)]
        elif path.is_dir():
            here = list(_in_folder(path, out))
        else:
            raise UsageError(f"there is no folder or list {path}", "Check its path.", "usage.no_captures", path=path)
        if not here:
            raise UsageError(
                f"there are no captures in {path}",
                _next_step(path),
                "usage.no_captures",
                path=path,
            )
        for one in here:
            found.setdefault(one.path, one)
    return list(found.values())


def passed_over(named: Sequence[Path], out: Path, found: Sequence[FoundCapture]) -> list[Message]:
    """What is passed over in the folders `named`, as messages: folders that hold neither a capture nor photos.

    So are captures in a folder that counts itself, because it holds photos. Assets and the folders that belong to a capture
    are no surprise, and not told.
    """
    used = {one.path: one for one in found}
    over, deeper, beside = [], [], []
    for folder in named:
        itself = used.get(folder.resolve())
        if not folder.is_dir() or not os.access(folder, os.R_OK | os.X_OK) or (itself and not itself.photos_alone):
            continue
        for inner in sorted(folder.iterdir()):
            if not _may_hold_capture(inner, out) or inner.resolve() in used or is_ours(inner):
                continue
            if itself:
                if inner.name not in PLACES and (recognized(inner) or _photo_count(inner) >= MINIMUM_VIEWS):
                    beside.append(inner)
                continue
            over.append(inner)
            with contextlib.suppress(OSError):
                place, photos = photos_below(inner)
                deeper += [place] if photos else []
    said = []
    if over:
        said.append(Message("batch.passed_over", {"count": len(over), "names": [inner.name for inner in over]}))
    if beside:
        said.append(Message("batch.captures_beside_photos", {"count": len(beside), "names": [str(one) for one in beside]}))
    if deeper:
        values = {"count": len(deeper), "names": [str(place) for place in deeper], "command": find_cameras(deeper[0])}
        said.append(Message("batch.photos_deeper", values))
    return said


def _may_hold_capture(inner: Path, out: Path) -> bool:
    wanted = inner.is_dir() and not inner.name.startswith(".") and inner.name not in _PARTS
    return wanted and inner.resolve() != out.resolve()


def _listed(path: Path) -> Iterator[Path]:
    """The folders in a text file: one a line, relative to the file. `#` begins a comment."""
    try:
        text = read_text(path, _MOST_LIST, "utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        hint = "A list is a text file (UTF-8) with one folder a line."
        raise UsageError(f"{path} is no list of folders", hint, "usage.no_list", path=path) from error
    for line in text.splitlines():
        name = line.partition("#")[0].strip()
        if name:
            yield path.parent / name


def _next_step(path: Path) -> str:
    """What to do where a folder or a list holds no captures."""
    if path.is_dir() and os.access(path, os.R_OK | os.X_OK):
        place, photos = photos_below(path)
        inner = [photos_below(folder)[0] for folder in sorted(path.iterdir()) if _may_hold_capture(folder, path)]
        others = [folder for folder in inner if photos_below(folder)[1]]
        if photos or others:
            return f"There are photos in {place if photos else others[0]}: {find_cameras(place if photos else others[0])}"
        if videos := videos_in(path):
            return video_hint(videos)
    return "Name capture folders, a folder that holds captures, or a text file with one folder a line."


def _in_list(path: Path, out: Path) -> list[FoundCapture]:
    """The captures that a line of a list means. A folder without any becomes an object that fails and says why."""
    found = list(_in_folder(path, out)) if path.is_dir() else []
    return found or [FoundCapture(path.resolve(), False)]


def _in_folder(folder: Path, out: Path) -> Iterator[FoundCapture]:
    """The folder itself, if it is a capture or holds enough photos. Else those of its folders that are or hold any."""
    if recognized(folder):
        yield FoundCapture(folder.resolve(), False)
    elif _photo_count(folder) >= MINIMUM_VIEWS:
        yield FoundCapture(folder.resolve(), True)
    elif os.access(folder, os.R_OK | os.X_OK):
        for inner in sorted(folder.iterdir()):
            if not _may_hold_capture(inner, out):
                continue
            if recognized(inner):
                yield FoundCapture(inner.resolve(), False)
            elif _photo_count(inner) and not is_ours(inner):  # an asset's pictures are no photos
                yield FoundCapture(inner.resolve(), True)


def _photo_count(folder: Path) -> int:
    """The larger one of the numbers of photos in a folder and in its folder `images`; 0 if they may not be read."""
    try:
        return max(len(photos_in(place)) for place in (folder, folder / "images"))
    except PermissionError:
        return 0


def size_of(capture: FoundCapture) -> Size:
    """Look how many photos a capture has, and how large they are. Only the beginning of each photo is read.

    Raises CaptureError and BoundsError where a job would raise them for the same reason.
    """
    if capture.photos_alone:
        photos = find_photos(capture.path)
        masks = tuple(photo.mask for photo in photos if photo.mask is not None)
        files = (*(photo.path for photo in photos), *masks)
        return Size(len(photos), sum(photo.width * photo.height for photo in photos), files)
    said = describe(capture.path)
    files = (*said.files, *(v.image_path for v in said.views), *(v.mask_path for v in said.views if v.mask_path))
    return Size(len(said.views), sum(v.camera.width * v.camera.height for v in said.views), files)
