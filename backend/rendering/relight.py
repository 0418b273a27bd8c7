"""Renders an object from a photo's camera under different Worlds, in a separate scene."""

import os
import tempfile
from dataclasses import replace
from pathlib import Path

import bpy
import numpy as np
from mathutils import Matrix

from ..scene_io.cameras import new_camera, pixel_aspect
from ..scene_io.capture_files import Frame
from ..scene_io.color_spaces import save_linear, use_standard_view
from ..scene_io.image_files import load_pixels, set_media_type
from .cycles_settings import has_denoiser, use_cycles

SCENE_NAME = "NeP relit comparison"
SAMPLES_FACTOR_WITHOUT_DENOISER = 4  # halves the noise


class RelitScene:
    """A scene that holds only the object. `close`, or the end of a `with` block, removes the scene but not the object.

    For a photo from a turntable, object and camera are moved as they were (`Frame.object_to_room`), since the light stands
    still. Afterwards the object is where it was.
    """

    def __init__(self, item: bpy.types.Object, width: int, height: int, samples: int, seed: int = 0):
        self.item, self.scene = item, bpy.data.scenes.new(SCENE_NAME)
        self.scene.collection.objects.link(item)
        use_cycles(self.scene, samples * (1 if has_denoiser() else SAMPLES_FACTOR_WITHOUT_DENOISER), seed)
        self.scene.render.use_persistent_data = True
        self.scene.render.resolution_percentage = 100
        use_standard_view(self.scene)
        self.set_size(width, height)

    def set_size(self, width: int, height: int) -> None:
        """Set the size of the pictures, in pixels. It needs the aspect of the frames that are rendered."""
        self.scene.render.resolution_x, self.scene.render.resolution_y = width, height

    def render(self, frame: Frame, world: bpy.types.World) -> np.ndarray:
        """Render the object under `world`, seen by the frame's camera: linear radiance [H,W,3] float32."""
        return np.ascontiguousarray(self._rendered(frame, world, "RGB")[..., :3])

    def render_brightened(self, frame: Frame, world: bpy.types.World, gain: float) -> np.ndarray:
        """As `render`, but the object alone is brighter by the factor `gain`. What is seen behind it stays."""
        whole = self.render(frame, world)
        return whole if gain == 1 else whole + (gain - 1) * self.render_cut_out(frame, world)[..., :3]

    def render_cut_out(self, frame: Frame, world: bpy.types.World) -> np.ndarray:
        """As `render`, but `world` is not seen behind the object: radiance and coverage [H,W,4], 0..1 in the last channel.

        The radiance is that of the object alone: where half of a pixel shows the object, it is halved.
        """
        self.scene.render.film_transparent = True
        try:
            return self._rendered(frame, world, "RGBA")
        finally:
            self.scene.render.film_transparent = False

    def _rendered(self, frame: Frame, world: bpy.types.World, channels: str) -> np.ndarray:
        at_rest = self.item.matrix_world.copy()
        if frame.object_to_room is not None:  # the object turned in the light, and the camera saw it there
            frame = replace(frame, matrix=frame.object_to_room @ frame.matrix)
        camera = add_camera(frame, self.scene)
        try:
            if frame.object_to_room is not None:
                self.item.matrix_world = Matrix(frame.object_to_room.tolist()) @ at_rest
            self.scene.camera, self.scene.world = camera, world
            settings = self.scene.render.image_settings
            set_media_type(settings)
            settings.file_format, settings.color_mode, settings.color_depth = "OPEN_EXR", channels, "32"
            settings.exr_codec = "ZIP"
            save_linear(settings)
            with tempfile.TemporaryDirectory() as folder:
                path = Path(folder) / "render.exr"
                self.scene.render.filepath = os.fspath(path)
                bpy.ops.render.render(write_still=True, scene=self.scene.name)
                pixels = load_pixels(path)
        finally:
            if frame.object_to_room is not None:
                self.item.matrix_world = at_rest
            data = camera.data
            bpy.data.objects.remove(camera)
            bpy.data.cameras.remove(data)
        return pixels

    def __enter__(self) -> "RelitScene":
        return self

    def __exit__(self, *raised: object) -> None:
        self.close()

    def close(self) -> None:
        bpy.data.scenes.remove(self.scene)


def add_camera(frame: Frame, scene: bpy.types.Scene, name: str = "photo camera") -> bpy.types.Object:
    """Add a camera with the frame's pinhole model and pose, and set the scene's pixel aspect for that camera."""
    scene.render.pixel_aspect_x, scene.render.pixel_aspect_y = pixel_aspect(frame)
    return new_camera(frame, scene.collection, name)
