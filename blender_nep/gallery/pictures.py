"""Pictures inside a page: small copies as data URIs, and the recovered light in the form that the viewer reads."""

from __future__ import annotations

import base64
import io
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import imagecodecs
import numpy as np
import OpenEXR
from PIL import Image

from blender_nep.safety.pictures import DAMAGED, open_picture

WEBP_QUALITY = 78
"""Of thumbnails: a picture of 480 x 240 pixels takes about 9 kB."""
_MOST_PIXELS, _MOST_LIGHT = 1 << 26, 1 << 25
"""Pixels of a picture, and values of a light, that are opened. An asset of ours has far smaller ones."""


@dataclass(frozen=True)
class Thumbnail:
    """A small copy of a picture."""

    uri: str
    width: int
    height: int


def thumbnail(path: Path, width: int) -> Thumbnail | None:
    """A copy that is at most `width` pixels wide, as WebP. None if the picture is missing or damaged.

    The copy is kept in memory until the file changes: a batch writes its gallery again and again.
    """
    try:
        state = path.stat()
        return _thumbnail(path, width, state.st_mtime_ns, state.st_size)
    except DAMAGED:
        return None


@lru_cache(maxsize=4096)
def _thumbnail(path: Path, width: int, _changed: int, _size: int) -> Thumbnail:
    with open_picture(path) as opened:
        if opened.width * opened.height > _MOST_PIXELS:
            raise ValueError(f"{path.name} is larger than any picture of ours")
        small = opened.convert("RGB")
    if small.width > width:
        small = small.resize((width, max(1, round(small.height * width / small.width))), Image.Resampling.LANCZOS)
    packed = io.BytesIO()
    small.save(packed, "WEBP", quality=WEBP_QUALITY, method=4)
    return Thumbnail(data_uri(packed.getvalue(), "image/webp"), small.width, small.height)


def data_uri(content: bytes, kind: str) -> str:
    """The content of a file as a URI; `kind` is its media type."""
    return f"data:{kind};base64,{base64.b64encode(content).decode()}"


@dataclass(frozen=True)
class ViewerLight:
    """The recovered light for the viewer."""

    uri: str
    exposure: float
    """The factor that shows a white matte ball in this light at about 0.8 of white"""


def viewer_light(path: Path) -> ViewerLight | None:
    """The light of environment.exr [H, 2H, 3]. None if the file is missing or damaged.

    An equirectangular map in Blender's World orientation, z up, has the same rows and columns as glTF's, y up: asset.glb has
    (x, z, -y) for (x, y, z), and the viewer looks up u = 0.5 + atan2(z, x) / (2 pi) there. So no pixel moves.
    """
    from blender_nep.capture.photos.formats import exr_files  # imports torch, which a batch without a light does not need

    try:
        exr_files.check(path, _MOST_LIGHT)
        light = np.asarray(OpenEXR.File(str(path)).channels()["RGB"].pixels, np.float32)
        light = np.ascontiguousarray(np.clip(np.nan_to_num(light), 0, 65504))
        area = np.sin((np.arange(len(light)) + 0.5) * np.pi / len(light))
        mean = float(np.average(light.mean((1, 2)), weights=area))
        # `out` is the size in bytes: imagecodecs' own guess is too small for pixels that cannot be packed
        packed = bytes(imagecodecs.rgbe_encode(light, header=True, rle=True, out=2 * light.size + 1000))
    except DAMAGED:
        return None
    # the viewer knows a Radiance file by the end of its name
    return ViewerLight(data_uri(packed, "image/vnd.radiance") + "#.hdr", 0.8 / max(mean, 1e-6))
