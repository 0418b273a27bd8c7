"""Shows what has been learned so far: a coarse mesh, and a photo beside the rendered fields (`--preview`).

The preview draws no random number and changes nothing that is learned. So the asset is the same with and without it.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO

import numpy as np
import torch
from PIL import Image

from blender_nep.asset.preview import best_view, exposure
from blender_nep.color import linear_to_srgb
from blender_nep.errors import LearningError, NepError
from blender_nep.files import output_errors, write_atomically
from blender_nep.geometry.ray_tracing import RayTracer
from blender_nep.job.folders.job_folder import FOLDER, PREVIEW_MESH, PREVIEW_PICTURE
from blender_nep.messages import Message
from blender_nep.surface.extraction import zero_level

if TYPE_CHECKING:
    from blender_nep.capture import PixelRays
    from blender_nep.fields.training import FieldsLearning
    from blender_nep.job.reporting.events import Events

GRID = 64
WIDTH = 160
"""Largest width and height of the photo in the picture, in pixels."""
CHUNK = 4096


class LivePreview:
    """Writes `job/preview.npz` and `job/preview.png` every `interval` seconds. It is called after every step of learning."""

    interval = 10.0
    """Smallest time from one preview to the next, in seconds."""
    share = 0.03
    """Largest share of the job's time that previews may take."""

    def __init__(
        self,
        asset: Path,
        rays: PixelRays,
        from_unit: np.ndarray,
        events: Events,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.path, self.rays, self.from_unit, self.events, self._clock = asset / FOLDER, rays, from_unit, events, clock
        self._due = clock() + self.interval
        self._view: int | None = None

    def __call__(self, learning: FieldsLearning) -> None:
        """Write a preview if it is time. After a failure, there is one warning and no further preview."""
        start = self._clock()
        if start < self._due or learning.fraction == 0:
            return
        try:
            self._write(learning)
        except (NepError, OSError, RuntimeError, ValueError) as error:
            self.events.warning(Message("job.preview_ended", {"reason": str(error)}))
            self._due = math.inf
            return
        end = self._clock()
        self._due = end + max(self.interval, (end - start) / self.share)

    def _write(self, learning: FieldsLearning) -> None:
        try:
            vertices, faces = zero_level(learning.object_field.sdf_grid(GRID))
        except LearningError:  # the object field has no surface yet
            return
        with output_errors(self.path):
            self.path.mkdir(exist_ok=True)
        if self._view is None:
            self._view = best_view(self.rays, RayTracer(vertices, faces))
        vertices = vertices @ self.from_unit[:3, :3].T + self.from_unit[:3, 3]
        arrays = {"vertices": vertices.astype(np.float32), "faces": faces.astype(np.int32)}
        picture = Image.fromarray(render_pair(learning, self._view))
        for name, write in (
            (PREVIEW_MESH, lambda file: np.savez(file, **arrays)),
            (PREVIEW_PICTURE, lambda file: picture.save(file, format="PNG")),
        ):
            write_atomically(self.path / name, partial(_write_into, write))
            self.events.preview(self.path / name)


def _write_into(write: Callable[[BinaryIO], object], path: Path) -> None:
    with open(path, "wb") as file:
        write(file)


@torch.no_grad()
def render_pair(learning: FieldsLearning, view: int) -> np.ndarray:
    """A picture [h, 2 w, 3] uint8 sRGB: on the left the photo of `view`, on the right the fields rendered by its camera.

    w and h are at most WIDTH.
    """
    rays = learning.rays
    height, width = rays.size[view]
    step = math.ceil(max(height, width) / WIDTH)
    grid = torch.arange(height * width, device=rays.valid.device).reshape(height, width)[::step, ::step]
    index = grid.flatten() + rays.offset[view]
    rendered = torch.cat([learning.render(part).radiance for part in index.split(CHUNK)])
    photo = rays.photo(index)
    pair = [part.cpu().numpy().reshape(*grid.shape, 3) for part in (photo, rendered)]
    return np.round(255 * linear_to_srgb(np.concatenate(pair, 1) * exposure(pair[0]))).astype(np.uint8)
