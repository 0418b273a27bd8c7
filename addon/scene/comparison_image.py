"""The relit comparison as an image of the .blend file, in the Image Editors that are open."""

from pathlib import Path

import bpy

NAME = "NeP comparison"


def comparison_image() -> bpy.types.Image | None:
    """The image; None where no comparison was rendered for this file."""
    return bpy.data.images.get(NAME)


def load_comparison(path: Path) -> bpy.types.Image:
    """Load the picture, in place of an earlier one, and show it in the Image Editors that are open."""
    image = comparison_image()
    if image is None:
        image = bpy.data.images.load(str(path))
        image.name = NAME
    else:
        image.filepath = str(path)
        image.reload()
    image.use_fake_user = True
    for window in bpy.context.window_manager.windows:
        for area in window.screen.areas:
            if area.type == "IMAGE_EDITOR":
                area.spaces.active.image = image
                area.tag_redraw()
    return image
