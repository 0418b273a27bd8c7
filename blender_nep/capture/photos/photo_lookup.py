"""Finds the photo or mask that a file of cameras names: another program, another system or another folder may have named it.

This file is there twice, with the same text: as blender_nep/capture/photos/photo_lookup.py and as backend/photo_lookup.py,
because Blender's Python cannot import the library. tests/capture/test_photo_lookup.py compares them.

A name may have slashes of both kinds, a drive, or an absolute path of another computer. The ending may be missing, or be
that of the photo before it was converted. Upper and lower case may differ, and so may the form of Unicode: macOS writes an
umlaut as two characters, other systems write it as one. The name may be that of an address, with %20 for a space.
"""

import os
import unicodedata
from collections.abc import Iterator
from pathlib import Path, PurePosixPath, PureWindowsPath
from urllib.parse import unquote

ENDINGS = (
    *(".exr", ".png", ".jpg", ".jpeg", ".tif", ".tiff", ".webp", ".heic", ".heif", ".hif"),
    *(".dng", ".cr2", ".cr3", ".nef", ".arw", ".raf", ".orf", ".rw2"),
)
"""Endings of photos that can be read. Where a name leaves its ending out, the first one that is there counts."""
UNREADABLE_ENDINGS = (
    *(".avif", ".bmp", ".gif", ".jfif", ".jp2", ".jpe", ".jxl", ".pgm", ".ppm", ".tga", ".hdr"),
    *(".3fr", ".crw", ".dcr", ".erf", ".iiq", ".kdc", ".mrw", ".nrw", ".pef", ".sr2", ".srw", ".x3f"),
)
"""Endings of photos that cannot be read: a photo may have been converted since"""
PLACES = ("", "images", "input", "image", "rgb", "photos", "images_2", "images_4", "images_8")
"""Folders of photos in the folder of a capture, in the order in which they are asked"""


class PhotoLookup:
    """Finds the files of one folder. It reads each folder once, so a new one is needed when files have changed."""

    def __init__(self, folder: Path) -> None:
        """`folder`: the folder of the capture."""
        self.folder = folder
        self._known: dict[Path, dict[str, list[str]]] = {}

    def find(self, name: str, places: tuple[str, ...] = PLACES, *, absolute_first: bool = True) -> Path | None:
        """The file that `name` means, or None.

        The path that the name says is looked for in each of the folders `places`, then the end of that path, which is made
        shorter and shorter. `absolute_first`: an absolute path that is there counts before all others; else it counts last.
        """
        absolute = Path(name) if Path(name).is_absolute() else None
        if absolute_first and absolute is not None and (found := self._in(absolute.parent, (absolute.name,))):
            return found
        parts = _parts(name)
        for first in range(len(parts)):
            if parts[first] == ".." and first:  # without the folders before it, ".." means nothing
                continue
            for place in places:
                found = self._in(self.folder, (*PurePosixPath(place).parts, *parts[first:]))
                if found:
                    return found
        if name != name.strip():
            return self.find(name.strip(), places, absolute_first=absolute_first)
        if "%" in name and (plain := unquote(name)) != name:  # the name of an address, with %20 for a space
            return self.find(plain, places, absolute_first=absolute_first)
        # A job names photos relative to the capture's folder, which another drive does not allow.
        if absolute is not None and not absolute_first and absolute.drive == self.folder.absolute().drive:
            return self._in(absolute.parent, (absolute.name,))
        return None

    def at(self, name: str) -> Path | None:
        """The file at the path `name`, relative to the folder or absolute, or None. Nothing is looked for elsewhere."""
        if Path(name).is_absolute():
            return self._in(Path(name).parent, (Path(name).name,))
        return self._in(self.folder, _parts(name))

    def _in(self, folder: Path, parts: tuple[str, ...]) -> Path | None:
        """The file with the path `parts` below `folder`: as it is written, else in the way that is most similar.

        A file that cannot be read as a photo counts last: there may be a converted one beside it.
        """
        if not parts:
            return None
        as_written = folder.joinpath(*parts)
        exists = _is_file(as_written)
        if exists and _is_readable(as_written.name):
            return as_written
        folders = [folder]
        for inner in parts[:-1]:
            folders = [alike for outer in folders for alike in self._alike(outer, inner)]
        for name in _names(parts[-1]):
            for path in (path for outer in folders for path in self._alike(outer, name)):
                if _is_readable(path.name) and _is_file(path):
                    return path
        return as_written if exists else None

    def _alike(self, folder: Path, name: str) -> Iterator[Path]:
        """What is in `folder` under that name, first with the same letters, then with letters of the other case."""
        if name in ("", ".", ".."):
            yield folder / name
            return
        others = self._entries(folder).get(_plain(name), ())
        for other in sorted(others, key=lambda other: other != name):
            yield folder / other

    def _entries(self, folder: Path) -> dict[str, list[str]]:
        """{plain name: names in the folder}; empty where there is no such folder, or where it may not be read."""
        if folder not in self._known:
            found: dict[str, list[str]] = {}
            try:
                for name in sorted(os.listdir(folder)):
                    found.setdefault(_plain(name), []).append(name)
            except (OSError, ValueError):
                pass
            self._known[folder] = found
        return self._known[folder]


def stem(name: str) -> str:
    """The name without the ending of a photo. A name without such an ending is complete: `frame.0001` stays as it is."""
    base, ending = os.path.splitext(name)
    return base if ending.lower() in ENDINGS + UNREADABLE_ENDINGS else name


def _parts(name: str) -> tuple[str, ...]:
    """The folders and the file of a path, without its drive and its beginning; none where the name is no path."""
    if not name.strip() or "\0" in name:
        return ()
    written = PureWindowsPath(name)  # it understands both kinds of slashes
    return written.parts[1:] if written.anchor else written.parts


def _is_readable(name: str) -> bool:
    return os.path.splitext(name)[1].lower() in ENDINGS


def _names(name: str) -> Iterator[str]:
    """The names that a photo may have: as written, with an ending, or with another ending."""
    yield name
    if not _is_readable(name):
        yield from (name + ending for ending in ENDINGS)
    if stem(name) != name:
        yield from (stem(name) + ending for ending in ENDINGS)


def _plain(name: str) -> str:
    return unicodedata.normalize("NFC", name).casefold()


def _is_file(path: Path) -> bool:
    try:
        return path.is_file()
    except (OSError, ValueError):  # a name that is too long, or that holds a zero
        return False
