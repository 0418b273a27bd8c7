"""The color spaces of images and of the view. A studio's own OpenColorIO configuration may lack Blender's names for them."""

import bpy

SRGB, LINEAR, DATA = "sRGB", "Linear Rec.709", "Non-Color"
"""Blender's own names"""
_OTHER_NAMES = {
    SRGB: (
        *("sRGB - Texture", "sRGB Encoded Rec.709 (sRGB)", "Utility - sRGB - Texture", "Input - Generic - sRGB - Texture"),
        *("srgb_texture", "srgb_tx", "srgb_rec709_scene"),
    ),
    LINEAR: (
        *("Linear Rec.709 (sRGB)", "Utility - Linear - sRGB", "Utility - Linear - Rec.709", "scene-linear Rec.709-sRGB"),
        *("lin_rec709", "lin_srgb", "lin_rec709_srgb", "lin_rec709_scene", "Linear"),
    ),
}
"""Names in other configurations: those of ACES, and those that Blender 5.0 knows as aliases"""


def set_color_space(image: bpy.types.Image, space: str) -> None:
    """Say how the image's file stores colors: SRGB, LINEAR or DATA.

    Where the configuration has no such color space, the image keeps the one that the configuration gives to such files.
    """
    settings = image.colorspace_settings
    if space == DATA:
        settings.is_data = True
        return
    for name in (space, *_OTHER_NAMES[space]):
        try:
            settings.name = name
            return
        except TypeError:  # there is no color space of this name
            continue


def save_linear(settings: bpy.types.ImageFormatSettings) -> None:
    """Save OpenEXR files with Rec.709 primaries, also where a studio's configuration works with others.

    Where the configuration has no such color space, files keep the primaries with which it works.
    """
    settings.color_management = "OVERRIDE"
    for name in (LINEAR, *_OTHER_NAMES[LINEAR]):
        try:
            settings.linear_colorspace_settings.name = name
            return
        except TypeError:  # there is no color space of this name
            continue
    settings.color_management = "FOLLOW_SCENE"


def is_linear(image: bpy.types.Image) -> bool:
    """Whether Blender takes the values of the image's file as linear."""
    settings = image.colorspace_settings
    return settings.is_data or settings.name in (LINEAR, *_OTHER_NAMES[LINEAR])


def use_standard_view(scene: bpy.types.Scene) -> None:
    """Show renderings without a tone curve. A configuration without the view *Standard* keeps its own."""
    try:
        scene.view_settings.view_transform = "Standard"
    except TypeError:
        return
