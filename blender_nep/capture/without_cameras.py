"""What to say of a folder that is no capture: what it holds instead, and what to do next."""

from __future__ import annotations

import shlex
import sys
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path

from blender_nep.capture.description import MINIMUM_VIEWS
from blender_nep.capture.foreign_cameras import foreign_cameras
from blender_nep.capture.formats.photo_search import photos_in
from blender_nep.capture.photos.photo_lookup import PLACES, UNREADABLE_ENDINGS
from blender_nep.errors import CaptureError
from blender_nep.safety.plain_files import open_plain

_VIDEOS = (".mp4", ".mov", ".m4v", ".avi", ".mkv", ".webm", ".mts", ".m2ts", ".3gp", ".insv", ".360", ".wmv")
ARCHIVES = (".zip", ".tar", ".tar.gz", ".tgz", ".7z", ".rar")
_BEGIN_BYTES = 1 << 16
_PARTS = {*PLACES, "masks", "mask", "sparse", "dense", "colmap", "distorted", "undistorted", "keyframes"} - {""}
"""Names of folders in a capture"""
_SHOWN = 3
FORMS = (
    "a COLMAP project, an export of Metashape (.xml), Bundler (.out), RealityScan (.csv), Meshroom (.sfm), OpenSfM, "
    "OpenMVG, VisualSFM, Polycam or Record3D, or a data set such as NeRF's, LLFF's (poses_bounds.npy) or "
    "NeuS's (cameras_sphere.npz)"
)


def no_capture(folder: Path, file: str, recognized: Callable[[Path], bool]) -> CaptureError:
    """The error about a folder without `file` and without cameras of any other form. `recognized`: what a capture is."""
    names = sorted(path.name for path in folder.iterdir())
    place, photos = photos_below(folder)
    state = "is empty" if not names else f"has no {file}"
    if error := _of_what_lies_near(folder, file, photos, recognized):
        return error
    if foreign := foreign_cameras(folder):
        name = foreign.file.relative_to(folder).as_posix()
        again = f" Or find the cameras again: {find_cameras(place)}" if len(photos) >= MINIMUM_VIEWS else ""
        return CaptureError(
            f"{folder} holds cameras of {foreign.program} ({name}) that cannot be read: it {state}",
            f"{foreign.hint}{again}",
            "capture.foreign_cameras",
            folder=folder,
            program=foreign.program,
            file=name,
        )
    if len(photos) >= MINIMUM_VIEWS:
        return CaptureError(
            f"{folder} holds {len(photos)} photos, but no cameras: it {state}",
            f"Find the cameras first: {find_cameras(place)}",
            "capture.no_cameras",
            folder=folder,
            photos=len(photos),
        )
    if videos := videos_in(folder):
        return only_videos(folder, videos, f"no photos and no cameras: it {state}")
    if kinds := unreadable_kinds(folder):
        return unreadable_photos(folder, kinds, state)
    inner = [path.name for path in sorted(folder.iterdir()) if path.is_dir() and _is_or_could_be(path, recognized)]
    if inner:
        more = f" and {len(inner) - _SHOWN} more" if len(inner) > _SHOWN else ""
        return CaptureError(
            f"{folder} is no capture, but a folder with captures or photos ({', '.join(inner[:_SHOWN])}{more}): it {state}",
            f"Name one of these, or make them all: blender-nep batch {shlex.quote(str(folder))} --out SHELF",
        )
    archives = [name for name in names if name.lower().endswith(ARCHIVES)]
    if archives:
        return CaptureError(f"{folder} holds an archive ({archives[0]}), but no capture: it {state}", "Unpack it first.")
    return CaptureError(f"{folder} {state}", f"A capture is a folder with photos and their cameras: {file}, {FORMS}.")


def _of_what_lies_near(
    folder: Path, file: str, photos: Sequence[Path], recognized: Callable[[Path], bool]
) -> CaptureError | None:
    """The error about cameras that are there, but under another name or in another folder; None without such cameras."""
    if (folder / "report.json").is_file() and (folder / "mesh.obj").is_file():
        hint = "Name the folder of its capture. blender-nep materials and blender-nep gallery work with assets."
        return CaptureError(f"{folder} is an asset that was made of a capture, and no capture: it has no {file}", hint)
    for path in sorted(folder.glob("*.[jJ][sS][oO][nN]*")):
        if not path.name.startswith(".") and _names_frames(path):
            return CaptureError(
                f"{folder} has no {file}, but {path.name} has such cameras",
                f"If these are the cameras, rename it to {file}.",
            )
    if around := capture_around(folder, recognized):
        message = f"{folder} is a part of a capture, and no capture: it has no {file}"
        return CaptureError(message, f"Name the whole capture: {around}")
    if len(photos) >= MINIMUM_VIEWS:
        for inner in sorted(path for path in folder.iterdir() if path.is_dir() and not path.name.startswith(".")):
            if recognized(inner) and not photos_below(inner)[1]:
                hint = f"Move the files of the cameras from {inner} into {folder}."
                return CaptureError(f"{folder} has photos, but its cameras are in {inner.name}: it has no {file}", hint)
    return None


