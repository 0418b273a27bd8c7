"""Makes variants of a capture: cut-outs, photos clipped at white, photos with their own exposure, a distant object.

A variant keeps the cameras, the ground truth and the test views of the capture that it was made from.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import OpenEXR
from PIL import Image

from benchmarks.suite.harness import is_made_from, link, write_made
from benchmarks.suite.identity import photos_of
from blender_nep.capture import load_capture
from blender_nep.color import linear_to_srgb
from blender_nep.errors import CaptureError

_SMALLER = 4
"""The width and height of the photos of `distant` are divided by this number."""


def cut_out(photo: np.ndarray, mask: np.ndarray, _white: float, file: Path) -> None:
    """Write a cut-out: the object alone, with alpha 0 around it."""
    _write_exr(file, np.concatenate([photo * mask[..., None], mask[..., None]], -1))


def clipped(photo: np.ndarray, _mask: np.ndarray, white: float, file: Path) -> None:
    """Write 8 bits a channel, sRGB-encoded. All photos have the same exposure, which `white` gives."""
    Image.fromarray(np.round(255 * linear_to_srgb(photo / white)).astype(np.uint8)).save(file)


def auto_exposed(photo: np.ndarray, _mask: np.ndarray, _white: float, file: Path) -> None:
    """Write 8 bits a channel, sRGB-encoded. Each photo has its own exposure, which makes a fiftieth of its pixels white."""
    own_white = max(float(np.quantile(photo.max(-1), 0.98)), 1e-6)
    Image.fromarray(np.round(255 * linear_to_srgb(photo / own_white)).astype(np.uint8)).save(file)


def distant(photo: np.ndarray, _mask: np.ndarray, _white: float, file: Path) -> None:
    """Write the same view with fewer pixels, so that the object covers few pixels, as if it were far away."""
    _write_exr(file, _shrunk(photo))


VARIANTS: dict[str, tuple[Callable, str]] = {
    "cut-out": (cut_out, ".exr"),
    "clipped": (clipped, ".png"),
    "auto-exposed": (auto_exposed, ".png"),
    "distant": (distant, ".exr"),
}


def derive(source: Path, variant: str, out: Path) -> Path:
    """Make the variant of the capture `source` in the folder `out`, unless it is there already. Returns `out`.

    It is made again where `source` is another folder, or has other cameras or photos, than when it was made.
    Raises CaptureError where `source` cannot be read, or has photos without masks.
    """
    write, suffix = VARIANTS[variant]
    capture = load_capture(source)
    made_from = f"{source.resolve()}\n{photos_of(source, masks=True)}"
    if is_made_from(out, made_from):
        return out
    (out / "transforms.json").unlink(missing_ok=True)
    meta = json.loads((source / "transforms.json").read_text(encoding="utf-8"))
    for name in ("gt_mesh.ply", "transforms_test.json", "gt", "test", "test_masks"):
        out.mkdir(parents=True, exist_ok=True)
        link(out / name, source / name)
    (out / "images").mkdir(exist_ok=True)
    shutil.rmtree(out / "masks", ignore_errors=True)
    (out / "masks").mkdir()
    photos = [(capture.load_photo(i)[0], capture.load_mask(i)) for i in range(len(meta["frames"]))]
    if any(mask is None for _, mask in photos):
        raise CaptureError(f"{source}: nothing can be derived from photos without masks of the object")
    shown = [photo[mask > 0.5].max(-1) for photo, mask in photos]
    white = float(np.quantile(np.concatenate(shown), 0.98))  # a fiftieth of the object's pixels are white or brighter
    for i, (frame, (photo, mask)) in enumerate(zip(meta["frames"], photos, strict=True)):
        frame["file_path"], frame["mask_path"] = f"images/{i:03d}{suffix}", f"masks/{i:03d}.png"
        write(photo, mask, white, out / frame["file_path"])
        if variant == "distant":
            mask = _shrunk(mask[..., None])[..., 0]
        Image.fromarray(np.round(255 * mask).astype(np.uint8)).save(out / frame["mask_path"])
    if variant == "distant":
        for place in (meta, *meta["frames"]):
            for name in ("w", "h"):
                if name in place:
                    place[name] = int(place[name]) // _SMALLER
            for name in ("fl_x", "fl_y", "cx", "cy"):
                if name in place:
                    place[name] = place[name] / _SMALLER
    meta["color_space"] = "srgb" if suffix == ".png" else "linear"
    write_made(out, meta, made_from)
    return out


def _shrunk(image: np.ndarray) -> np.ndarray:
    """The image [H,W,C] with `_SMALLER` times fewer pixels a side. Each pixel is the mean of a square of pixels."""
    height, width = (side // _SMALLER * _SMALLER for side in image.shape[:2])
    blocks = image[:height, :width].reshape(height // _SMALLER, _SMALLER, width // _SMALLER, _SMALLER, -1)
    return blocks.mean((1, 3)).astype(np.float32)


def _write_exr(file: Path, pixels: np.ndarray) -> None:
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    OpenEXR.File(header, {"RGBA"[: pixels.shape[-1]]: pixels.astype(np.float16)}).write(str(file))
