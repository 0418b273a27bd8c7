"""Opens a video that somebody else may have made, and decodes it frame by frame.

FFmpeg knows 400 formats. Some of them, such as playlists, name other files and addresses that FFmpeg then opens. So only
the formats and codecs of cameras are allowed, the file is given to FFmpeg as an open file without a name, and the frames'
size is limited.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import av
import av.error
from av.stream import Disposition

from blender_nep.errors import CaptureError
from blender_nep.safety.plain_files import open_plain

LARGEST_SIDE = 8192
"""Pixels of a frame's width and height"""
SMALLEST_SIDE = 64
_FORMATS = ("mov", "mp4", "m4a", "3gp", "3g2", "mj2", "matroska", "webm", "avi", "mpegts", "mpeg", "asf")
_CODECS = (
    *("h264", "hevc", "libdav1d", "av1", "vp8", "vp9", "libvpx", "libvpx-vp9", "mpeg4", "mjpeg", "mpeg2video"),
    *("mpeg1video", "prores", "dnxhd", "h263", "vc1", "wmv1", "wmv2", "wmv3", "msmpeg4v3", "msmpeg4"),
)
_READ_BYTES = 1 << 20
_MOST_THREADS = 16
_RAISED = (av.error.FFmpegError, OSError, ValueError, EOFError, NotImplementedError, OverflowError)
"""What PyAV raises for damaged files"""


@dataclass(frozen=True)
class Video:
    """What a video's file says of itself."""

    path: Path
    width: int
    height: int
    """Of the frames as they are stored, in pixels"""
    pixel_aspect: float
    """Width of a pixel, relative to its height"""
    seconds_per_frame: float
    frames: int
    """So many frames the file promises; 0: it does not say"""


@dataclass
class DecodedVideo:
    """A video that is open for decoding."""

    video: Video
    _container: Any
    _stream: Any
    damaged: int = 0
    """Packets that could not be decoded so far"""

    def frames(self) -> Iterator[av.VideoFrame]:
        """All frames in their order. What is damaged is left out. Raises CaptureError where the size changes."""
        packets = self._container.demux(self._stream)
        while True:
            try:
                packet = next(packets)
                decoded = packet.decode()
            except (StopIteration, EOFError):
                return
            except av.error.InvalidDataError:
                self.damaged += 1
                continue
            except _RAISED as error:
                raise _unreadable(self.video.path, error) from error
            for frame in decoded:
                if frame.is_corrupt:
                    self.damaged += 1
                    continue
                if (frame.width, frame.height) != (self.video.width, self.video.height):
                    raise CaptureError(
                        f"the frames of {self.video.path.name} change their size within the video",
                        "Cut the video where its size changes, and use one part.",
                        "capture.video_size_changes",
                        video=self.video.path.name,
                    )
                yield frame


@contextmanager
def opened_video(path: Path, threads: int | None = None) -> Iterator[DecodedVideo]:
    """A context with the open video. `threads`: of the decoder; None: one for each core.

    Raises CaptureError where the file is missing, is no video in a format that is read, is damaged, or too large.
    """
    try:
        file = open_plain(path, sys.maxsize)
    except OSError as error:
        reason = error.strerror or str(error)
        raise CaptureError(
            f"{path} cannot be read ({reason})",
            "Check its path.",
            "capture.video_unreadable",
            video=path.name,
            reason=reason,
        ) from error
    with file:
        if not os.fstat(file.fileno()).st_size:
            raise _unreadable(path, ValueError("the file is empty"))
        limit = {"max_pixels": str(LARGEST_SIDE * LARGEST_SIDE)}
        allowed = {
            "format_whitelist": ",".join(_FORMATS),
            "codec_whitelist": ",".join(_CODECS),
            "protocol_whitelist": "none",
        }
        try:
            container = av.open(file, "r", options=limit, container_options=allowed, buffer_size=_READ_BYTES)
        except _RAISED as error:
            raise _unreadable(path, error) from error
        with container:
            stream = _stream(path, container)
            context = stream.codec_context
            context.options = {**limit}
            context.thread_type = "AUTO"
            context.thread_count = min(threads or os.cpu_count() or 1, _MOST_THREADS)
            yield DecodedVideo(_described(path, stream), container, stream)


def _stream(path: Path, container: Any) -> Any:
    """The video stream. A cover picture of a sound file is none. Raises CaptureError."""
    streams = [stream for stream in container.streams.video if not stream.disposition & Disposition.attached_pic]
    if not len(container.streams):
        raise _unreadable(path, ValueError("its beginning is damaged, or its end is missing"))
    if not streams:
        raise CaptureError(
            f"{path.name} holds no video", "Name a video of the object.", "capture.no_video_stream", video=path.name
        )
    stream = max(streams, key=lambda one: (one.codec_context.width or 0) * (one.codec_context.height or 0))
    if stream.codec_context is None or stream.codec_context.name not in _CODECS:
        name = "unknown" if stream.codec_context is None else stream.codec_context.name
        raise _unreadable(path, ValueError(f"its codec, {name}, is not supported"))
    return stream


def _described(path: Path, stream: Any) -> Video:
    width, height = stream.codec_context.width, stream.codec_context.height
    if not (SMALLEST_SIDE <= min(width, height) and max(width, height) <= LARGEST_SIDE):
        raise CaptureError(
            f"the frames of {path.name} have {width} x {height} pixels: {SMALLEST_SIDE} to {LARGEST_SIDE} a side are read",
            "Save the video in another size.",
            "capture.video_size",
            video=path.name,
            size=f"{width} x {height}",
        )
    rate = float(stream.average_rate or stream.guessed_rate or 30)
    aspect = float(stream.sample_aspect_ratio or 1)
    return Video(path, width, height, aspect if 0.2 < aspect < 5 else 1.0, 1 / max(rate, 1e-3), stream.frames or 0)


def _unreadable(path: Path, error: Exception) -> CaptureError:
    reason = str(getattr(error, "strerror", None) or error)
    if isinstance(error, av.error.ArgumentError):  # what FFmpeg says of a format that is not allowed
        reason = "its format is not supported"
    return CaptureError(
        f"{path.name} cannot be read as a video ({reason})",
        "It may be damaged, or not copied to its end. MP4, MOV, MKV, WebM, AVI, MTS and WMV files are read.",
        "capture.video_unreadable",
        video=path.name,
        reason=reason,
    )
