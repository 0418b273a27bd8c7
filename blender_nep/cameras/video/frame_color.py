"""The colors of a video's frames as sRGB pixels, upright, with square pixels.

FFmpeg's swscale turns Y'CbCr into R'G'B', by the matrix and the range that the file names. Without a matrix, swscale takes
that of BT.601 for all sizes; here large frames have BT.709's, as players take it. Transfer function and primaries follow
`capture/photos/formats/color_encoding.py`, as for HEIC photos. HLG, in which phones film HDR, is undone by the inverse of
the camera's curve (ITU-R BT.2100), and its brightest value becomes white.
"""

from __future__ import annotations

from pathlib import Path

import av
import numpy as np
from av.video.reformatter import Colorspace, Interpolation

from blender_nep.capture.photos.formats.color_encoding import SRGB, ColorEncoding, from_codes
from blender_nep.color import linear_to_srgb, to_bytes
from blender_nep.errors import CaptureError

_UNSPECIFIED = (2, 3)
"""H.273's codes for a matrix that is not specified, or reserved"""
_HD_WIDTH, _SD_HEIGHT = 1280, 576
"""Frames as wide, or higher, have BT.709's matrix where the file names none."""
_HLG, _SRGB_CURVE = 18, 13
_HLG_A, _HLG_B, _HLG_C = 0.17883277, 0.28466892, 0.55991073
"""Constants of BT.2100, table 5"""
_EXACT = Interpolation.BICUBIC | Interpolation.FULL_CHR_H_INT | Interpolation.ACCURATE_RND
_STRIP = 64
"""Rows whose colors are changed at a time"""


def encoding_of_frame(frame: av.VideoFrame, path: Path) -> ColorEncoding:
    """How the frame's R'G'B' values become linear. Raises CaptureError for HDR other than HLG, and for unknown codes."""
    primaries, transfer = int(frame.color_primaries), int(frame.color_trc)
    try:
        if transfer == _HLG:
            matrix = from_codes(primaries, _SRGB_CURVE).to_rec709
            return ColorEncoding((_hlg_to_linear,), matrix)
        return from_codes(primaries, transfer)
    except ValueError as error:
        raise CaptureError(
            f"the colors of {path.name} cannot be read: {error}",
            "Film without HDR (no HDR10, no Dolby Vision, no log), or convert the video to SDR (BT.709).",
            "capture.video_colors",
            video=path.name,
        ) from error


def is_hdr(frame: av.VideoFrame) -> bool:
    """Whether the frame is HDR that `encoding_of_frame` can read."""
    return int(frame.color_trc) == _HLG


def upright_pixels(frame: av.VideoFrame, encoding: ColorEncoding, pixel_aspect: float) -> np.ndarray:
    """The frame as sRGB values [H, W, 3] uint8, turned as the file's display matrix says."""
    deep = any(component.bits > 8 for component in frame.format.components)
    width = max(1, round(frame.width * pixel_aspect))
    converted = frame.reformat(
        width=width,
        height=frame.height,
        format="rgb48le" if deep else "rgb24",
        src_colorspace=_matrix(frame),
        interpolation=_EXACT,
    )
    pixels = converted.to_ndarray()
    if encoding is not SRGB and not _is_srgb(encoding):
        rows = (pixels[start : start + _STRIP] for start in range(0, len(pixels), _STRIP))
        pixels = np.concatenate([to_bytes(linear_to_srgb(encoding.of_whole_numbers(strip))) for strip in rows])
    elif deep:
        pixels = to_bytes(pixels.astype(np.float32) / 65535)
    return np.ascontiguousarray(np.rot90(pixels, round(frame.rotation / 90)))


def gray_pixels(frame: av.VideoFrame, longest: int) -> np.ndarray:
    """The frame's brightness [h, w] uint8, no side longer than `longest`, as it is stored: not turned."""
    scale = min(1.0, longest / max(frame.width, frame.height))
    width, height = (max(1, round(side * scale)) for side in (frame.width, frame.height))
    return frame.reformat(width=width, height=height, format="gray", interpolation=Interpolation.AREA).to_ndarray()


def _is_srgb(encoding: ColorEncoding) -> bool:
    return encoding.curves == SRGB.curves and encoding.to_rec709 is None


def _matrix(frame: av.VideoFrame) -> Colorspace | None:
    """The matrix where the file names none; None: as the file says."""
    if int(frame.colorspace) not in _UNSPECIFIED or frame.format.is_rgb:
        return None
    large = frame.width >= _HD_WIDTH or frame.height > _SD_HEIGHT
    return Colorspace.ITU709 if large else Colorspace.ITU601


def _hlg_to_linear(x: np.ndarray) -> np.ndarray:
    """Inverse of HLG's camera curve: the scene's light, 1 for the brightest value."""
    x = np.clip(x, 0, 1)
    return np.where(x <= 0.5, x * x / 3, (np.exp((x - _HLG_C) / _HLG_A) + _HLG_B) / 12).astype(np.float32)
