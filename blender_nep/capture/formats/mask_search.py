"""Finds masks that no file of a capture names.

A mask lies in a folder with `mask` in its name (`masks/`, `mask/`, `train_mask/`, `images_masks/`), or beside its photo. In
a folder of masks it has the photo's path and name with another ending, with an ending added, or with `mask` added:
`IMG_1.png`, `IMG_1.jpg.png`, `IMG_1_mask.jpg`, `IMG_1.jpg.mask.png`. Beside the photo it has the photo's name with `mask`
added: `IMG_1_mask.png`, `IMG_1.mask.png`, `IMG_1.jpg.mask.png`. A single image such as `mask.png`, in a folder of masks or
in the capture's folder, is the mask of all photos. Other words for masks are known, too (`_WORDS`).
"""

from __future__ import annotations

import os
import re
import unicodedata
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from blender_nep.capture.capture import View
from blender_nep.capture.photos.mask_files import same_aspect
from blender_nep.capture.photos.photo_files import SUFFIXES, image_size
from blender_nep.errors import CaptureError
from blender_nep.messages import Message

MASKS = "masks"
_ENDINGS = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".webp", ".exr")
"""Endings of masks, in the order in which they count"""
_WORDS = r"(?:masks?|alphas?|mattes?|silhouettes?|segmentations?|seg)"
_ADDED = re.compile(rf"(.+)[._-]{_WORDS}", re.IGNORECASE)
"""The stem of a mask beside its photo. The group is the photo's name, with or without its ending."""
_FOLDER = re.compile(rf"(?:(.+)[ ._-])?{_WORDS}(?:[ ._-](.+))?", re.IGNORECASE)
_FORMS = (
    *("{name}{ending}", "{stem}{ending}", "{stem}_mask{ending}", "{stem}-mask{ending}", "{stem}.mask{ending}"),
    *("{name}.mask{ending}", "{name}_mask{ending}", "mask_{stem}{ending}"),
    *(f"{{stem}}_{word}{{ending}}" for word in ("alpha", "matte", "silhouette", "segmentation", "seg")),
)
"""Names of a mask in a folder of masks, in the order in which they count"""
_DOCUMENTED = ("{name}.png", "{stem}.png", "{stem}_mask.png")
"""Names in `masks/` that every format but transforms.json is known to have. They are no news."""
_FOR_ALL = re.compile(
    r"(all|camera|common|global|rig)?[ ._-]?masks?|(masks?[ ._-])?(all|camera|common|global|rig)", re.IGNORECASE
)
"""The stem of a mask that is meant for all photos"""
_OTHER_PHOTOS = {"test", "val", "validation", "eval"}
"""Folders of masks with such a word are of other photos."""
_OTHER_KINDS = (".gif", ".bmp", ".npy", ".npz", ".jp2", ".avif", ".svg", ".json", ".mat", ".pt", ".tga", ".pgm", ".pbm")
"""Endings of masks that cannot be read"""
_ASSET = ("report.json", "checkpoints/run.json")
"""The marks of a folder that this program has written (blender_nep/job/folders/own_files.py)"""


def masks_beside(files: Iterable[Path]) -> set[Path]:
    """Which of the images of one folder are masks of others of them, as their names say."""
    files = list(files)
    stems, names = {_plain(path.stem) for path in files}, {_plain(path.name) for path in files}
    added = ((path, _ADDED.fullmatch(_plain(path.stem))) for path in files)
    return {path for path, match in added if match and match[1] in stems | names}


@dataclass(frozen=True)
class FoundMasks:
    """The masks of a capture's photos that were found by their names."""

    masks: list[Path | None]
    """Of each photo"""
    unmatched: bool
    """There is a folder of masks with images, and none of these is of a photo."""
    unreadable: tuple[Path, ...] = ()
    """The files in a folder of masks without images, if they may be masks of a kind that cannot be read"""

    def messages(self, folder: Path, photos: Sequence[Path], known: Sequence[bool]) -> list[Message]:
        """What was found, where that is news.

        known: for which photos the capture's own files name a mask, or say that there may be one.
        """
        if self.unmatched:
            return [Message("capture.masks_unmatched", {"example": f"{photos[0].stem}.png"})]
        if self.unreadable:
            kinds = sorted({path.suffix.lower()[1:] for path in self.unreadable})
            values = {"place": _top_below(folder, self.unreadable[0].parent), "kinds": kinds}
            return [Message("capture.masks_other_kind", values)]
        found = [(mask, photo) for mask, photo, old in zip(self.masks, photos, known, strict=True) if mask and not old]
        if not found:
            return []
        beside = sum(mask.parent == photo.parent for mask, photo in found)
        if beside:
            return [Message("capture.masks_beside", {"count": len(found), "photos": len(photos)})]
        place = _top_below(folder, found[0][0].parent)
        return [Message("capture.masks_found", {"count": len(found), "photos": len(photos), "place": place})]


