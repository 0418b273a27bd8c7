"""Stage 2 against ground truth: presets and ablations on rendered captures, on the true mesh or on our own.

    python -m benchmarks.materials CAPTURE... [--geometry true own] [--ablation NAME...] [--out out/benchmarks/materials]

A capture is a folder with `transforms_test.json`, `gt_mesh.ply` and `gt/NNN.exr` (albedo, roughness.V, metallic.V, mask.V);
masks are ignored. Stage 1 is learned once for each capture, preset, geometry and seed, and kept beside the results. Every
run writes one JSON file, and a picture of the materials beside the truth, and is skipped when that exists; a run that
fails is a row with its message. Ends with a table.
"""

from __future__ import annotations

import argparse
import itertools
import json
import os
import time
from dataclasses import replace
from pathlib import Path

import numba
import numpy as np
import OpenEXR
import torch
import trimesh
from PIL import Image

from benchmarks.geometry import Body, camera_rays, true_mesh
from blender_nep.capture import PixelRays, load_capture
from blender_nep.capture.capture import Capture
from blender_nep.capture.images import linear_to_srgb
from blender_nep.checkpoints import NoCheckpoint, load_state, save_state
from blender_nep.errors import NepError
from blender_nep.fields_learning import learn_fields
from blender_nep.material_learning import Materials, learn_materials
from blender_nep.presets import PRESETS, Preset
from blender_nep.rooms import Rooms
from blender_nep.surface import Surface, extract_surface, load_surface
from blender_nep.texels import look_up

ABLATIONS: dict[str, dict[str, dict]] = {
    "full": {},
    "no cones": {"material": {"use_cones": False}},
    "few samples": {"material": {"samples": 6000}},
    "few samples, 256 + 128 rays": {"material": {"samples": 6000, "use_cones": False, "diffuse_cones": 256,
                                                 "irradiance_cones": 256, "specular_cones": 128}},
    "environment at infinity": {"environment": {"model": "infinite"}},
    "no indirect light": {"material": {"levels": 0}},
    "N = 1": {"material": {"levels": 1}},
    "N = 3": {"material": {"levels": 3}},
    "no residual": {"material": {"residual": False}},
    "one material": {"material": {"most_materials": 1}},
}
"""Preset fields that differ from the preset's own."""
CHANNELS = {"albedo": 3, "roughness": 1, "metallic": 1}


def ablated(name: str, preset: Preset) -> Preset:
    """The preset with one of ABLATIONS."""
    return replace(preset, **{part: replace(getattr(preset, part), **values) for part, values in ABLATIONS[name].items()})


def stage_1(folder: Path, capture: Capture, rays: PixelRays, preset: Preset, geometry: str, seed: int, kept: Path
            ) -> tuple[Surface, object, float]:
    """The surface, F_e, and the seconds that both took."""
    device = rays.radiance.device
    if kept.is_file():
        state = load_state(kept)
        surface, _ = Rooms().unpack_surface(state["surface"])
        return surface, Rooms().unpack_fields(state["fields"], preset, device).environment, state["seconds"]
    start, surface, report = time.perf_counter(), None, {}
    if geometry == "true":
        surface = load_surface(folder / "gt_mesh.ply", capture, preset.surface)
    torch.manual_seed(seed)
    fields = learn_fields(rays, preset, seed=seed, device=device, progress=lambda *_: None, checkpoint=NoCheckpoint(),
                          surface=surface)
    if surface is None:
        surface, report = extract_surface(fields.object_field, preset.surface)
    seconds = time.perf_counter() - start
    save_state(kept, {"surface": Rooms().pack_surface((surface, report)), "fields": Rooms().pack_fields(fields),
                      "seconds": seconds})
    return surface, fields.environment, seconds


def score(surface: Surface, materials: Materials, folder: Path, capture: Capture, test: Capture, picture: Path,
          shown: int = 3) -> dict[str, float]:
    """Mean squared errors over the test views' pixels that show both surfaces; the first views are drawn."""
    ours, truth = Body(surface.vertices, surface.faces), true_mesh(folder, capture)
    errors: dict[str, list] = {name: [] for name in CHANNELS}
    rows = []
    for view in range(len(test.views)):
        origins, directions, size = camera_rays(test, view, 1)
        gt = {k: np.asarray(c.pixels, np.float32)
              for k, c in OpenEXR.File(str(folder / "gt" / f"{view:03d}.exr")).channels().items()}
        point, ray, face = ours.first_hits(origins, directions)
        on_truth = np.zeros(len(origins), bool)
        on_truth[truth.first_hits(origins, directions)[1]] = True
        keep = (gt["mask.V"].ravel()[ray] > 0.99) & on_truth[ray]
        point, ray, face = point[keep], ray[keep], face[keep]
        corners = surface.vertices[surface.faces[face]]
        barycentric = trimesh.triangles.points_to_barycentric(corners, point)
        uv = (surface.uv[surface.faces[face]] * barycentric[..., None]).sum(1)
        strip = []
        for name, channels in CHANNELS.items():
            true = gt[name if name == "albedo" else f"{name}.V"].reshape(len(origins), -1)[:, :channels]
            found = look_up(getattr(materials, name), uv).reshape(len(uv), channels)
            errors[name].append(((found - true[ray]) ** 2).mean(1))
            for values, at in ((true[ray], ray), (found, ray)):
                image = np.zeros((len(origins), 3), np.float32)
                image[at] = linear_to_srgb(values) if name == "albedo" else values
                strip.append(image.reshape(*size, 3))
        if view < shown:
            rows.append(np.concatenate(strip, 1))
    Image.fromarray((np.concatenate(rows).clip(0, 1) * 255).astype(np.uint8)).save(picture)
    return {f"mse_{name}": float(np.concatenate(values).mean()) for name, values in errors.items()}


