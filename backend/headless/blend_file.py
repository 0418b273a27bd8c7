"""Writes .blend files."""

import os
from pathlib import Path

import bpy


def save_packed(path: Path) -> None:
    """Save the .blend with every image inside. The file is written under a temporary name and then renamed."""
    bpy.ops.file.pack_all()
    partial = path.with_name("partial_" + path.name)
    bpy.ops.wm.save_as_mainfile(filepath=str(partial.resolve()), copy=True, compress=True)
    os.replace(partial, path)
