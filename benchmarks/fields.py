"""Stage 1 against ground truth: presets and ablations on rendered captures.

    python -m benchmarks.fields CAPTURE... [--preset balanced] [--ablation NAME...] [--seed 0] [--out out/benchmarks]

A capture is a folder with `transforms.json`, `transforms_test.json` and `gt_mesh.ply`; masks are ignored. Every run
writes one JSON file and is skipped when that exists; a run that fails is a row with its message. Ends with a table.
"""

from __future__ import annotations

import itertools
import math
import resource
import sys
import time
from functools import partial
from pathlib import Path

import numpy as np
import torch

from benchmarks.geometry import Body, score, true_mesh
from benchmarks.harness import learning_parser, markdown, resumed, use_threads, with_changes
from blender_nep.capture import PixelRays, load_capture
from blender_nep.checkpoints import NoCheckpoint
from blender_nep.fields.environment_field import EnvironmentField
from blender_nep.fields_learning import learn_fields
from blender_nep.metrics import tone_map
from blender_nep.presets import PRESETS, Preset
from blender_nep.raytracing import RayTracer
from blender_nep.surface import extract_surface

ABLATIONS: dict[str, dict[str, dict]] = {
    "full": {},
    "w_s as printed": {"fields": {"dynamic_weight": "paper"}},
    "w_s scaled": {"fields": {"dynamic_weight": "scaled"}},
    "environment at infinity": {"environment": {"model": "infinite"}},
    "no decomposition": {"fields": {"decomposition": False}},
    "no curvature": {"fields": {"curvature": 0.0}},
    "no visual hull": {"fields": {"background_steps": 0}},
    "F_e not shy": {"fields": {"shyness": 1.0}},
}
"""Preset fields that differ from the preset's own."""


def background_psnr(environment: EnvironmentField, test_rays: PixelRays, truth: Body) -> float:
    """Tone-mapped PSNR (dB) of F_e on the test views' pixels whose rays miss the true mesh."""
    beside = [test_rays.outside]
    tracer = RayTracer(np.asarray(truth.mesh.vertices), np.asarray(truth.mesh.faces))
    origins, directions, _ = test_rays.rays(test_rays.sphere)
    beside.append(test_rays.sphere[~torch.from_numpy(tracer.occluded(origins.numpy(), directions.numpy()))])
    errors = []
    for index in torch.cat(beside).split(1 << 16):
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


def run(folder: Path, preset: Preset, seed: int) -> dict:
    """One run of stage 1 and the surface, and all its scores."""
    capture, test = load_capture(folder), load_capture(folder, transforms="transforms_test.json")
    test.object_center, test.object_radius = capture.object_center, capture.object_radius
    device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
    rays = PixelRays.from_capture(capture, preset.max_pixels_per_photo, False, device)
    torch.manual_seed(seed)
    wall, cpu = time.perf_counter(), time.process_time()
    fields = learn_fields(rays, preset, seed=seed, device=device, progress=lambda *_: None, checkpoint=NoCheckpoint())
    out = {"seconds": time.perf_counter() - wall, "cpu_seconds": time.process_time() - cpu}
    wall = time.perf_counter()
    surface, report = extract_surface(fields.object_field, preset.surface)
    out |= {"surface_seconds": time.perf_counter() - wall, "faces": len(surface.faces), "surface": report}
    out |= score(surface, folder, capture, test)
    test_rays = PixelRays.from_capture(test, preset.max_pixels_per_photo, False, device)
    out["background_psnr"] = background_psnr(fields.environment, test_rays, true_mesh(folder, capture))
    out |= {f"cone_error_{d}": cone_error(fields.environment, d) for d in (5, 15, 30, 60)}
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / (1 << 20 if sys.platform == "darwin" else 1 << 10)
    return out | {"peak_mb": peak, "report": fields.report}


COLUMNS = ("cd_visible", "cd_full", "fscore_005", "normal_deg", "mask_iou", "background_psnr", "seconds", "cpu_seconds",
           "peak_mb")


def cells(row: dict) -> list:
    """One line of the table; a failed run shows its message."""
    scores = [float(row[c]) if c in row else row.get("error", "") for c in COLUMNS]
    return [row["capture"], row["preset"], row["ablation"], *scores]


def main() -> None:
    arguments = learning_parser(__doc__, ABLATIONS, "out/benchmarks/fields").parse_args()
    use_threads(arguments.threads)
    header, rows = ["capture", "preset", "ablation", *COLUMNS], []
    for folder, name, ablation in itertools.product(arguments.captures, arguments.preset, arguments.ablation):
        row = {"capture": folder.name, "preset": name, "ablation": ablation, "seed": arguments.seed,
               "threads": arguments.threads}
        file = arguments.out / f"{folder.name}-{name}-{ablation.replace(' ', '_')}-{arguments.seed}.json"
        preset = with_changes(PRESETS[name], ABLATIONS[ablation])
        rows.append(cells(resumed(file, row, partial(run, folder, preset, arguments.seed))))
        print(markdown(header, rows[-1:]).splitlines()[-1], flush=True)
    print("\n" + markdown(header, rows))


if __name__ == "__main__":
    main()