def _top_below(folder: Path, path: Path) -> str:
    """The folder of masks that holds `path`, as it is written relative to `folder` where it lies there."""
    while not _FOLDER.fullmatch(path.name) and path.parent not in (folder, path):
        path = path.parent
    return path.relative_to(folder).as_posix() if path.is_relative_to(folder) and path != folder else str(path)


def find_masks(folder: Path, photos: Sequence[Path]) -> FoundMasks:
    """Look for the masks of `photos`, the photos of the capture in `folder`."""
    places = _mask_folders(folder, photos)
    indices = [(place, files) for place in places if (files := _images_in(place))]
    names = Counter(_plain(path.stem) for path in photos)
    alone = {path: names[_plain(path.stem)] == 1 for path in photos}
    best: list[Path | None] = [None] * len(photos)
    for _, files in indices:
        ways = [_ways(folder, path, alone[path]) for path in photos]
        masks = [_named(files, names) for names in ways]
        if not any(masks):  # in folders of their own, under names that are there once
            single = Counter(name.rpartition("/")[2] for name in files)
            flat = {last: path for name, path in files.items() if single[last := name.rpartition("/")[2]] == 1}
            masks = [_named(flat, names) if alone[path] else None for path, names in zip(photos, ways, strict=True)]
        if sum(map(bool, masks)) > sum(map(bool, best)):
            best = masks
    if not any(best):
        best = _beside(photos)
    images = [path for _, files in indices for path in files.values()]
    if not any(best) and (lone := _for_all(folder, images, photos)):
        best = [lone] * len(photos)
    unreadable = () if images or any(best) else _unreadable(places)
    return FoundMasks(best, bool(images) and not any(best), unreadable)


def _unreadable(places: Iterable[Path]) -> tuple[Path, ...]:
    """The files in the first of the folders of masks that holds some which may be masks, but cannot be read."""
    for place in places:
        try:
            found = sorted(path for path in place.iterdir() if path.suffix.lower() in _OTHER_KINDS and path.is_file())
        except OSError:
            continue
        if found:
            return tuple(found)
    return ()


def _mask_folders(folder: Path, photos: Sequence[Path]) -> list[Path]:
    """Folders of masks near the photos, the likeliest first."""
    parents = list(dict.fromkeys(path.parent for path in photos))
    roots = [folder]
    for parent in parents:
        roots += [parent, parent.parent] if parent != folder and parent.parent != folder else [parent]
        roots += [one for one in parent.parents if one.is_relative_to(folder) and one != folder]
    own = {parent.name.lower() for parent in parents}
    words = own | {"image", "images"}
    found: dict[Path, tuple] = {}
    for root in dict.fromkeys(roots):
        for path in _folders_in(root):
            match = _FOLDER.fullmatch(path.name)
            holds_photos = any(parent.is_relative_to(path) for parent in parents)
            if match is None or path in found or folder.is_relative_to(path) or holds_photos or _is_asset(path):
                continue
            said = {part.lower() for part in match.groups() if part}
            if (said | own) & _OTHER_PHOTOS and not said & own:
                continue  # masks of the same names, but of other photos
            found[path] = (bool(said), not said & words, path.name.lower() != MASKS, path.name)
    return sorted(found, key=found.__getitem__)


def _folders_in(root: Path) -> list[Path]:
    try:
        return sorted(path for path in root.iterdir() if path.is_dir() and not path.name.startswith("."))
    except OSError:
        return []


def _is_asset(folder: Path) -> bool:
    try:
        return any((folder / mark).is_file() for mark in _ASSET)
    except OSError:  # a folder that may not be read
        return False


def _images_in(place: Path) -> dict[str, Path]:
    """{path relative to `place`, as `_plain` has it: path} of the images in a folder of masks and in its folders."""
    found = {}
    for root, _, names in os.walk(place):
        for name in sorted(names):
            if not name.startswith(".") and name.lower().endswith(SUFFIXES):
                path = Path(root) / name
                if not path.is_file():
                    continue
                found[_plain(path.relative_to(place).as_posix())] = path
    return found


def _ways(folder: Path, photo: Path, alone: bool) -> list[str]:
    """Paths under which a folder of masks may have the mask of `photo`, without regard to capitals.

    alone: no other photo has its name, so that the name alone is enough.
    """
    roots = (folder / "images", folder, photo.parent.parent)
    paths = [photo.relative_to(root).parent for root in roots if photo.is_relative_to(root)] + [Path()] * alone
    names = [form.format(name=photo.name, stem=photo.stem, ending=e) for form in _FORMS for e in _ENDINGS]
    return [_plain((parent / name).as_posix()) for parent in dict.fromkeys(paths) for name in names]


