"""Scores the environment field F_e by the backgrounds of the test views."""

from __future__ import annotations

import numpy as np
import torch

from benchmarks.scoring.geometry import Body
from blender_nep.capture import PixelRays
from blender_nep.fields.environment_field import EnvironmentField
from blender_nep.geometry.ray_tracing import RayTracer
from blender_nep.tone_mapping import tone_map


def background_psnr(environment: EnvironmentField, test_rays: PixelRays, truth: Body) -> float:
    """PSNR (dB) of F_e in tone-mapped space, over the pixels of the test views whose rays miss the true mesh.

    The exposure of `test_rays` is that of the photos from which F_e was learned.
    """
    tracer = RayTracer(np.asarray(truth.mesh.vertices), np.asarray(truth.mesh.faces))
    sphere = test_rays.sphere.tensor()
    origins, directions, _ = test_rays.rays(sphere)
    hit = torch.from_numpy(tracer.occluded(origins.cpu().numpy(), directions.cpu().numpy()))
    beside = sphere[~hit.to(sphere.device)]
    errors = []
    for index in torch.cat([test_rays.outside.tensor(), beside]).split(1 << 16):
        origins, directions, half_angle = test_rays.rays(index)
        near = torch.full_like(half_angle, environment.preset.camera_near)
        with torch.no_grad():
            radiance, _ = environment.render(origins, directions, near, torch.full_like(near, torch.inf), half_angle)
        photo, radiance = test_rays.radiance[index].float(), radiance / test_rays.exposure
        errors.append((tone_map(radiance).clamp(0, 1) - tone_map(photo).clamp(0, 1)).square().mean(1))
    return float(-10 * torch.log10(torch.cat(errors).mean()))
