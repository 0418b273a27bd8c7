"""What a capture folder holds: how many photos, and whether their cameras are known.

The panel asks at every drawing, so an answer about a folder is kept for a while.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from ..backend.engine.results.capture_contents import (
    LEAST_PHOTOS,
    has_cameras,
    has_masks,
    photo_count,
    transforms_time,
    video_count,
)

KEPT_S = 2.0
"""So long an answer is kept at least."""
KEPT_TIMES = 30
"""An answer is kept so many times as long as it took to find, so that a slow drive does not slow down the drawing."""


@dataclass(frozen=True)
class CaptureFolder:
    """What a folder holds. A folder that cannot be read holds nothing."""

    photos: int = 0
    """Photos in the folder, or in its folder `images`"""
    has_cameras: bool = False
    """Whether the folder holds cameras, in any of the forms that the engine reads"""
    transforms_time: int = 0
    """When transforms.json was last written, in nanoseconds; 0 where there is none"""
    has_masks: bool = False
    """Whether there is a folder with masks"""
    videos: int = 0
    """Videos in the folder"""

    @property
    def has_transforms(self) -> bool:
        """Whether the cameras are in transforms.json."""
        return self.transforms_time > 0

    @property
    def lacks_cameras(self) -> bool:
        """Whether there are photos, but no cameras."""
        return self.photos > 0 and not self.has_cameras

    @property
    def has_enough_photos(self) -> bool:
        """Whether cameras can be found from so many photos."""
        return self.photos >= LEAST_PHOTOS


_kept: dict[Path, tuple[float, CaptureFolder]] = {}  # folder -> (until when the answer is kept, the answer)


def look_into(folder: Path) -> CaptureFolder:
    """What the folder holds now."""
    found = photo_count(folder), has_cameras(folder), transforms_time(folder), has_masks(folder), video_count(folder)
    return CaptureFolder(*found)


def last_look_into(folder: Path, clock: Callable[[], float] = time.monotonic) -> CaptureFolder:
    """What the folder holds, or held a few seconds ago."""
    begin = clock()
    until, found = _kept.get(folder, (begin, CaptureFolder()))
    if begin >= until:
        found = look_into(folder)
        end = clock()
        _kept[folder] = end + max(KEPT_S, KEPT_TIMES * (end - begin)), found
    return found


def forget_looks() -> None:
    """Files have changed: look again at the next question."""
    _kept.clear()
