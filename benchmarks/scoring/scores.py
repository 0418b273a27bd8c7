"""Computes all scores of an asset that need no Cycles, against the ground truth of a rendered capture."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

from benchmarks.scoring import environment as fields
from benchmarks.scoring import geometry, materials, shading_normals
from benchmarks.suite.harness import read_row
from blender_nep.asset.export import NORMAL_MAP
from blender_nep.capture import PixelRays, load_capture
from blender_nep.capture.capture import Capture
from blender_nep.checkpoints import load_state
from blender_nep.fields.training import Fields
from blender_nep.job.device import choose_device
from blender_nep.job.stage_names import StageName
from blender_nep.presets import Preset
from blender_nep.surface.mesh_file import load_surface

BACKGROUND_PIXELS = 40_000
"""Most pixels of a test photo. It does not depend on the preset, because the scores of presets must be comparable."""


def score_asset(folder: Path, asset: Path, preset: Preset, device: str, picture: Path) -> dict:
    """The scores of geometry, materials and F_e; {} for a capture without ground truth.

    F_e is scored only where the asset still has the checkpoint of stage 1.
    """
    if not (folder / "gt_mesh.ply").is_file():
        return {}
    capture = load_capture(folder)
    test = geometry.load_test_views(folder, capture)
    surface, learned = load_surface(asset / "mesh.obj", capture, preset.surface), materials.read_materials(asset)
    surface = replace(surface, faces=file_faces(asset / "mesh.obj"))
    out = {"faces": len(surface.faces), "texture_rows": len(learned.albedo)}
    out |= geometry.score(surface, folder, capture, test)
    map_file = asset / "textures" / f"{NORMAL_MAP}.exr"
    normal_map = next(iter(materials.read_channels(map_file).values())) if map_file.is_file() else None
    shaded = replace(surface, normals=file_normals(asset / "mesh.obj"))
    out |= shading_normals.score(shaded, folder, capture, test, normal_map)
    out |= materials.score(surface, learned, folder, capture, test, picture)
    kept = asset / "checkpoints" / f"{StageName.FIELDS_LEARNING}.done.pt"
    if kept.is_file():
        out["background_psnr"] = _background_psnr(folder, asset, kept, capture, test, preset, choose_device(device))
    return out


def file_faces(path: Path) -> np.ndarray:
    """The faces [F, 3] of an asset's mesh.obj, as the file turns them: a reader of given meshes may turn them outward."""
    with open(path, encoding="utf-8") as file:
        faces = [[int(corner.split("/")[0]) for corner in line.split()[1:]] for line in file if line.startswith("f ")]
    return np.array(faces, np.int64) - 1


def file_normals(path: Path) -> np.ndarray:
    """The normals [V, 3] of an asset's mesh.obj, whose vertices and normals have the same order."""
    with open(path, encoding="utf-8") as file:
        return np.loadtxt([line[3:] for line in file if line.startswith("vn ")])


def _background_psnr(
    folder: Path, asset: Path, kept: Path, capture: Capture, test: Capture, preset: Preset, device: torch.device
) -> float:
    environment = Fields.from_state(load_state(kept)["result"], preset, device).environment
    learned = read_row(asset / "report.json")["capture"]  # F_e has the unit frame and exposure of the job that learned it
    for one in (capture, test):
        one.object_center, one.object_radius = np.array(learned["object_center"]), learned["object_radius"]
    rays = PixelRays.from_capture(test, BACKGROUND_PIXELS, False, device).with_exposure(learned["exposure"])
    return fields.background_psnr(environment, rays, geometry.true_mesh(folder, capture), fields.exposures_differ(folder))
