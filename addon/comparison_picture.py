"""The comparison as an image of the .blend file, and the editors that show it."""

from pathlib import Path

import bpy

from . import clock
from .editors import open_editor

IMAGE_NAME = "NeP comparison"


def picture():
    """The image; None where no comparison was rendered."""
    return bpy.data.images.get(IMAGE_NAME)


def show_image(path: Path):
    """The picture as the image IMAGE_NAME, read again where there is one, in the Image Editors that are open."""
    image = picture()
    if image is None:
        image = bpy.data.images.load(str(path))
        image.name = IMAGE_NAME
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


class NEP_OT_show_comparison(bpy.types.Operator):
    bl_idname = "nep.show_comparison"
    bl_label = "Show Picture"
    bl_description = "Show the comparison in an Image Editor: one that is open, or a window of its own"

    @classmethod
    def poll(cls, context):
        if picture() is None:
            cls.poll_message_set("Render a comparison first")
            return False
        return True

    def execute(self, context):
        if not bpy.app.background:
            open_editor(context, "IMAGE_EDITOR").image = picture()
            clock.watch(fit_picture)  # in the next round: a new window has no size yet
        return {"FINISHED"}


def fit_picture() -> bool:
    """Zoom the Image Editors that show the comparison until all of it is seen."""
    for window in bpy.context.window_manager.windows:
        for area in window.screen.areas:
            if area.type == "IMAGE_EDITOR" and area.spaces.active.image == picture():
                region = next(region for region in area.regions if region.type == "WINDOW")
                with bpy.context.temp_override(window=window, area=area, region=region):
                    bpy.ops.image.view_all(fit_view=True)
    return False


CLASSES = (NEP_OT_show_comparison,)
