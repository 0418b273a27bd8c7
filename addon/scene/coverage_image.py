"""The picture of the photos' directions as an image of the .blend file."""

from pathlib import Path

import bpy

NAME = "NeP photo directions"


def load_coverage(path: Path) -> bpy.types.Image:
    """Load the picture into the .blend file, in place of an earlier one. The picture's file may vanish then."""
    image = bpy.data.images.get(NAME)
    if image is not None:
        bpy.data.images.remove(image)
    image = bpy.data.images.load(str(path))
    image.name = NAME
    image.pack()
    return image
