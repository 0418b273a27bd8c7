"""Where the photos and masks of other programs' exports lie.

A photo lies in a folder of photos such as `images/`, or in the folder itself, under the path that the file says, or the end
of that path; `photo_lookup.py` says how names may differ. Last, the absolute path counts. `mask_search.py` says where masks
lie.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

from blender_nep.capture.capture import View
from blender_nep.capture.description import MINIMUM_VIEWS
from blender_nep.capture.formats.mask_search import masks_beside
from blender_nep.capture.photos.photo_files import SUFFIXES, refuse_other_computer
from blender_nep.capture.photos.photo_lookup import PLACES, PhotoLookup, stem
from blender_nep.errors import CaptureError
from blender_nep.messages import Message

IMAGES = "images"
IMAGES_FIRST = (IMAGES, *(place for place in PLACES if place != IMAGES))
"""Where photos lie that a file names relative to the folder of photos"""


def photos_in(folder: Path) -> list[Path]:
    """The photos in a folder, sorted by their names; none if there is no such folder.

    Hidden files, masks beside their photos and second files of a photo do not count.
    """
    if not folder.is_dir():
        return []
    names = (path for path in folder.iterdir() if path.suffix.lower() in SUFFIXES and not path.name.startswith("."))
    files = [path for path in names if path.is_file()]
    return sorted(without_second_files(set(files) - masks_beside(files)), key=lambda path: path.name)


def without_second_files(files: Iterable[Path]) -> list[Path]:
    """The files of one folder, each photo once.

    A photo is often there twice: a camera writes a JPEG beside a raw file, and people export TIFF or JPEG files into the
    folder, or copy `IMG_1.JPG` to `IMG_1.jpg`. Of files with one stem, EXR, PNG and JPEG files count, or else the file whose
    ending comes first in `SUFFIXES`.
    """
    files = sorted(files)
    best: dict[str, int] = {}
    for path in files:
        best[path.stem] = min(_rank(path), best.get(path.stem, len(SUFFIXES)))
    chosen = {(path.stem, path.suffix.lower()): path for path in files if _rank(path) == best[path.stem]}
    return list(chosen.values())


def _rank(path: Path) -> int:
    return max(SUFFIXES.index(path.suffix.lower()), SUFFIXES.index(".jpeg"))


def first_with_photos(folder: Path, places: Iterable[str]) -> tuple[str, list[Path]]:
    """The first of the folders below `folder` that has photos, and these; the first folder's name if none has."""
    places = list(places)
    return next(((place, found) for place in places if (found := photos_in(folder / place))), (places[0], []))


def photos_named(
    folder: Path, names: Sequence[str], file: str, places: tuple[str, ...] = IMAGES_FIRST, *, absolute_first: bool = False
) -> tuple[dict[str, Path], list[Message]]:
    """{name: the photo} of the photos that a file calls `names`, and a warning about those that are missing.

    `places` and `absolute_first`: see `PhotoLookup.find`. Raises CaptureError if too few photos are there, or where a
    name leads to another computer.
    """
    lookup = PhotoLookup(folder)
    found, missing = {}, []
    for name in dict.fromkeys(names):
        refuse_other_computer(folder, name)
        photo = lookup.find(name, places, absolute_first=absolute_first)
        if photo is None:
            missing.append(name)
        else:
            found[name] = photo
    for name in _taken_by_others(found):
        del found[name]
        missing.append(name)
    if not missing:
        return found, []
    if len(found) < MINIMUM_VIEWS:
        it = "it" if len(missing) == 1 else "them"
        many = f"{len(missing)} of {len(found) + len(missing)} photos of {file} are missing, the first: {missing[0]}"
        one = f"photo {missing[0]} of {file} is missing"
        raise CaptureError(
            one if len(missing) == 1 else many,
            f"Put {it} into {folder / IMAGES}. At least {MINIMUM_VIEWS} photos are needed.",
            "capture.photos_not_there",
            count=len(missing),
            photos=len(found) + len(missing),
            names=missing,
            folder=folder,
        )
    values = {"count": len(missing), "photos": len(found) + len(missing), "names": missing}
    return found, [Message("capture.photos_missing", values)]


def _taken_by_others(found: dict[str, Path]) -> list[str]:
    """The names that led to the photo of another name, or several of them to the same one: their own photos are missing.

    So is `001.jpg` where only `001.png` is there and the file names both, or `left/001.png` and `right/001.png` where only
    `001.png` is there.
    """
    names: dict[Path, list[str]] = {}
    for name, photo in found.items():
        names.setdefault(photo, []).append(name)
    out = []
    for photo, same in names.items():
        paths = {name: name.replace("\\", "/").removeprefix("./") for name in same}
        own = max((path for path in paths.values() if photo.as_posix().endswith(path)), key=len, default=None)
        if len(same) > 1:
            out += [name for name in same if paths[name] != own and _has_ending(name)]
    return out


def _has_ending(name: str) -> bool:
    return stem(name) != name


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
