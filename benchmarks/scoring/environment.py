"""Scores the environment field F_e by the backgrounds of the test views."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch

from benchmarks.row_files import read_row
from benchmarks.scoring.geometry import Body
from blender_nep.capture import PixelRays
from blender_nep.capture.rays.response_curve import ResponseCurve
from blender_nep.fields.environment.field import EnvironmentField
from blender_nep.geometry.ray_tracing import RayTracer
from blender_nep.job.stage_names import StageName
from blender_nep.tone_mapping import tone_map


def exposures_differ(folder: Path) -> bool:
    """Whether the test photos of a capture have exposures of their own.

    They have where all photos were taken with automatic exposure, as its scene.json says, and where the photos to learn from
    are photographs that a camera developed, as its photographs.json says.
    """
    automatic = read_row(folder / "scene.json").get("photography", {}).get("auto_exposure")
    return bool(automatic or read_row(folder / "photographs.json").get("photos"))


def response_of(report: dict) -> ResponseCurve | None:
    """The camera's response curve that a job's report tells; None if there is none."""
    found = report.get("stages", {}).get(str(StageName.MATERIAL_LEARNING), {}).get("response")
    return None if found is None else ResponseCurve.from_state(found)


def background_psnr(
    environment: EnvironmentField,
    test_rays: PixelRays,
    truth: Body,
    own_exposures: bool = False,
    response: ResponseCurve | None = None,
) -> float:
    """PSNR (dB) of F_e in tone-mapped space, over the pixels of the test views whose rays miss the true mesh.

    The exposure of `test_rays` is that of the photos from which F_e was learned. With `own_exposures`, each test photo also
    has its own, which no file tells: F_e is brightened or darkened to suit each photo.
    `response` is the curve that F_e has and the test photos have not.
    """
    tracer = RayTracer(np.asarray(truth.mesh.vertices), np.asarray(truth.mesh.faces))
    sphere = test_rays.sphere.tensor()
    origins, directions, _ = test_rays.rays(sphere)
    hit = torch.from_numpy(tracer.occluded(origins.cpu().numpy(), directions.cpu().numpy()))
    beside = sphere[~hit.to(sphere.device)]
    scored, rendered = torch.cat([test_rays.outside.tensor(), beside]), []
    for index in scored.split(1 << 16):
        origins, directions, half_angle = test_rays.rays(index)
        near = torch.full_like(half_angle, environment.preset.camera_near)
        with torch.no_grad():
            shown = environment.render(origins, directions, near, torch.full_like(near, torch.inf), half_angle)
        light = shown.radiance if response is None else response.light(shown.radiance)
        rendered.append(light / test_rays.exposure)
    photo, radiance = test_rays.radiance[scored].float(), torch.cat(rendered)
    if own_exposures:
        radiance = radiance * _gains(photo, radiance, test_rays.view_of(scored), test_rays.views)
    errors = (tone_map(radiance).clamp(0, 1) - tone_map(photo).clamp(0, 1)).square().mean(1)
    return float(-10 * torch.log10(errors.mean()))


def _gains(photo: torch.Tensor, radiance: torch.Tensor, view: torch.Tensor, views: int) -> torch.Tensor:
    """The gain [n, 1] of each pixel's photo: the median ratio of its pixels `photo` [n, 3] to the rendered `radiance`."""
    ratio = photo.sum(1) / radiance.sum(1).clamp(min=1e-6)
    gain = torch.ones(views, device=ratio.device)
    for shown in view.unique():
        gain[shown] = ratio[view == shown].median()
    return gain[view, None]
