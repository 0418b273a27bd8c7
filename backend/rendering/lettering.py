"""Draws text with Blender's own font, which Cycles renders. Blender's Python has no Pillow, and a GPU may be missing."""

import os
import tempfile
from pathlib import Path

import bpy
import numpy as np

from ..scene_io.image_files import load_pixels, set_media_type

SAMPLES = 8
LETTER_WIDTH = 0.46  # mean width of a letter of Blender's font, in text sizes


def draw_text(width: int, height: int, texts: list[tuple[float, float, float, str]]) -> np.ndarray:
    """Draw texts, and return how much of each pixel they cover: [H,W], 0..1.

    Each text is (x, y, size, string). x and y are the start of its baseline, in pixels from the top left corner. The size is
    in pixels.
    """
    scene = bpy.data.scenes.new("nep.lettering")
    made = []
    try:
        scene.render.engine = "CYCLES"
        scene.cycles.samples, scene.cycles.use_denoising, scene.cycles.max_bounces = SAMPLES, False, 0
        scene.render.film_transparent = True
        scene.render.resolution_x, scene.render.resolution_y = width, height
        scene.render.resolution_percentage = 100
        data = bpy.data.cameras.new("nep.lettering")
        data.type, data.ortho_scale = "ORTHO", float(max(width, height))
        camera = bpy.data.objects.new("nep.lettering", data)
        camera.location = (width / 2, -height / 2, 10)
        scene.collection.objects.link(camera)
        scene.camera = camera
        made.append(camera)
        for x, y, size, string in texts:
            curve = bpy.data.curves.new("nep.lettering", "FONT")
            curve.body, curve.size = string, size
            item = bpy.data.objects.new("nep.lettering", curve)
            item.location = (x, -y, 0)
            scene.collection.objects.link(item)
            made.append(item)
        return _alpha(scene)
    finally:
        for item in made:
            data = item.data
            bpy.data.objects.remove(item)
            (bpy.data.cameras if isinstance(data, bpy.types.Camera) else bpy.data.curves).remove(data)
        bpy.data.scenes.remove(scene)


def shortened(string: str, width: float, size: float) -> str:
    """The string, cut off where it would be wider than about `width` pixels at the text size `size`."""
    letters = max(4, int(width / (LETTER_WIDTH * size)))
    return string if len(string) <= letters else string[: letters - 2] + ".."


def _alpha(scene: bpy.types.Scene) -> np.ndarray:
    """Render the scene, and return the alpha [H,W] of the picture, 0..1."""
    settings = scene.render.image_settings
    set_media_type(settings)
    settings.file_format, settings.color_mode, settings.color_depth = "OPEN_EXR", "RGBA", "16"
    settings.exr_codec = "ZIP"
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "text.exr"
        scene.render.filepath = os.fspath(path)
        bpy.ops.render.render(write_still=True, scene=scene.name)
        return np.clip(load_pixels(path)[..., 3], 0, 1)
