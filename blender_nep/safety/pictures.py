"""How pictures are opened by Pillow: only in the formats that are promised, and no other program is started.

A file's content says which format it has. Pillow knows some fifty formats, and gives an EPS file that is called `photo.png`
to Ghostscript, which runs the program in that file.
"""

from __future__ import annotations

import os
import struct
import zlib
from typing import IO

from PIL import EpsImagePlugin, Image

FORMATS = ("JPEG", "PNG", "WEBP")
"""Pillow's names of them. Files with several JPEG pictures (MPO), as some phones make them, count as JPEG."""

# Phones take photos of 200 megapixels. Pillow warns above this limit and refuses more than twice as many pixels.
Image.MAX_IMAGE_PIXELS = 1 << 28

DAMAGED = (
    *(OSError, ValueError, RuntimeError, SyntaxError, LookupError, TypeError, AttributeError, EOFError, AssertionError),
    *(ArithmeticError, struct.error, zlib.error, Image.DecompressionBombError),
)
"""What Pillow, and the packages for other formats, raise for damaged files"""


def forbid_ghostscript() -> None:
    """Let Pillow start no Ghostscript in this process: a library may open a picture by itself, such as a mesh's texture."""
    EpsImagePlugin.gs_binary = False


forbid_ghostscript()


def open_picture(source: str | os.PathLike[str] | IO[bytes], formats: tuple[str, ...] = FORMATS) -> Image.Image:
    """The picture in a file; its pixels are read later. Raises one of `DAMAGED`, OSError for another format or a pipe."""
    if isinstance(source, str | os.PathLike) and not os.path.isfile(source):
        raise OSError(f"there is no file {source}")
    return Image.open(source, formats=formats)