def run(folder: Path, preset: Preset, geometry: str, seed: int, kept: Path, picture: Path) -> dict:
    """One run of stage 2, and its scores."""
    capture, test = load_capture(folder), load_capture(folder, transforms="transforms_test.json")
    test.object_center, test.object_radius = capture.object_center, capture.object_radius
    device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
    rays = PixelRays.from_capture(capture, preset.max_pixels_per_photo, False, device)
    surface, environment, seconds = stage_1(folder, capture, rays, preset, geometry, seed, kept)
    wall, cpu = time.perf_counter(), time.process_time()
    materials = learn_materials(surface, environment, rays, preset.material, seed=seed, device=device,
                                progress=lambda *_, **__: None, checkpoint=NoCheckpoint())
    out = {"stage_1_seconds": seconds, "seconds": time.perf_counter() - wall, "cpu_seconds": time.process_time() - cpu}
    return out | score(surface, materials, folder, capture, test, picture) | {"report": materials.report}


COLUMNS = ("mse_roughness", "mse_metallic", "mse_albedo", "seconds", "cpu_seconds")


def table(rows: list[dict]) -> str:
    """Markdown; a failed run shows its message."""
    lines = ["| capture | geometry | preset | ablation | " + " | ".join(COLUMNS) + " | materials |",
             "|---" * (5 + len(COLUMNS)) + "|"]
    for row in rows:
        cells = [f"{row[c]:.4g}" if c in row else row.get("error", "") for c in COLUMNS]
        found = [f"{m['share']:.2f}: {m['albedo']} r {m['roughness']} m {m['metallic']}"
                 for m in row.get("report", {}).get("materials", [])]
        lines.append("| " + " | ".join([row["capture"], row["geometry"], row["preset"], row["ablation"], *cells,
                                        "; ".join(found)]) + " |")
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("captures", nargs="+", type=Path)
    parser.add_argument("--preset", nargs="+", default=["balanced"], choices=list(PRESETS))
    parser.add_argument("--geometry", nargs="+", default=["true", "own"], choices=["true", "own"])
    parser.add_argument("--ablation", nargs="+", default=["full"], choices=list(ABLATIONS))
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--threads", type=int, default=os.cpu_count())
    parser.add_argument("--out", type=Path, default=Path("out/benchmarks/materials"))
    arguments = parser.parse_args()
    torch.set_num_threads(arguments.threads)
    numba.set_num_threads(min(arguments.threads, numba.config.NUMBA_NUM_THREADS))
    arguments.out.mkdir(parents=True, exist_ok=True)
    rows = []
    for folder, name, geometry, ablation in itertools.product(arguments.captures, arguments.preset, arguments.geometry,
                                                              arguments.ablation):
        run_name = f"{folder.name}-{name}-{geometry}-{arguments.seed}"
        other_light = "_infinite" if "environment" in ABLATIONS[ablation] else ""
        stage = f"{run_name}{other_light}.stage_1.pt"
        file = arguments.out / f"{run_name}-{ablation.replace(' ', '_')}.json"
        if not file.is_file():
            row = {"capture": folder.name, "geometry": geometry, "preset": name, "ablation": ablation,
                   "seed": arguments.seed, "threads": arguments.threads}
            try:
                row |= run(folder, ablated(ablation, PRESETS[name]), geometry, arguments.seed, arguments.out / stage,
                           file.with_suffix(".png"))
            except NepError as error:
                row["error"] = str(error)
            part = file.with_suffix(".part")
            part.write_text(json.dumps(row, indent=1), encoding="utf-8")
            part.replace(file)
        rows.append(json.loads(file.read_text(encoding="utf-8")))
        print(table(rows[-1:]).splitlines()[-1], flush=True)
    print("\n" + table(rows))


if __name__ == "__main__":
    main()
