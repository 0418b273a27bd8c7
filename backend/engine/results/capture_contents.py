"""Says what a capture folder holds: how many photos, and whether there are cameras that the engine can read. No bpy here.

The answers come from names and beginnings of files. The engine itself decides by blender_nep/cameras/photo_folder.py and
blender_nep/capture/formats/, but Blender's Python cannot import them, and to start the engine takes too long for a
panel. Tests ask both sides about the same folders.
"""

import os
import re
import sys
from itertools import islice
from pathlib import Path, PurePosixPath
from typing import Any
from xml.etree import ElementTree

from ...plain_files import open_plain, read_json

LEAST_PHOTOS = 3
"""The engine finds no cameras of fewer photos."""
PLAIN_ENDINGS = (".exr", ".png", ".jpg", ".jpeg")
OTHER_ENDINGS = (
    *(".tif", ".tiff", ".webp", ".heic", ".heif", ".hif"),
    *(".dng", ".cr2", ".cr3", ".nef", ".arw", ".raf", ".orf", ".rw2"),
)
"""A photo with such an ending does not count beside a photo with the same name and a plain ending."""
VIDEO_ENDINGS = (".mp4", ".mov", ".m4v", ".avi", ".mkv", ".webm", ".mts", ".m2ts", ".3gp", ".insv", ".360", ".wmv")
TRANSFORMS = "transforms.json"
_IMAGES = "images"
_FILES = (TRANSFORMS, "transforms_train.json", "poses_bounds.npy", "cameras_sphere.npz", "cameras.npz")
_MASK_WORDS = r"(?:masks?|alphas?|mattes?|silhouettes?|segmentations?|seg)"
_MASK_BESIDE = re.compile(rf"(.+)[._-]{_MASK_WORDS}", re.IGNORECASE)
"""The stem of a mask beside its photo, as blender_nep/capture/formats/mask_search.py has it"""
_MASK_FOLDER = re.compile(rf"(?:(.+)[ ._-])?{_MASK_WORDS}(?:[ ._-](.+))?", re.IGNORECASE)
_OTHER_PHOTOS = {"test", "val", "validation", "eval"}
"""Folders of masks with such a word are of other photos."""
_MOST_FOLDERS = 200
"""Folders in a folder of masks that are looked into: the panel must not wait."""
_COLMAP_PLACES = (
    *("sparse", "colmap/sparse", "", "dense/sparse", "undistorted/sparse", "distorted/sparse"),
    *("colmap_sparse", "colmap_text"),
)
_COLMAP_MODELS = (
    *("sparse/*", "colmap/sparse/*", "dense/*/sparse", "dense/*/sparse/*", "dense/sparse/*"),
    *("undistorted/sparse/*", "distorted/sparse/*", "colmap_sparse/*"),
)
_BUNDLER_PLACES = ("", "bundle")
_BUNDLER_BEGIN = b"# Bundle file v0.3"
_BEGIN_BYTES = 1 << 16
_METASHAPE_BEGIN = ["document", "chunk"]
"""The first two elements of a Metashape export"""
_PEERS = (
    ("*.csv", "#name,x,y,alt,", ",roll,f"),
    ("*.xmp", "xcr:Rotation"),
    ("images/*.xmp", "xcr:Rotation"),
    ("*.sfm", '"version"'),
    ("reconstruction.json", '"cameras"'),
    ("opensfm/reconstruction.json", '"cameras"'),
    ("*.nvm", "NVM_V3"),
    ("sfm_data*.json", '"sfm_data_version"'),
    ("keyframes/corrected_cameras/*.json", '"t_00"'),
    ("keyframes/cameras/*.json", '"t_00"'),
    ("corrected_cameras/*.json", '"t_00"'),
    ("cameras/*.json", '"t_00"'),
    ("meta_data.json", '"camtoworld"'),
    ("cams/*_cam.txt", "extrinsic"),
    ("*-camera.pkl", ""),
    ("cameras.json", '"img_name"'),
)
"""Where the other programs of blender_nep/capture/formats/peers/ put their cameras, and what these files begin with"""
_RECORD3D = ("metadata.json", '"poses"')
"""The same, beside a folder `rgb`"""


def photo_count(folder: Path) -> int:
    """Number of photos in the folder, or else in its folder `images`; 0 where the folder cannot be read.

    If frames of a video were taken again, those count that transforms.json names.
    """
    return _count(folder) or _count(_frames_folder(folder))


def _frames_folder(folder: Path) -> Path:
    """`images`, or `images2` and so on, as `frames_folder` of blender_nep/cameras/video/kept_frames.py finds it."""
    if not (folder / f"{_IMAGES}2").is_dir():  # transforms.json is read only where that may change the answer
        return folder / _IMAGES
    try:
        frames = read_json(folder / TRANSFORMS)["frames"]
        named = {PurePosixPath(frame["file_path"]).parent.as_posix() for frame in frames}
    except (OSError, ValueError, KeyError, TypeError):
        return folder / _IMAGES
    name = named.pop() if len(named) == 1 else _IMAGES
    return folder / (name if re.fullmatch(rf"{_IMAGES}\d*", name) and (folder / name).is_dir() else _IMAGES)


