"""Which video the user means: a file, or the only video in a folder without enough photos."""

from __future__ import annotations

from pathlib import Path

from blender_nep.cameras.video.kept_frames import frames_folder
from blender_nep.capture.description import MINIMUM_VIEWS
from blender_nep.capture.formats.photo_search import photos_in
from blender_nep.capture.photos.photo_lookup import PLACES
from blender_nep.capture.without_cameras import video_hint, videos_in
from blender_nep.errors import CaptureError


def video_of(path: Path) -> Path | None:
    """The video that `path` names; None for a folder with enough photos for a search, and for one without videos.

    A phone or a download may put one picture beside its video. Any file counts as a video: what it is, is seen when it is
    opened. Raises CaptureError where a folder holds several videos and too few photos: frames of different videos may have
    different lenses.
    """
    if path.is_file():
        return path
    videos, places = videos_in(path), [*(path / place for place in PLACES), frames_folder(path)]
    try:
        if not videos or any(len(photos_in(place)) >= MINIMUM_VIEWS for place in places):
            return None
    except OSError:  # `find_photos` says so
        return None
    if len(videos) > 1:
        raise CaptureError(
            f"{path} holds {len(videos)} videos, and no photos or too few",
            video_hint(videos),
            "capture.several_videos",
            folder=path,
            videos=len(videos),
        )
    return videos[0]