def capture_around(folder: Path, recognized: Callable[[Path], bool]) -> Path | None:
    """The capture of which `folder` is the folder of photos, of masks, or of a COLMAP model; None where there is none."""
    inner = folder.absolute()
    while inner.name.isdigit() or inner.name.lower() in _PARTS:
        inner = inner.parent
        if recognized(inner):
            return inner
    return None


def _names_frames(path: Path) -> bool:
    """Whether a file begins as transforms.json does."""
    try:
        with open_plain(path, sys.maxsize) as begin:
            return b'"transform_matrix"' in begin.read(_BEGIN_BYTES)
    except OSError:
        return False


def _unreadable_photos(folder: Path) -> Counter[str]:
    """{kind: number} of the photos in a folder, or in its usual folders of photos, that cannot be read."""
    for name in PLACES:
        try:
            paths = [path for path in (folder / name).iterdir() if not path.name.startswith(".")]
        except OSError:
            continue
        kinds = Counter(path.suffix.lower()[1:] for path in paths if path.suffix.lower() in UNREADABLE_ENDINGS)
        if kinds:
            return kinds
    return Counter()


def unreadable_photos(folder: Path, kinds: Counter[str], more: str) -> CaptureError:
    """The error about a folder with photos of kinds that cannot be read."""
    told = ", ".join(sorted(kinds))
    return CaptureError(
        f"{folder} holds {sum(kinds.values())} photos that cannot be read ({told}): it {more}",
        "Convert them to PNG, TIFF or JPEG of the best quality.",
        "capture.photos_of_other_kinds",
        folder=folder,
        kinds=sorted(kinds),
        photos=sum(kinds.values()),
    )


def unreadable_kinds(folder: Path) -> Counter[str]:
    """{kind: number} of the photos in a folder that cannot be read, if there are at least three; else none."""
    kinds = _unreadable_photos(folder)
    return kinds if sum(kinds.values()) >= MINIMUM_VIEWS else Counter()


def photos_below(folder: Path) -> tuple[Path, list[Path]]:
    """The folder that holds the photos, `folder` itself or a usual folder in it, and the photos; none if there are few."""
    for name in PLACES:
        try:
            photos = photos_in(folder / name)
        except OSError:  # a folder that may not be read
            continue
        if len(photos) >= MINIMUM_VIEWS:
            return (folder if name in ("", "images") else folder / name), photos
    return folder, []


def videos_in(folder: Path) -> list[Path]:
    """The videos in a folder, sorted by their names."""
    try:
        return sorted(path for path in folder.iterdir() if path.suffix.lower() in _VIDEOS and not path.name.startswith("."))
    except OSError:
        return []


def is_video(path: Path) -> bool:
    """Whether a path leads to a file whose name is that of a video."""
    return path.suffix.lower() in _VIDEOS and path.is_file()


def video_hint(videos: Sequence[Path]) -> str:
    """What to do with videos, at least one, instead of photos."""
    which = "it" if len(videos) == 1 else f"one of the {len(videos)} videos"
    return f"Take frames from {which}, and find their cameras: {find_cameras(videos[0])}"


def only_videos(folder: Path, videos: Sequence[Path], lacks: str) -> CaptureError:
    """What is wrong with a folder that holds videos, at least one, instead of photos. lacks: what it does not hold."""
    return CaptureError(
        f"{folder} holds a video ({videos[0].name}), but {lacks}",
        video_hint(videos),
        "capture.video",
        folder=folder,
        video=videos[0].name,
    )


def find_cameras(folder: Path) -> str:
    """The command that finds the cameras of the photos in `folder`, or of a video's frames."""
    return f"blender-nep cameras {shlex.quote(str(folder))}"


def _is_or_could_be(folder: Path, recognized: Callable[[Path], bool]) -> bool:
    """Whether a folder is a capture, or holds photos."""
    try:
        return not folder.name.startswith(".") and (recognized(folder) or bool(photos_below(folder)[1]))
    except OSError:
        return False