def video_count(folder: Path) -> int:
    """Number of videos in the folder; 0 where it cannot be read."""
    try:
        return sum(path.suffix.lower() in VIDEO_ENDINGS and path.name[0] != "." for path in folder.iterdir())
    except OSError:
        return 0


def _count(folder: Path) -> int:
    images = _images_in(folder)
    masks = _masks_beside(images)
    names = [os.path.splitext(name) for name in images if name not in masks]
    plain = {(stem, ending.lower()) for stem, ending in names if ending.lower() in PLAIN_ENDINGS}
    others = {stem for stem, ending in names if ending.lower() not in PLAIN_ENDINGS}
    return len(plain) + len(others.difference(stem for stem, _ in plain))


def _images_in(folder: Path) -> list[str]:
    """The names of the images in the folder; none where it cannot be read."""
    found = []
    try:
        with os.scandir(folder) as entries:
            for entry in entries:
                ending = os.path.splitext(entry.name)[1].lower()
                if ending in PLAIN_ENDINGS + OTHER_ENDINGS and not entry.name.startswith(".") and entry.is_file():
                    found.append(entry.name)
    except OSError:
        return []
    return found


def _masks_beside(names: list[str]) -> set[str]:
    """Which of the images of one folder are masks of others of them, as their names say."""
    known = {known for name in names for known in (name.lower(), os.path.splitext(name)[0].lower())}
    added = ((name, _MASK_BESIDE.fullmatch(os.path.splitext(name)[0].lower())) for name in names)
    return {name for name, match in added if match and match[1] in known}


def transforms_time(folder: Path) -> int:
    """When transforms.json was last written, in nanoseconds; 0 where there is none."""
    try:
        return (folder / TRANSFORMS).stat().st_mtime_ns
    except OSError:
        return 0


def has_masks(folder: Path) -> bool:
    """Whether masks lie beside the photos or in a folder of masks. Whether each photo has one, the engine says."""
    try:
        places = [path for path in folder.iterdir() if path.is_dir() and _is_mask_folder(path.name)]
    except OSError:
        return False
    beside = any(_masks_beside(_images_in(place)) for place in (folder, folder / "images"))
    return beside or any(map(_holds_images, places))


def _holds_images(folder: Path) -> bool:
    """Whether there is an image in the folder or in a folder in it."""
    looked = 0
    for root, _, _ in os.walk(folder):
        looked += 1
        if _images_in(Path(root)):
            return True
        if looked >= _MOST_FOLDERS:
            break
    return False


def _is_mask_folder(name: str) -> bool:
    match = _MASK_FOLDER.fullmatch(name)
    return match is not None and not {part.lower() for part in match.groups() if part} & _OTHER_PHOTOS


def has_cameras(folder: Path) -> bool:
    """Whether the folder holds cameras, in any of the forms that the engine reads. A folder that cannot be read has none."""
    forms = (_is_colmap_project, _has_metashape_export, _has_bundle, _has_peer)
    try:
        return any((folder / name).is_file() for name in _FILES) or any(is_form(folder) for is_form in forms)
    except OSError:  # such as no permission, or a name that is too long
        return False


def _is_colmap_project(folder: Path) -> bool:
    places = [folder / place for place in _COLMAP_PLACES]
    places += [place for pattern in _COLMAP_MODELS for place in folder.glob(pattern)]
    return any(
        all((place / f"{name}.{ending}").is_file() for name in ("cameras", "images"))
        for place in places
        for ending in ("bin", "txt")
    )


def _has_metashape_export(folder: Path) -> bool:
    return any(_first_elements(path) == _METASHAPE_BEGIN for path in folder.glob("*.xml"))


def _first_elements(path: Path) -> list[str]:
    try:
        parser: ElementTree.XMLPullParser = ElementTree.XMLPullParser(("start",))
        with open_plain(path, sys.maxsize) as file:
            parser.feed(file.read(_BEGIN_BYTES))
        events: Any = parser.read_events()
        return [element.tag for _, element in islice(events, 2)]
    except (OSError, ElementTree.ParseError, LookupError, ValueError):  # the last two are of unknown encodings
        return []


def _has_bundle(folder: Path) -> bool:
    return any(_begins_as_bundle(path) for place in _BUNDLER_PLACES for path in (folder / place).glob("*.out"))


def _begins_as_bundle(path: Path) -> bool:
    try:
        with open_plain(path, sys.maxsize) as file:
            return file.read(len(_BUNDLER_BEGIN)) == _BUNDLER_BEGIN
    except OSError:
        return False


def _has_peer(folder: Path) -> bool:
    places = (*_PEERS, _RECORD3D) if (folder / "rgb").is_dir() else _PEERS
    return any(_holds(path, marks) for pattern, *marks in places for path in folder.glob(pattern) if path.name[0] != ".")


def _holds(path: Path, marks: list[str]) -> bool:
    try:
        with open_plain(path, sys.maxsize) as file:
            begin = file.read(_BEGIN_BYTES)
            return all(mark.encode() in begin for mark in marks)
    except OSError:
        return False
