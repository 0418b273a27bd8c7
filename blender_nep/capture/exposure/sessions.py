"""The sessions of a capture: photos that were taken without a long pause between them."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from datetime import datetime, timedelta

import numpy as np

from blender_nep.capture.capture import Capture
from blender_nep.capture.photos.photo_files import time_taken
from blender_nep.errors import CaptureError

PAUSE = timedelta(hours=1)
"""Photos before and after such a pause belong to two sessions."""


def times_of(capture: Capture) -> list[datetime | None]:
    """When each photo of a capture was taken; None where its file does not say."""
    times: list[datetime | None] = []
    for view in capture.views:
        try:
            times.append(time_taken(view.image_path))
        except CaptureError:  # whether the pixels are sound is seen when they are read
            times.append(None)
    return times


def sessions(times: Sequence[datetime | None]) -> np.ndarray:
    """The session [n] of each photo, from 0 on. All photos belong to one where a time is not known."""
    numbers = np.zeros(len(times), int)
    known = [time for time in times if time is not None]
    if len(known) < len(times):
        return numbers
    order = sorted(range(len(known)), key=known.__getitem__)
    pauses = [known[after] - known[before] > PAUSE for before, after in itertools.pairwise(order)]
    numbers[order[1:]] = np.cumsum(pauses)
    return numbers
