"""Writes found cameras as a capture: transforms.json, with nerfstudio's keys for the lens."""

from __future__ import annotations

import json
import os
import tempfile
from pathlib import Path

from blender_nep.cameras.found_cameras import FoundCameras
from blender_nep.cameras.structure_from_motion import PlacedPhoto
from blender_nep.capture.camera import Camera
from blender_nep.capture.formats import transforms
from blender_nep.errors import OutputError
from blender_nep.files import output_errors, write_text


def check_writable(folder: Path) -> None:
    """Check, before the work, that a capture can be written to `folder`. Raises OutputError. Nothing is left behind."""
    there = folder.absolute()
    while not os.path.lexists(there):
        there = there.parent
    if not there.is_dir():
        raise OutputError(f"{there} is a file, not a folder", "Choose another --out.", "output.is_a_file", path=there)
    with output_errors(folder), tempfile.TemporaryFile(dir=there):
        pass


def write_capture(found: FoundCameras, folder: Path, color_space: str | None = None) -> Path:
    """Write `folder`/transforms.json, which names the photos where they are. Returns its path. Raises OutputError."""
    lenses = [_lens(placed.camera) for placed in found.placed]
    shared = lenses[0] if all(lens == lenses[0] for lens in lenses) else {}
    frames = [
        _frame(placed, folder) | (lens if not shared else {}) for placed, lens in zip(found.placed, lenses, strict=True)
    ]
    sphere = {"object_center": found.object_center.tolist(), "object_radius": found.object_radius}
    color = {} if color_space is None else {"color_space": color_space}
    content = {**shared, **color, **sphere, "frames": frames}
    path = folder / transforms.FILE
    try:
        with output_errors(path):
            folder.mkdir(parents=True, exist_ok=True)
        write_text(path, json.dumps(content, indent=1) + "\n")
    except OutputError as error:
        if error.name != "output.disk_full":
            raise
        hint = "Free some space, then run the command again."  # nothing can be resumed
        raise OutputError(error.message, hint, error.name, **error.values) from error
    return path


def _lens(camera: Camera) -> dict[str, float | str]:
    lens: dict[str, float | str] = {"camera_model": "OPENCV_FISHEYE" if camera.lens.fisheye else "OPENCV"}
    lens |= {
        "w": camera.width,
        "h": camera.height,
        "fl_x": camera.fl_x,
        "fl_y": camera.fl_y,
        "cx": camera.cx,
        "cy": camera.cy,
    }
    terms = {name: getattr(camera.lens, name) for name in ("k1", "k2", "k3", "k4", "p1", "p2")}
    return lens | {name: value for name, value in terms.items() if value or name in ("k1", "k2")}


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
