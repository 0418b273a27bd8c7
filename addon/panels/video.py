"""The buttons that find the cameras of a video's frames."""

import bpy
from bpy.app.translations import pgettext_iface

ONE_VIDEO, VIDEOS = "A video, no photos yet", "{count} videos, no photos yet"


def draw_videos(layout: bpy.types.UILayout, count: int) -> None:
    """Draw what can be done for a folder without photos that holds `count` videos."""
    if count:
        box = layout.box()
        text = pgettext_iface(ONE_VIDEO) if count == 1 else pgettext_iface(VIDEOS).format(count=count)
        box.label(text=text, icon="FILE_MOVIE")
        if count == 1:
            box.operator("nep.find_cameras", icon="VIEWZOOM")
    if count != 1:
        draw_choose_video(layout)


def draw_choose_video(layout: bpy.types.UILayout) -> None:
    """Draw the button that opens the file browser."""
    layout.operator("nep.find_cameras_of_video", icon="FILE_MOVIE")
