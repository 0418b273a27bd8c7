"""`cameras.json` of an asset: the photos and cameras as the engine has read them, whatever the form of the capture.

Blender's side reads it where the capture has no transforms.json (`read_frames_of` in backend/scene_io/capture_files.py). Its
keys are those of transforms.json; photos are named relative to the asset's folder.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

from blender_nep.capture.cameras.lens_keys import intrinsics_of

if TYPE_CHECKING:
    from blender_nep.capture import Capture

CAMERAS = "cameras.json"
"""The file's name. `CAMERAS` in backend/scene_io/capture_files.py repeats it for Blender's Python."""


def cameras_content(capture: Capture, folder: Path) -> dict[str, Any]:
    """The content of cameras.json for an asset in `folder`."""
    frames = [
        {
            "file_path": _place(view.image_path, folder),
            **intrinsics_of(view.camera),
            "transform_matrix": view.camera.camera_to_world.tolist(),
        }
        for view in capture.views
    ]
    return {
        "color_space": capture.color_space,
        "object_center": capture.object_center.tolist(),
        "object_radius": capture.object_radius,
        "frames": frames,
    }


def _place(photo: Path, folder: Path) -> str:
    """The photo's path relative to the folder, or absolute if they lie on different drives. A link to a photo stays one."""
    try:
        return Path(os.path.relpath(os.path.abspath(photo), folder.resolve())).as_posix()
    except ValueError:
        return Path(os.path.abspath(photo)).as_posix()
