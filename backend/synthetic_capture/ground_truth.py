"""Renders a view of a synthetic scene in Cycles: the photo and its ground truth, both from the same samples."""

import math
import os
import tempfile
from collections.abc import Sequence
from pathlib import Path

import bpy
import numpy as np
from mathutils import Matrix

from ..rendering.cycles_settings import use_cycles
from ..scene_io.image_files import set_media_type
from .files.exr_channels import read_channels
from .scenes import GROUND_TRUTH_COLOR, GROUND_TRUTH_VALUES

BOUNCES = 5
# Limit of the radiance of indirect light. Reflected highlights stay below it, and it removes the fireflies of few samples.
INDIRECT_CLAMP = 20.0
FARTHEST = float(np.finfo(np.float16).max)
"""The largest depth: the largest number that a half float holds. Cycles gives 1e10 where a view shows no surface."""


class ViewRenderer:
    """Renders the views of a scene. One render gives all passes of a view.

    A second renderer of the same scene uses the camera and the passes of the first, with its own settings.
    """

    def __init__(self, scene: bpy.types.Scene, size: int, samples: int, field_of_view: float, seed: int):
        """`size`: width and height in pixels; `field_of_view` in radians."""
        self.scene = scene
        if scene.camera is None:
            scene.camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
            scene.collection.objects.link(scene.camera)
        self.camera = scene.camera
        self.camera.data.angle = field_of_view
        scene.render.resolution_x = scene.render.resolution_y = size
        scene.render.resolution_percentage = 100
        use_cycles(scene, samples, seed)
        scene.render.use_persistent_data = True  # Cycles loads the geometry once for all views
        scene.cycles.max_bounces = scene.cycles.diffuse_bounces = scene.cycles.glossy_bounces = BOUNCES
        scene.cycles.sample_clamp_indirect = INDIRECT_CLAMP
        scene.cycles.caustics_reflective = scene.cycles.caustics_refractive = False
        layer = self.layer = scene.view_layers[0]
        layer.use_pass_z = layer.use_pass_normal = True
        there = {aov.name for aov in layer.aovs}
        for name in (GROUND_TRUTH_COLOR, *GROUND_TRUTH_VALUES):
            if name in there:
                continue
            aov = layer.aovs.add()
            aov.name = name
            aov.type = "COLOR" if name == GROUND_TRUTH_COLOR else "VALUE"

    @property
    def focal_length(self) -> float:
        """The camera's focal length in pixels."""
        return self.scene.render.resolution_x * self.camera.data.lens / self.camera.data.sensor_width

    def render(self, matrix: Matrix) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        """Render the view whose camera-to-world matrix is `matrix`: (photo, ground truth).

        The photo is linear radiance [H,W,3]. The ground truth is {channel: [H,W]}, with the channels albedo.RGBA,
        roughness.V, metallic.V, Normal.XYZ, Depth.V and mask.V. Depth is the distance along the camera's axis, at most
        FARTHEST, which also stands where no surface is seen. The normal is in world space. The alpha of albedo is the mask.
        """
        passes = self._passes(matrix)
        layer = self.layer.name
        photo = np.stack([passes[f"{layer}.Combined.{c}"] for c in "RGB"], axis=-1)
        mask = np.clip(_value(passes, f"{layer}.mask"), 0, 1)
        truth = {f"albedo.{c}": passes[f"{layer}.albedo.{c}"] for c in "RGB"}
        truth |= {"albedo.A": mask, "mask.V": mask, "Depth.V": np.minimum(_value(passes, f"{layer}.Depth"), FARTHEST)}
        truth |= {f"{name}.V": _value(passes, f"{layer}.{name}") for name in ("roughness", "metallic")}
        truth |= {f"Normal.{c}": passes[f"{layer}.Normal.{c}"] for c in "XYZ"}
        return np.maximum(photo, 0), truth

    def render_light(self, hidden: Sequence[bpy.types.Object], rows: int, samples: int) -> np.ndarray:
        """The light that comes to the world's origin without the `hidden` things: radiance [rows, 2 rows, 3].

        The map is as Blender reads one for a World. The camera, the settings and the things are then as they were.
        """
        data, render, cycles = self.camera.data, self.scene.render, self.scene.cycles
        before = data.type, render.resolution_x, render.resolution_y, cycles.samples
        panorama = data if hasattr(data, "panorama_type") else data.cycles  # Blender 5 and before
        data.type, panorama.panorama_type = "PANO", "EQUIRECTANGULAR"
        render.resolution_x, render.resolution_y, cycles.samples = 2 * rows, rows, samples
        shown = [item for item in hidden if not item.hide_render]
        for item in shown:
            item.hide_render = True
        along_x = Matrix.Rotation(-math.pi / 2, 4, "Z") @ Matrix.Rotation(math.pi / 2, 4, "X")
        passes = self._passes(along_x)
        for item in shown:
            item.hide_render = False
        data.type, render.resolution_x, render.resolution_y, cycles.samples = before
        return np.maximum(np.stack([passes[f"{self.layer.name}.Combined.{c}"] for c in "RGB"], axis=-1), 0)

    def _passes(self, matrix: Matrix) -> dict[str, np.ndarray]:
        """Render what the camera at `matrix` sees: all channels of all passes."""
        self.camera.matrix_world = matrix
        settings = self.scene.render.image_settings
        set_media_type(settings, multilayer=True)
        settings.file_format, settings.color_depth, settings.exr_codec = "OPEN_EXR_MULTILAYER", "32", "ZIP"
        if hasattr(settings, "use_exr_interleave"):
            settings.use_exr_interleave = True  # gives a file with one part, as Blender wrote it before 5.0
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "view.exr"
            self.scene.render.filepath = os.fspath(path)
            bpy.ops.render.render(write_still=True, scene=self.scene.name)
            return read_channels(path)


def _value(passes: dict[str, np.ndarray], name: str) -> np.ndarray:
    """The pixels of a pass with one channel. The letter of that channel (X, V or Z) differs between Blender versions."""
    return next(pixels for key, pixels in passes.items() if key.rpartition(".")[0] == name)
