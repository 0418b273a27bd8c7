"""Writes found cameras as a capture: transforms.json, with nerfstudio's keys for the lens."""

from __future__ import annotations

import json
import os
from pathlib import Path

from blender_nep.cameras.found_cameras import FoundCameras
from blender_nep.cameras.structure_from_motion import PlacedPhoto
from blender_nep.capture.camera import Camera
from blender_nep.capture.formats import transforms
from blender_nep.files import output_errors, write_text


def write_capture(found: FoundCameras, folder: Path) -> Path:
    """Write `folder`/transforms.json, which names the photos where they are. Returns its path. Raises OutputError."""
    lenses = [_lens(placed.camera) for placed in found.placed]
    shared = lenses[0] if all(lens == lenses[0] for lens in lenses) else {}
    frames = [
        _frame(placed, folder) | (lens if not shared else {}) for placed, lens in zip(found.placed, lenses, strict=True)
    ]
    content = {"camera_model": "OPENCV", **shared, "object_center": [0.0, 0.0, 0.0], "object_radius": 1.0, "frames": frames}
    path = folder / transforms.FILE
    with output_errors(path):
        folder.mkdir(parents=True, exist_ok=True)
    write_text(path, json.dumps(content, indent=1) + "\n")
    return path


def _lens(camera: Camera) -> dict[str, float]:
    lens = {
        "w": camera.width,
        "h": camera.height,
        "fl_x": camera.fl_x,
        "fl_y": camera.fl_y,
        "cx": camera.cx,
        "cy": camera.cy,
    }
    return lens | {name: getattr(camera.lens, name) for name in ("k1", "k2", "p1", "p2")}


def _frame(placed: PlacedPhoto, folder: Path) -> dict:
    frame: dict = {"file_path": _relative(placed.photo.path, folder)}
    if placed.photo.mask is not None:
        frame["mask_path"] = _relative(placed.photo.mask, folder)
    return frame | {"transform_matrix": placed.camera.camera_to_world.tolist()}


def _relative(path: Path, folder: Path) -> str:
    """The path as seen from the capture's folder; the whole path where both are on different drives."""
    try:
        return Path(os.path.relpath(path.resolve(), folder.resolve())).as_posix()
    except ValueError:
        return path.resolve().as_posix()
