"""`cameras.json` of an asset: the photos and cameras as the engine has read them, whatever the form of the capture.

Blender's side reads it where the capture has no transforms.json (`read_frames_of` in backend/scene_io/capture_files.py). Its
keys are those of transforms.json; photos are named relative to the asset's folder.

If the object turned, each frame also has `object_to_room`: the motion [4, 4] of the object, in capture units, from the first
photo to this one. The light of environment.exr stands still. So object and camera are moved by it where a photo is rendered
again.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from blender_nep.capture.cameras.lens_keys import intrinsics_of

if TYPE_CHECKING:
    from blender_nep.capture import Capture, View

CAMERAS = "cameras.json"
"""The file's name. `CAMERAS` in backend/scene_io/capture_files.py repeats it for Blender's Python."""


def cameras_content(capture: Capture, folder: Path) -> dict[str, Any]:
    """The content of cameras.json for an asset in `folder`."""
    frames = [
        {
            "file_path": _place(view.image_path, folder),
            **intrinsics_of(view.camera),
            "transform_matrix": view.camera.camera_to_world.tolist(),
            **_motion(view, capture.views[0]),
        }
        for view in capture.views
    ]
    return {
        "color_space": capture.color_space,
        "object_center": capture.object_center.tolist(),
        "object_radius": capture.object_radius,
        "frames": frames,
    }


def _motion(view: View, first: View) -> dict[str, list]:
    """The motion of the object from the first photo to this one; empty if the object stood still."""
    if view.in_room is None or first.in_room is None:
        return {}
    return {"object_to_room": (np.linalg.inv(first.in_room) @ view.in_room).tolist()}


def _place(photo: Path, folder: Path) -> str:
    """The photo's path relative to the folder, or absolute if they lie on different drives. A link to a photo stays one."""
    try:
        return Path(os.path.relpath(os.path.abspath(photo), folder.resolve())).as_posix()
    except ValueError:
        return Path(os.path.abspath(photo)).as_posix()
