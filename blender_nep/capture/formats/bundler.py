"""Reads the cameras of Bundler, which RealityScan, Metashape, COLMAP and others export, too: `bundle.out`, and `list.txt`.

The file lies in the folder or in `bundle/`. It may have another name that ends in `.out`, if its first line is that of
version 0.3. The list of photos is `list.txt`, or the only file `*list.txt`, `*.lst` or `*.imagelist`. It lies beside the
file or in the folder. `photo_search.py` says where photos lie, `mask_search.py` where masks.

Bundler's manual: P = R X + t, p = -P / P.z, p' = f (1 + k1 |p|^2 + k2 |p|^4) p, in pixels from the middle of the image, x to
the right and y up. So the axes are ours. A photo whose f is 0 was not placed.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from typing import NamedTuple

import numpy as np

from blender_nep.capture.cameras.camera import Camera
from blender_nep.capture.cameras.lens import Lens
from blender_nep.capture.capture import View
from blender_nep.capture.description import CaptureDescription, check_number
from blender_nep.capture.formats.mask_search import with_masks
from blender_nep.capture.formats.photo_search import check_distinct, photos_named, view_name
from blender_nep.capture.formats.photos import check_readable
from blender_nep.capture.formats.poses import camera_to_world, check_intrinsics, rotation_of, without_pose_warnings
from blender_nep.capture.photos.photo_files import image_size
from blender_nep.errors import CaptureError
from blender_nep.safety.plain_files import MEGABYTE, open_plain, read_text

_HEADER = b"# Bundle file v0.3"
_PLACES = ("", "bundle")
_LISTS = ("*list.txt", "*.lst", "*.imagelist")
_MOST_BYTES, _MOST_NAMES = 4096 * MEGABYTE, 64 * MEGABYTE
_LONGEST_LINE = 16 * MEGABYTE
"""Bytes. A line may list all photos that see a point."""
_POINTS = 1000
"""So many points are read to see on which side of the cameras they lie."""


class _Entry(NamedTuple):
    """A camera of the file."""

    focal: float
    k1: float
    k2: float
    rotation: np.ndarray
    """[3, 3] from the world to the camera"""
    translation: np.ndarray


def recognizes(folder: Path) -> bool:
    """Whether the folder holds a file of Bundler."""
    return bool(_bundles(folder))


def _bundles(folder: Path) -> list[Path]:
    for place in _PLACES:
        found = [path for path in sorted((folder / place).glob("*.out")) if _is_bundle(path)]
        if found:
            return [path for path in found if path.name == "bundle.out"] or found
    return []


def _is_bundle(path: Path) -> bool:
    try:
        with open_plain(path, sys.maxsize) as file:
            return file.read(len(_HEADER)) == _HEADER
    except OSError:
        return False


def read(folder: Path) -> CaptureDescription:
    """What the files say; photos are opened only for their size. Raises CaptureError."""
    bundle = _only(_bundles(folder), "Bundler files")
    names_file = _list_file(folder, bundle)
    entries, names = _read_entries(bundle), _read_names(names_file)
    if len(entries) != len(names):
        raise CaptureError(
            f"{bundle.name} has {len(entries)} cameras, but {names_file.name} has {len(names)} photos",
            "Both must come from the same export.",
        )
    placed = [(entry, name) for entry, name in zip(entries, names, strict=True) if entry.focal != 0]
    if not placed:
        raise CaptureError(f"{bundle.name} has no photos with a pose", "Compute the cameras again.")
    photos, missing = photos_named(folder, [name for _, name in placed], names_file.name)
    views = [_view(folder, bundle, entry, name, photos[name]) for entry, name in placed if name in photos]
    check_distinct(views, names_file.name)
    without = [name for entry, name in zip(entries, names, strict=True) if entry.focal == 0]
    views, found = with_masks(folder, views)
    warnings = without_pose_warnings(without) + missing + found
    return CaptureDescription(name=bundle.name, files=(bundle, names_file), views=views, warnings=warnings)


def _only(found: list[Path], what: str) -> Path:
    if len(found) > 1:
        names = ", ".join(path.name for path in found)
        raise CaptureError(f"{found[0].parent} has several {what}: {names}", "Leave only the one that counts.")
    return found[0]


def _list_file(folder: Path, bundle: Path) -> Path:
    for place in dict.fromkeys((bundle.parent, folder)):
        if (place / "list.txt").is_file():
            return place / "list.txt"
        found = sorted(path for pattern in _LISTS for path in place.glob(pattern))
        if found:
            return _only(found, "lists of photos")
    raise CaptureError(f"{bundle.name} has no list of photos", "Put list.txt, with one photo a line, beside it.")


def _read_names(path: Path) -> list[str]:
    """The photos of the list. Bundler itself adds ' 0 FOCAL' to a name if the photo's metadata have a focal length."""
    try:
        lines = [line.strip() for line in read_text(path, _MOST_NAMES, "utf-8-sig").splitlines()]
    except (OSError, ValueError) as error:
        raise CaptureError(f"{path.name} cannot be read ({error})", "It must be text, with one photo a line.") from error
    names = []
    for line in lines:
        words = line.rsplit(maxsplit=2)
        with_focal = len(words) == 3 and words[1] == "0" and words[2].replace(".", "", 1).isdigit()
        names.append(words[0] if with_focal else line)
    return [name for name in names if name and not name.startswith("#")]


