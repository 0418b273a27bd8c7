"""The state of stage 1: the scene, both fields, their optimizers, the schedule, and the pixels that are learned from.

`training` takes the steps. Between them, refinements (`refinements.refinement`) look at this state and improve it.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch
from torch import Tensor

from blender_nep.capture.rays.pixel_rays import PixelRays
from blender_nep.capture.rays.pixel_set import PixelSet
from blender_nep.capture.rays.ray_bundle import RayBundle
from blender_nep.fields.environment import training as environment_training
from blender_nep.fields.environment.field import EnvironmentField
from blender_nep.fields.field_optimizers import Optimizers
from blender_nep.fields.fields import new_object_field
from blender_nep.fields.object.field import ObjectField
from blender_nep.fields.object.volume_rendering import BAND
from blender_nep.fields.object_pixels import ObjectPixels, draw_pixels, fitted_to_widths
from blender_nep.fields.rendering import FieldsRenderer, Rendering, RenderSettings
from blender_nep.fields.schedule import Schedule
from blender_nep.fields.visual_hull import VisualHull
from blender_nep.presets import Preset
from blender_nep.scene.scene import Scene
from blender_nep.support.plane import Support
from blender_nep.tone_mapping import tone_map


class StageOne:
    """The state of fields learning.

    If `object_field` is given, it is learned; otherwise a new one is made from the preset. The seed decides all random
    numbers.
    """

    def __init__(self, scene: Scene, preset: Preset, seed: int, object_field: ObjectField | None = None) -> None:
        torch.manual_seed(seed)  # for the color heads
        rays, device = scene.rays, scene.device
        self.scene, self.preset = scene, fitted_to_widths(preset.fields, rays)
        self.generator = torch.Generator(device).manual_seed(seed)
        self.environment = EnvironmentField(preset.environment, environment_training.geometric_mean(rays)).to(device)
        self.object_field = object_field or new_object_field(preset, device)
        self.stand_on(scene.support)
        self.object_field.add_levels(preset.fields.first_levels)
        self.schedule = Schedule.at_start(preset.fields, len(rays.outside), rays.count)
        self.renderer = FieldsRenderer(self.object_field, self.environment, preset.fields)
        self.optimizers = Optimizers(self.object_field, self.environment, preset)
        self.object_pixels: ObjectPixels | None = None
        """The object pixels; None until they are first found."""
        self.validation_pixels = rays.sphere[:0]
        """[n] int64: held-out pixels among the object pixels. Empty until the object pixels are first found."""
        self.hidden_pixels = rays.sphere[:0]
        """[m] int64, rising: pixels whose masks do not show the object because something stands before it."""
        self.cell_scores: np.ndarray | None = None
        """[n, n, n]: what F_e alone leaves unexplained in the SDF's cells (`refinements.hull.background_scores`)."""
        self.hull: VisualHull | None = None
        """The visual hull from which the SDF starts. Like `cell_scores`, it is known only before the first step of both
        fields, to the refinements that are applied then."""

    def stand_on(self, support: Support | None) -> None:
        """Let the object stand on the plane that was found, if one was: in the scene, and in the object field.

        This is the one place where stage 1 learns of a plane. The field needs it because the SDF counts above it only.
        """
        self.scene = self.scene.with_support(support)
        self.object_field.stand_on(self.scene.support)

    @property
    def rays(self) -> PixelRays:
        """The pixels of the scene's photos."""
        return self.scene.rays

    @property
    def background(self) -> PixelSet:
        """The pixels whose rays miss the object's sphere. If they are too few to learn F_e from, all pixels that see it."""
        enough = len(self.rays.outside) >= self.preset.least_outside * self.rays.count
        return self.rays.outside if enough else self.rays.sphere

    @property
    def learned_pixels(self) -> ObjectPixels:
        """The object pixels. Until they are first found, all pixels that see the object's sphere."""
        return self.object_pixels or ObjectPixels(self.rays.sphere.empty(), self.rays.sphere)

    @property
    def band(self) -> float:
        """Largest distance from the SDF's surface at which the object is not fully transparent, in object radii."""
        return BAND / self.schedule.sharpness

    @property
    def cells(self) -> int:
        """Number of cells of the SDF's finest grid along a side."""
        return round(2 / self.object_field.cell)

    def on_device(self, values: np.ndarray) -> Tensor:
        """The values as a tensor on the device of the fields."""
        return torch.from_numpy(values).to(self.generator.device)

    def draw(self, pool: PixelSet, count: int) -> Tensor:
        """About `count` random pixels of the pool that are not held out, [m] int64."""
        return draw_pixels(pool, count, self.preset.held_out_every, self.generator)

    def render(self, index: Tensor, generator: torch.Generator | None = None) -> Rendering:
        """Render the pixels `index` [n] int64 through both fields in their present state. Without a generator, nothing is
        random."""
        return self.render_rays(self.rays.rays(index), generator)

    def render_rays(self, rays: RayBundle, generator: torch.Generator | None, clear_rays: int = 0) -> Rendering:
        """Render rays [n] through both fields. The first `clear_rays` of them have a clear F_e in front of the object."""
        now = self.schedule
        settings = RenderSettings(now.sharpness, now.samples, now.environment_gradient_scale, object_is_known=now.from_hull)
        return self.renderer.render(rays, settings, generator, clear_rays)

    @torch.no_grad()
    def environment_alone(self, rays: RayBundle) -> Tensor:
        """The radiance [n, 3] of F_e alone along rays [n], from the camera on."""
        near = torch.full_like(rays.half_angle, self.environment.preset.camera_near)
        return self._environment(rays, near)

    def unexplained_by_environment(self) -> Callable[[Tensor], Tensor]:
        """A function of pixels [k] that gives the error [k] of F_e behind the place of the object.

        That is behind the object's sphere, or from the support plane on. The error is relative to the mean error beside the
        sphere.
        """

        @torch.no_grad()
        def error(index: Tensor) -> Tensor:
            rays = self.rays.rays(index)
            _, leave, _ = self.object_field.shape().interval(rays.origins, rays.directions)
            behind = self._environment(rays, leave.clamp(min=self.environment.preset.camera_near))
            return (tone_map(behind) - tone_map(self.rays.photo(index))).abs().mean(-1)

        typical = float(error(self.draw(self.rays.outside, self.preset.validation_pixels)).mean())
        return lambda index: error(index) / max(typical, 1e-6)

    def _environment(self, rays: RayBundle, start: Tensor) -> Tensor:
        """The radiance [n, 3] of F_e along rays [n], from the distances `start` [n] on."""
        end = torch.full_like(start, torch.inf)
        origins, directions, half_angle = rays.in_room()
        return self.environment.render(origins, directions, start, end, half_angle).radiance
