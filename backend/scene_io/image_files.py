"""Reads and writes image files as numpy arrays. Row 0 is the top row, and no color management changes the values.

Blender itself reads every image here and writes the photos of synthetic captures. Two things are done without Blender:

- `write_png` writes PNG files. On a full disk Blender's own PNG writer leaves half a file and reports success (tried in 4.2,
  4.5, 5.0, 5.2).
- `synthetic_capture/files/exr_channels.py` reads the passes of a multilayer OpenEXR file. Blender hides them from Python.

OpenImageIO's Python module could do both, but an add-on cannot count on it. The bpy wheels of 4.2 and 4.3 do not have it.
The wheels of 4.4 to 5.2 keep it in a folder outside `sys.path`. Debian's Blender (4.3.2 and 5.2.2) is built without it.
"""

import os
import struct
import zlib
from pathlib import Path

import bpy
import numpy as np


def open_image(path: Path) -> bpy.types.Image:
    """A new data-block of an image file. Raises OSError where Blender cannot read the file."""
    if not path.is_file():  # Blender would wait for ever for a pipe
        raise OSError(f"there is no image file {path}")
    try:
        return bpy.data.images.load(str(path), check_existing=False)
    except RuntimeError as error:
        raise OSError(f"Blender cannot read the image {path}: {error}") from error


def load_pixels(path: Path) -> np.ndarray:
    """The pixels [H,W,4] of an image file as float32, as they are stored (8-bit files: 0..1, still sRGB-encoded).

    Raises OSError where Blender cannot read the file.
    """
    image = open_image(path)
    try:
        image.colorspace_settings.is_data = True
        width, height = image.size
        if not width:
            raise OSError(f"Blender cannot read the image {path}")
        pixels = np.empty(width * height * 4, np.float32)
        image.pixels.foreach_get(pixels)
    finally:
        bpy.data.images.remove(image)
    return pixels.reshape(height, width, 4)[::-1]


def write_half_exr(path: Path, rgb: np.ndarray) -> None:
    """Write linear radiance [H,W,3] as an OpenEXR file of half floats.

    The compression is DWAA, which is lossy; the file has a fifth of the size that ZIP gives. The file is written under a
    temporary name and then renamed. Raises OSError where the file cannot be written.
    """
    height, width = rgb.shape[:2]
    pixels = np.ones((height, width, 4), np.float32)
    pixels[..., :3] = rgb[::-1]
    # Blender 5 cannot write to a path without a folder.
    partial = fresh_partial(path, Path(path).name + ".partial").absolute()
    scene = bpy.data.scenes.new("nep.save")  # holds the file's settings, so that the settings of the artist's scene stay
    image = bpy.data.images.new("nep.save", width, height, float_buffer=True, is_data=True)
    try:
        image.pixels.foreach_set(pixels.ravel())
        settings = scene.render.image_settings
        set_media_type(settings)
        settings.file_format, settings.color_mode, settings.color_depth = "OPEN_EXR", "RGB", "16"
        settings.exr_codec = "DWAA"
        image.save_render(str(partial), scene=scene)
        os.replace(partial, path)
    except (RuntimeError, OSError) as error:
        partial.unlink(missing_ok=True)
        raise OSError(f"{path} cannot be written: {error}") from error
    finally:
        bpy.data.images.remove(image)
        bpy.data.scenes.remove(scene)


def write_png(path: Path, pixels: np.ndarray) -> None:
    """Write uint8 or uint16 pixels [H,W] (gray) or [H,W,3] (RGB) as a PNG file. The values are not changed.

    The file is written under a temporary name and then renamed. Raises OSError where the file cannot be written.
    """
    height, width = pixels.shape[:2]
    depth = 8 * pixels.dtype.itemsize
    rows = np.ascontiguousarray(pixels, pixels.dtype.newbyteorder(">")).reshape(height, -1).view(np.uint8)
    raw = np.concatenate([np.zeros((height, 1), np.uint8), rows], axis=1).tobytes()

    def chunk(kind: bytes, body: bytes) -> bytes:
        return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))

    header = struct.pack(">IIBBBBB", width, height, depth, 2 if pixels.ndim == 3 else 0, 0, 0, 0)
    write_whole(
        path, b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(raw, 9)) + chunk(b"IEND", b"")
    )


def set_media_type(settings, *, multilayer: bool = False) -> None:
    """Prepare a scene's `image_settings` for the file format of a still image.

    Blender 5.0 and later need this step before the file format is set. Older versions do not have this setting.
    """
    if hasattr(settings, "media_type"):
        settings.media_type = "MULTI_LAYER_IMAGE" if multilayer else "IMAGE"


def write_whole(path: Path, data: bytes) -> None:
    """Write `data` under a temporary name and then rename the file. Raises OSError where it cannot be written."""
    partial = fresh_partial(path, Path(path).name + ".partial")
    try:
        partial.write_bytes(data)
        os.replace(partial, path)
    except OSError:
        partial.unlink(missing_ok=True)
        raise


def fresh_partial(path: Path, name: str) -> Path:
    """The path beside `path` of a file `name`, under which it is written before it is renamed. No such file is there then.

    One that was there may be a link of a stranger, through which a file elsewhere would be overwritten. Raises OSError.
    """
    partial = Path(path).with_name(name)
    partial.unlink(missing_ok=True)
    return partial


def relative_path(path: Path | str, folder: str | None = None) -> str:
    """The path relative to the .blend file, or to one in `folder`; the whole path from one drive of Windows to another."""
    try:
        return bpy.path.relpath(str(path), start=folder)
    except ValueError:
        return str(path)
