"""Stage 2 against ground truth: presets and ablations on rendered captures, on the true mesh or on our own.

    python -m benchmarks.materials CAPTURE... [--geometry true own] [--ablation NAME...] [--out out/benchmarks/materials]

A capture is a folder with `transforms_test.json`, `gt_mesh.ply` and `gt/NNN.exr` (albedo, roughness.V, metallic.V, mask.V);
masks are ignored. Stage 1 is learned once for each capture, preset, geometry and seed, and kept beside the results. Every
run writes one JSON file, and a picture of the materials beside the truth, and is skipped when that exists; a run that
fails is a row with its message. Ends with a table.
"""

from __future__ import annotations

import itertools
import time
from functools import partial
from pathlib import Path

import numpy as np
import OpenEXR
import torch
import trimesh
from PIL import Image

from benchmarks.geometry import Body, camera_rays, true_mesh
from benchmarks.harness import learning_parser, markdown, resumed, use_threads, with_changes
from blender_nep.capture import PixelRays, load_capture
from blender_nep.capture.capture import Capture
from blender_nep.capture.images import linear_to_srgb
from blender_nep.checkpoints import NoCheckpoint, load_state, save_state
from blender_nep.fields_learning import learn_fields
from blender_nep.material_learning import Materials, learn_materials
from blender_nep.presets import PRESETS, Preset
from blender_nep.rooms import Rooms
from blender_nep.surface import Surface, extract_surface, load_surface
from blender_nep.texels import look_up

ABLATIONS: dict[str, dict[str, dict]] = {
    "full": {},
    "no cones": {"material": {"use_cones": False}},
    "few samples": {"material": {"samples": 1500}},
    "few samples, 256 + 128 rays": {"material": {"samples": 1500, "use_cones": False, "diffuse_cones": 256,
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


def stage_1(folder: Path, capture: Capture, rays: PixelRays, preset: Preset, geometry: str, seed: int, kept: Path
            ) -> tuple[Surface, object, float]:
    """The surface, F_e, and the seconds that both took."""
    device = rays.radiance.device
    if kept.is_file():
        state = load_state(kept)
        surface, _ = Rooms().unpack_surface(state["surface"])
        return surface, Rooms().unpack_fields(state["fields"], preset, device).environment, state["seconds"]
    kept.parent.mkdir(parents=True, exist_ok=True)
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
    picture.parent.mkdir(parents=True, exist_ok=True)
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


def cells(row: dict) -> list:
    """One line of the table; a failed run shows its message."""
    scores = [float(row[c]) if c in row else row.get("error", "") for c in COLUMNS]
    found = [f"{m['share']:.2f}: {m['albedo']} r {m['roughness']} m {m['metallic']}"
             for m in row.get("report", {}).get("materials", [])]
    return [row["capture"], row["geometry"], row["preset"], row["ablation"], *scores, "; ".join(found)]


def main() -> None:
    parser = learning_parser(__doc__, ABLATIONS, "out/benchmarks/materials")
    parser.add_argument("--geometry", nargs="+", default=["true", "own"], choices=["true", "own"])
    arguments = parser.parse_args()
    use_threads(arguments.threads)
    header, rows = ["capture", "geometry", "preset", "ablation", *COLUMNS, "materials"], []
    for folder, name, geometry, ablation in itertools.product(arguments.captures, arguments.preset, arguments.geometry,
                                                              arguments.ablation):
        row = {"capture": folder.name, "geometry": geometry, "preset": name, "ablation": ablation,
               "seed": arguments.seed, "threads": arguments.threads}
        run_name = f"{folder.name}-{name}-{geometry}-{arguments.seed}"
        other_light = "_infinite" if "environment" in ABLATIONS[ablation] else ""
        file = arguments.out / f"{run_name}-{ablation.replace(' ', '_')}.json"
        preset = with_changes(PRESETS[name], ABLATIONS[ablation])
        kept = arguments.out / f"{run_name}{other_light}.stage_1.pt"
        rows.append(cells(resumed(file, row, partial(run, folder, preset, geometry, arguments.seed, kept,
                                                     file.with_suffix(".png")))))
        print(markdown(header, rows[-1:]).splitlines()[-1], flush=True)
    print("\n" + markdown(header, rows))


if __name__ == "__main__":
    main()
