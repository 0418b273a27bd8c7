"""Scores of F_e: what it shows of the held-out backgrounds, and its cones against many narrow rays."""

from __future__ import annotations

import math

import numpy as np
import torch

from benchmarks.geometry import Body
from blender_nep.capture import PixelRays
from blender_nep.fields.environment_field import EnvironmentField
from blender_nep.metrics import tone_map
from blender_nep.raytracing import RayTracer


def background_psnr(environment: EnvironmentField, test_rays: PixelRays, truth: Body) -> float:
    """Tone-mapped PSNR (dB) of F_e on the test views' pixels whose rays miss the true mesh."""
    tracer = RayTracer(np.asarray(truth.mesh.vertices), np.asarray(truth.mesh.faces))
    sphere = test_rays.sphere.tensor()
    origins, directions, _ = test_rays.rays(sphere)
    beside = sphere[~torch.from_numpy(tracer.occluded(origins.numpy(), directions.numpy()))]
    errors = []
    for index in torch.cat([test_rays.outside.tensor(), beside]).split(1 << 16):
        origins, directions, half_angle = test_rays.rays(index)
        near = torch.full_like(half_angle, environment.preset.camera_near)
        with torch.no_grad():
            radiance, _ = environment.render(origins, directions, near, torch.full_like(near, torch.inf), half_angle)
        photo = test_rays.radiance[index].float()
        errors.append((tone_map(radiance).clamp(0, 1) - tone_map(photo).clamp(0, 1)).square().mean(1))
    return float(-10 * torch.log10(torch.cat(errors).mean()))


def cone_error(environment: EnvironmentField, degrees: float, axes: int = 96, rays: int = 4096) -> float:
    """Mean relative error of cone queries against the mean of `rays` narrow rays in the same cone, over random axes."""
    generator = torch.Generator().manual_seed(0)
    half_angle, errors = math.radians(degrees), []
    for _ in range(axes):
        origin, axis, other = torch.randn(3, 3, generator=generator)
        origin, axis = 0.6 * origin / origin.norm(), axis / axis.norm()
        first = torch.linalg.cross(axis, other)
        first = first / first.norm()
        u = torch.rand(rays, 2, generator=generator)
        cosine, turn = 1 - u[:, :1] * (1 - math.cos(half_angle)), 2 * math.pi * u[:, 1:]
        around = turn.cos() * first + turn.sin() * torch.linalg.cross(axis, first)
        directions = cosine * axis + (1 - cosine**2).sqrt() * around
        origins = origin.expand(rays, 3)
        along = (origins * directions).sum(-1)
        border = -along + (along**2 - (origins**2).sum(-1) + 1).sqrt()
        with torch.no_grad():
            truth, _ = environment.render(origins, directions, border, torch.full_like(border, torch.inf))
        cone, _ = environment.query_cone(origin[None], axis[None], half_angle)
        errors.append(float((cone[0] - truth.mean(0)).abs().mean() / truth.mean()))
    return float(np.mean(errors))
