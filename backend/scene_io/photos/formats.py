"""Which of the photos that the engine reads Blender can show, and what their name and header say. No bpy in this file."""

import struct
import sys
from pathlib import Path
from typing import BinaryIO

from ...plain_files import open_plain

SHOWN = (".exr", ".png", ".jpg", ".jpeg", ".tif", ".tiff", ".webp")
"""Every Blender shows photos with these endings."""
HEIF = (".heic", ".heif", ".hif")
"""Some Blenders show them: Debian's 5.2 does, the bpy wheels do not."""
RAW = (".dng", ".cr2", ".cr3", ".nef", ".arw", ".raf", ".orf", ".rw2")
"""No Blender develops them. Of some it shows the small preview in the file, which does not fit the camera."""

_WIDTH, _HEIGHT, _SAMPLE_FORMAT, _PROFILE = 256, 257, 339, 34675
_FLOAT = 3
_SIZES = {1: "B", 3: "H", 4: "I", 16: "Q"}
_MOST_TAGS = 1000


class TiffHeader:
    """What the header of a TIFF file says of its first page."""

    def __init__(self, path: Path) -> None:
        """Raises OSError where the file cannot be read or is no TIFF file."""
        try:
            with open_plain(path, sys.maxsize) as file:
                tags = _tags(file)
            self.size: tuple[int, int] = (tags[_WIDTH], tags[_HEIGHT])
        except (struct.error, KeyError, ValueError) as error:
            raise OSError(f"the header of {path} is damaged") from error
        self.is_linear = tags.get(_SAMPLE_FORMAT) == _FLOAT and _PROFILE not in tags
        """Whether the page holds floats without a profile, which the engine takes as radiance"""


def color_space(path: Path) -> str:
    """'linear' or 'srgb', as the engine takes a photo of a capture that does not say it. Raises OSError as TiffHeader."""
    ending = path.suffix.lower()
    if ending in (".tif", ".tiff"):
        return "linear" if TiffHeader(path).is_linear else "srgb"
    return "linear" if ending == ".exr" or ending in RAW else "srgb"


def _tags(file: BinaryIO) -> dict[int, int]:
    """The first value of each tag of the first page (TIFF 6.0, section 2; BigTIFF has 8 bytes for sizes and places)."""
    start = file.read(16)
    order = {b"II": "<", b"MM": ">"}[start[:2]]
    big = struct.unpack(order + "H", start[2:4])[0] == 43
    place = struct.unpack_from(order + ("Q" if big else "I"), start, 8 if big else 4)[0]
    file.seek(place)
    count = struct.unpack(order + ("Q" if big else "H"), file.read(8 if big else 2))[0]
    if count > _MOST_TAGS:
        raise ValueError("too many tags")
    step, found = 20 if big else 12, {}
    entries = file.read(step * count)
    for at in range(0, step * count, step):
        tag, kind = struct.unpack_from(order + "HH", entries, at)
        values = struct.unpack_from(order + ("Q" if big else "I"), entries, at + 4)[0]
        letter = _SIZES.get(kind, "")
        held = entries[at + (12 if big else 8) : at + step]
        if letter and values * struct.calcsize(order + letter) > len(held):
            file.seek(struct.unpack(order + ("Q" if big else "I"), held)[0])
            held = file.read(8)
        found[tag] = struct.unpack_from(order + letter, held)[0] if letter else 0
    return found
