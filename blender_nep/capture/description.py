"""What a folder's own files say of a capture: the result of reading any of the formats, before it is checked."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from blender_nep.capture.capture import View
from blender_nep.errors import CaptureError
from blender_nep.messages import Message

MINIMUM_VIEWS = 3
"""With fewer photos, neither the shape nor the surroundings are determined: two views cannot even contradict each other."""
MOST_LACKING = 0.2
"""If at most this share of the photos has no mask, these photos are left out. Else no masks are used."""
MOST_VIEWS = 20_000
"""Photos of a capture. Files that list more are refused, because each photo is looked for on the disk."""


def check_number(photos: int, file: str) -> None:
    """Raises CaptureError where a file lists more photos than a capture may have. No stop is asked while they are read."""
    if photos > MOST_VIEWS:
        raise CaptureError(f"{file} lists {photos:,} photos: at most {MOST_VIEWS:,} are possible", "Take photos out.")


@dataclass
class CaptureDescription:
    """Views, and what else the files say. `loading.load_capture` makes a checked `Capture` of it."""

    name: str
    """The format or the file, for messages and for `Capture.bounds_source`"""
    files: tuple[Path, ...]
    """The files that describe the capture, without photos and masks. A resumed run compares their content"""
    views: list[View]
    color_space: Any = None
    """How 8- and 16-bit photos are encoded, 'linear' or 'srgb', as the file has it; None: not said"""
    object_center: Any = None
    """[3] in the capture's coordinates, as the file has it; None: not said"""
    object_radius: Any = None
    """As `object_center`"""
    warnings: list[Message] = field(default_factory=list)
    turntable: bool | None = None
    """Whether the object turned on a turntable; None: not said"""
    missing_masks: list[str] = field(default_factory=list)
    """Masks that the file names and that are not there"""
