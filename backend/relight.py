"""Rendering an asset from a photo's camera under one World after the other, in a scene of its own."""
import os
import tempfile
from pathlib import Path

import bpy
import numpy as np
from mathutils import Matrix

from .capture_files import Frame
from .cycles_settings import has_denoiser, use_cycles
from .imagefiles import read_exr, still_image

SCENE_NAME = "NeP relit comparison"
SENSOR_MM = 36.0
SAMPLES_FACTOR_WITHOUT_DENOISER = 4  # halves the noise that is then left in
CLIP_RANGE = (1e-3, 1e5)  # of the camera's distance to the world's origin, at least


class RelitScene:
    """A scene with the object alone. `render` gives linear radiance; `close` removes the scene, not the object."""

    def __init__(self, item, width: int, height: int, samples: int, seed: int = 0):
        self.scene = bpy.data.scenes.new(SCENE_NAME)
        self.scene.collection.objects.link(item)
        use_cycles(self.scene, samples * (1 if has_denoiser() else SAMPLES_FACTOR_WITHOUT_DENOISER), seed)
        self.scene.render.use_persistent_data = True
        self.scene.render.resolution_x, self.scene.render.resolution_y = width, height
        self.scene.render.resolution_percentage = 100
        self.scene.view_settings.view_transform = "Standard"

    def render(self, frame: Frame, world) -> np.ndarray:
        """[H,W,3] linear radiance of the object before `world`, seen by the frame's camera."""
        camera = add_camera(frame, self.scene)
        try:
            self.scene.camera, self.scene.world = camera, world
            settings = self.scene.render.image_settings
            still_image(settings)
            settings.file_format, settings.color_mode, settings.color_depth = "OPEN_EXR", "RGB", "32"
            settings.exr_codec = "ZIP"
            with tempfile.TemporaryDirectory() as folder:
                path = Path(folder) / "render.exr"
                self.scene.render.filepath = os.fspath(path)
                bpy.ops.render.render(write_still=True, scene=self.scene.name)
                channels = read_exr(path)
        finally:
            data = camera.data
            bpy.data.objects.remove(camera)
            bpy.data.cameras.remove(data)
        return np.stack([channels[name] for name in "RGB"], axis=-1)

    def close(self) -> None:
        bpy.data.scenes.remove(self.scene)


def add_camera(frame: Frame, scene, name: str = "photo camera"):
    """A Blender camera with the frame's pinhole model; sets the scene's pixel aspect for it."""
    data = bpy.data.cameras.new(name)
    data.sensor_fit, data.sensor_width = "HORIZONTAL", SENSOR_MM
    data.lens = frame.fl_x * SENSOR_MM / frame.width
    data.shift_x = 0.5 - frame.cx / frame.width
    data.shift_y = (frame.cy - frame.height / 2) / frame.width * (frame.fl_x / frame.fl_y)
    distance = float(np.linalg.norm(frame.matrix[:3, 3])) or 1.0
    data.clip_start, data.clip_end = CLIP_RANGE[0] * distance, CLIP_RANGE[1] * distance
    aspect = frame.fl_x / frame.fl_y  # a pixel's height over its width
    scene.render.pixel_aspect_x, scene.render.pixel_aspect_y = max(1.0, 1 / aspect), max(1.0, aspect)
    camera = bpy.data.objects.new(name, data)
    camera.matrix_world = Matrix(frame.matrix.tolist())
    scene.collection.objects.link(camera)
    return camera
