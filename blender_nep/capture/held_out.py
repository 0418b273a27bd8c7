"""Holds photos of a capture out from learning, so that an asset can be scored on photos that it does not know."""

from __future__ import annotations

from dataclasses import replace

from blender_nep.capture.capture import Capture
from blender_nep.capture.loading import MINIMUM_VIEWS
from blender_nep.errors import UsageError


def split(capture: Capture, every: int) -> tuple[Capture, Capture]:
    """The photos to learn from, and the photos that are held out: every `every`-th photo, from the first on.

    Raises UsageError where too few photos are left to learn from.
    """
    held = [view for number, view in enumerate(capture.views) if number % every == 0]
    learned = [view for number, view in enumerate(capture.views) if number % every]
    if len(learned) < MINIMUM_VIEWS:
        raise UsageError(
            f"--hold-out {every} leaves {len(learned)} of {len(capture.views)} photos to learn from",
            f"Give a larger number: at least {MINIMUM_VIEWS} photos must be left.",
            "usage.too_many_held_out",
            learned=len(learned),
            photos=len(capture.views),
        )
    return replace(capture, views=learned), replace(capture, views=held)
