"""Writes .blend files."""

from pathlib import Path

import bpy

from ..scene_io.blend_backup import put_in_place
from ..scene_io.image_files import fresh_partial


def save_packed(path: Path) -> None:
    """Save the .blend with every image inside. The file is written under a temporary name and then renamed.

    A file that was there stays beside it (`put_in_place`).
    """
    bpy.ops.file.pack_all()
    partial = fresh_partial(path, "partial_" + path.name)
    bpy.ops.wm.save_as_mainfile(filepath=str(partial.resolve()), copy=True, compress=True)
    put_in_place(partial, path)
