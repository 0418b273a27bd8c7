"""Where the photos and masks of other programs' exports lie.

A photo lies in `images/` or in the folder itself, under the path that the file says, or the end of that path. Last, the
absolute path counts. `mask_search.py` says where masks lie.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path, PureWindowsPath

from blender_nep.capture.capture import View
from blender_nep.capture.formats.mask_search import masks_beside
from blender_nep.capture.photos.photo_files import SUFFIXES, find_image
from blender_nep.errors import CaptureError

IMAGES = "images"


def photos_in(folder: Path) -> list[Path]:
    """The photos in a folder, sorted by their names; none if there is no such folder.

    Hidden files and masks beside their photos do not count.
    """
    if not folder.is_dir():
        return []
    names = (path for path in folder.iterdir() if path.suffix.lower() in SUFFIXES and not path.name.startswith("."))
    files = [path for path in names if path.is_file()]
    return sorted(set(files) - masks_beside(files), key=lambda path: path.name)


def first_with_photos(folder: Path, places: Iterable[str]) -> tuple[str, list[Path]]:
    """The first of the folders below `folder` that has photos, and these; the first folder's name if none has."""
    places = list(places)
    return next(((place, found) for place in places if (found := photos_in(folder / place))), (places[0], []))


def found_photo(folder: Path, name: str, file: str) -> Path:
    """The photo that a file calls `name`. Raises CaptureError if it is not there."""
    written = PureWindowsPath(name)  # it understands both kinds of slashes: the file may come from another machine
    parts = written.parts[1:] if written.anchor else written.parts
    for first in range(len(parts)):
        for place in (folder / IMAGES, folder):
            found = find_image(place, "/".join(parts[first:]))
            if found:
                return found
    path = Path(name)
    # A job names photos relative to the capture's folder, which another drive does not allow.
    if path.is_absolute() and path.drive == folder.absolute().drive:
        found = find_image(path.parent, path.name)
        if found:
            return found
    raise CaptureError(f"photo {name} of {file} is missing", f"Put it into {folder / IMAGES}.")


def view_name(folder: Path, image: Path) -> str:
    """The name of a photo for people: its place in the folder of photos, without the ending."""
    return _place(folder, image).with_suffix("").as_posix()


def _place(folder: Path, image: Path) -> Path:
    """The photo's path relative to `images/` or to the folder; else its name."""
    for place in (folder / IMAGES, folder):
        if image.is_relative_to(place):
            return image.relative_to(place)
    return Path(image.name)


def check_distinct(views: list[View], file: str) -> None:
    """Raises CaptureError if two cameras have the same photo."""
    seen: set[Path] = set()
    for view in views:
        if view.image_path in seen:
            raise CaptureError(
                f"{file} has several cameras for {view.image_path.name}",
                "Give all photos different names before the cameras are computed.",
            )
        seen.add(view.image_path)