def _read_entries(path: Path) -> list[_Entry]:
    try:
        numbers = _numbers(path)
        cameras, points = (int(value) for value in _next(numbers, 2))
        check_number(cameras, path.name)
        entries = []
        for _ in range(cameras):
            values = np.array(_next(numbers, 15))
            focal, k1, k2 = values[:3].tolist()
            entries.append(_Entry(focal, k1, k2, values[3:12].reshape(3, 3), values[12:]))
        behind = _share_behind(numbers, min(points, _POINTS), entries)
    except (OSError, ValueError, IndexError, OverflowError) as error:
        raise CaptureError(f"{path.name} cannot be read ({error})", "Export the cameras again.") from error
    if behind > 0.5:
        # RealityScan exports this too, as "Bundler v0.3" without the addition.
        raise CaptureError(
            f"the points of {path.name} lie behind its cameras: it has other axes than Bundler's",
            "In RealityScan, export 'Bundler v0.3 (negative z)'.",
        )
    return entries


def _numbers(path: Path) -> Iterator[float]:
    with open_plain(path, _MOST_BYTES) as file:
        while line := file.readline(_LONGEST_LINE):
            if len(line) == _LONGEST_LINE:
                raise ValueError("a line is too long")
            if not line.startswith(b"#"):
                yield from map(float, line.split())


def _next(numbers: Iterator[float], count: int) -> list[float]:
    values = list(islice(numbers, count))
    if len(values) < count:
        raise ValueError("it ends too early")
    return values


def _share_behind(numbers: Iterator[float], points: int, entries: list[_Entry]) -> float:
    """In what share of the observations of the first points the point lies behind the camera; 0 without points.

    A point has a position, a color, and the length of the list of (camera, feature, x, y) where it is seen.
    """
    sides = []
    for _ in range(points):
        *point, _, _, _, seen = _next(numbers, 7)
        for n in np.array(_next(numbers, 4 * int(seen))).reshape(-1, 4)[:, 0].astype(int):
            sides.append(bool(entries[n].rotation[2] @ point + entries[n].translation[2] > 0))
    return float(np.mean(sides)) if sides else 0.0


def _view(folder: Path, bundle: Path, entry: _Entry, name: str, image: Path) -> View:
    check_readable(image, name)
    what = f"{bundle.name}: {name}"
    check_intrinsics(what, entry.focal)
    if not np.isfinite([entry.k1, entry.k2]).all():
        raise CaptureError(f"{what}: its distortion is not finite", "Export the cameras again.")
    rotation = rotation_of(entry.rotation, what).T
    matrix = camera_to_world(rotation, -rotation @ entry.translation, what)
    width, height = image_size(image)
    lens = Lens(k1=entry.k1, k2=entry.k2)
    camera = Camera(width, height, entry.focal, entry.focal, width / 2, height / 2, matrix, lens)
    return View(view_name(folder, image), image, None, camera)