def _plain(name: str) -> str:
    """The name in small letters, and with one form of Unicode: macOS writes an umlaut as two characters."""
    return unicodedata.normalize("NFC", name).lower()


def _named(files: dict[str, Path], ways: list[str]) -> Path | None:
    return next((files[way] for way in ways if way in files), None)


def _beside(photos: Sequence[Path]) -> list[Path | None]:
    """The mask beside each photo; None where there is none."""
    found: dict[tuple[Path, str], Path] = {}
    known = set(photos)
    for parent in dict.fromkeys(path.parent for path in photos):
        try:
            files = [path for path in parent.iterdir() if path.suffix.lower() in SUFFIXES and path.is_file()]
        except OSError:
            continue
        masks = [path for path in masks_beside(files) if path.suffix.lower() in _ENDINGS and path not in known]
        for path in sorted(masks, key=lambda path: (_ENDINGS.index(path.suffix.lower()), path.name)):
            if match := _ADDED.fullmatch(_plain(path.stem)):
                found.setdefault((parent, match[1]), path)
    return [found.get((path.parent, _plain(path.name))) or found.get((path.parent, _plain(path.stem))) for path in photos]


def _for_all(folder: Path, images: list[Path], photos: Sequence[Path]) -> Path | None:
    """The image that is meant as the mask of all photos: the only one in a folder of masks, or one beside the photos.

    None where there is none, or where it has not the size of all photos.
    """
    candidates = images if len(images) == 1 else []
    if not images:
        places = dict.fromkeys((folder, *(path.parent for path in photos)))
        candidates = [place / f"mask{ending}" for place in places for ending in _ENDINGS]
    found = (path for path in candidates if _FOR_ALL.fullmatch(path.stem) and path.is_file() and path not in photos)
    return next((path for path in found if _same_size(path, photos)), None)


def _same_size(mask: Path, photos: Sequence[Path]) -> bool:
    try:
        size = image_size(mask)
        return all(image_size(photo) == size for photo in photos)
    except CaptureError:
        return False


def with_masks(folder: Path, views: list[View], *, named_by_file: bool = False) -> tuple[list[View], list[Message]]:
    """The views, with the masks that were found for those that have none, and what is to be said about it.

    named_by_file: the format has a place for masks in its file, so that every mask that is found is news.
    """
    photos = [view.image_path for view in views]
    found = find_masks(folder, photos)
    if any(view.mask_path for view in views):
        found = replace(found, unmatched=False)
    masks = [view.mask_path or mask for view, mask in zip(views, found.masks, strict=True)]
    sizes = [None if mask is None else _other_size(mask, view) for view, mask in zip(views, masks, strict=True)]
    scaled = [view.name for view, size in zip(views, sizes, strict=True) if size and _is_alike(size, view)]
    other = [
        not view.mask_path and size is not None and not _is_alike(size, view)
        for view, size in zip(views, sizes, strict=True)
    ]
    known = [
        bool(view.mask_path) or (not named_by_file and _is_documented(folder, view.image_path, mask))
        for view, mask in zip(views, masks, strict=True)
    ]
    masks = [None if wrong else mask for mask, wrong in zip(masks, other, strict=True)]
    messages = replace(found, masks=masks).messages(folder, photos, known)
    names = [view.name for view, wrong in zip(views, other, strict=True) if wrong]
    if names:
        messages.append(Message("capture.masks_other_size", {"count": len(names), "names": names}))
    if scaled:
        messages.append(Message("capture.masks_rescaled", {"count": len(scaled), "names": scaled}))
    return [replace(view, mask_path=mask) for view, mask in zip(views, masks, strict=True)], messages


def photo_mask_messages(folder: Path, photos: Sequence[Path]) -> list[Message]:
    """What is to be said about the masks that were found for photos without cameras."""
    found = find_masks(folder, photos)
    known = [_is_documented(folder, photo, mask) for photo, mask in zip(photos, found.masks, strict=True)]
    return found.messages(folder, photos, known)


def _other_size(mask: Path, view: View) -> tuple[int, int] | None:
    """(width, height) of the mask, if that is not its photo's. One that cannot be read is not judged: its reader says so."""
    try:
        size = image_size(mask)
    except CaptureError:
        return None
    return None if size == (view.camera.width, view.camera.height) else size


def _is_alike(size: tuple[int, int], view: View) -> bool:
    return same_aspect(size, (view.camera.width, view.camera.height))


def _is_documented(folder: Path, photo: Path, mask: Path | None) -> bool:
    """Whether the mask lies in `masks/` under one of the names that documentation gives."""
    names = [form.format(name=photo.name, stem=photo.stem) for form in _DOCUMENTED]
    return mask is not None and mask.name in names and mask.is_relative_to(folder / MASKS)
