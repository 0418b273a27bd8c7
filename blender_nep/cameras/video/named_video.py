"""Which video the user means: a file, or the only video in a folder without photos."""

from __future__ import annotations

from pathlib import Path

from blender_nep.capture.formats.photo_search import photos_in
from blender_nep.capture.photos.photo_lookup import PLACES
from blender_nep.capture.without_cameras import video_hint, videos_in
from blender_nep.errors import CaptureError


def video_of(path: Path) -> Path | None:
    """The video that `path` names; None for a folder with photos, and for one without videos.

    Any file counts as a video: what it is, is seen when it is opened. Raises CaptureError where a folder holds several
    videos and no photos: frames of different videos may have different lenses.
    """
    if path.is_file():
        return path
    videos = videos_in(path)
    try:
        if not videos or any(photos_in(path / place) for place in PLACES):
            return None
    except OSError:  # `find_photos` says so
        return None
    if len(videos) > 1:
        raise CaptureError(
            f"{path} holds {len(videos)} videos, and no photos",
            video_hint(videos),
            "capture.several_videos",
            folder=path,
            videos=len(videos),
        )
    return videos[0]
