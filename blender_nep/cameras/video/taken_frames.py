"""Takes frames from a video as photos: one pass chooses them, another one writes them. Memory holds one frame."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image

from blender_nep.cameras.video.frame_choice import MOTION_SIDE, SHARPNESS_SIDE, FrameSurvey
from blender_nep.cameras.video.frame_color import encoding_of_frame, gray_pixels, is_hdr, upright_pixels
from blender_nep.cameras.video.video_file import Video, opened_video
from blender_nep.capture.loading import MINIMUM_VIEWS
from blender_nep.errors import CaptureError
from blender_nep.files import output_errors
from blender_nep.messages import Message

_QUALITY = 95
"""of the JPEG files, with the colors in full size. A video's frames have losses already: as a lossless file, they would
count as renders without a camera's curve (capture/camera_settings.py)."""
_FAST = 0.5
"""Motion in a second, in longest sides of the picture, above which frames are probably bent or blurred"""
_MANY_FAST = 0.25
"""The part of the frames that must be fast for a warning"""
_MISSING = 0.02
"""The part of the promised frames that must be missing for a warning"""

Report = Callable[[int, int], None]
"""Called with the number of frames that were looked at or written, and the number of all, in both passes"""


@dataclass(frozen=True)
class TakenFrames:
    """Frames that were written as photos."""

    paths: list[Path]
    said: list[Message]
    warnings: list[Message]


def take_frames(path: Path, most: int, folder: Path, report: Report, threads: int | None = None) -> TakenFrames:
    """Write at most `most` frames of the video as JPEG files into `folder`, which is made. Their names have their numbers.

    They are evenly spaced in view. `report` may raise, to stop. Raises CaptureError where the video cannot be read, or shows
    hardly more than one view, and OutputError where the frames cannot be written.
    """
    survey, interlaced, hdr = FrameSurvey(), 0, False
    with opened_video(path, threads) as opened:
        video = opened.video
        for number, frame in enumerate(opened.frames()):
            report(number, 2 * max(video.frames, number + 1))
            if not number:
                encoding_of_frame(frame, path)  # to refuse it now, and not after minutes
                hdr = is_hdr(frame)
            interlaced += frame.interlaced_frame
            large = gray_pixels(frame, SHARPNESS_SIDE)
            survey.add(large, gray_pixels(frame, MOTION_SIDE))
        damaged = opened.damaged
    count = len(survey.moved)
    chosen = survey.choose(most)
    if not count:
        raise CaptureError(
            f"no frame of {path.name} can be read",
            "It may be damaged, or not copied to its end.",
            "capture.video_without_frames",
            video=path.name,
        )
    if len(chosen) < MINIMUM_VIEWS:
        raise CaptureError(
            f"{path.name} shows hardly more than one view: the camera stands still",
            "Walk around the object while you film it, and film its surroundings, too.",
            "capture.video_too_still",
            video=path.name,
        )
    paths = _write(path, chosen, folder, lambda done: report(count + done, 2 * count), threads)
    said = [Message("cameras.video_frames", {"count": len(paths), "frames": count, "video": path.name})]
    warnings = []
    missing = max(damaged, video.frames - count if video.frames else 0)
    if missing > _MISSING * count:
        warnings.append(Message("cameras.video_damaged", {"count": missing, "frames": count + missing}))
    if interlaced > count / 2:
        warnings.append(Message("cameras.video_interlaced"))
    if hdr:
        warnings.append(Message("cameras.video_hdr"))
    warnings += _too_fast(survey, chosen, video)
    return TakenFrames(paths, said, warnings)


def _too_fast(survey: FrameSurvey, chosen: Sequence[int], video: Video) -> list[Message]:
    """A warning where the view moves so fast in many of the chosen frames that the frames cannot be sharp and straight.

    A camera without a global shutter reads the rows of a frame one after the other, over most of the time between two
    frames.
    """
    speeds = np.array(survey.steps)[list(chosen)] / video.seconds_per_frame
    if (speeds > _FAST).mean() <= _MANY_FAST:
        return []
    return [Message("cameras.video_fast", {"percent": 100 * float(np.median(speeds[speeds > _FAST]))})]


def _write(
    path: Path, chosen: Sequence[int], folder: Path, report: Callable[[int], None], threads: int | None
) -> list[Path]:
    wanted, paths = set(chosen), []
    with output_errors(folder):
        folder.mkdir()
    with opened_video(path, threads) as opened:
        for number, frame in enumerate(itertools.islice(opened.frames(), max(chosen) + 1)):
            report(number)
            if number in wanted:
                pixels = upright_pixels(frame, encoding_of_frame(frame, path), opened.video.pixel_aspect)
                paths.append(folder / f"frame_{number:06d}.jpg")
                with output_errors(paths[-1]):
                    Image.fromarray(pixels).save(paths[-1], quality=_QUALITY, subsampling=0)
    return paths
