"""Computes all scores of an asset that need no Cycles, against the ground truth of a rendered capture."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch

from benchmarks.row_files import read_row
from benchmarks.scoring import environment as fields
from benchmarks.scoring import geometry, light_map, materials, shading_normals
from benchmarks.scoring.asset_mesh import read_asset_mesh
from blender_nep.asset.export import NORMAL_MAP
from blender_nep.capture import PixelRays, load_capture
from blender_nep.capture.capture import Capture
from blender_nep.checkpoints import load_state
from blender_nep.fields.training import Fields
from blender_nep.job.device import choose_device
from blender_nep.job.stage_names import StageName
from blender_nep.presets import Preset

BACKGROUND_PIXELS = 40_000
"""Most pixels of a test photo. It does not depend on the preset, because the scores of presets must be comparable."""


def score_asset(folder: Path, asset: Path, preset: Preset, device: str, picture: Path) -> dict:
    """The scores of geometry, materials, light and F_e; {} for a capture without ground truth.

    F_e is scored only where the asset still has the checkpoint of stage 1. It is not scored for a turntable, because test
    views do not tell how the object stood in the room.
    """
    if not (folder / "gt_mesh.ply").is_file():
        return {}
    capture = load_capture(folder)
    test = geometry.load_test_views(folder, capture)
    surface, learned = read_asset_mesh(asset / "mesh.obj", capture), materials.read_materials(asset)
    out = {"faces": len(surface.faces), "texture_rows": len(learned.albedo)}
    out |= geometry.score(surface, folder, capture, test)
    map_file = asset / "textures" / f"{NORMAL_MAP}.exr"
    normal_map = next(iter(materials.read_channels(map_file).values())) if map_file.is_file() else None
    out |= shading_normals.score(surface, folder, capture, test, normal_map)
    out |= materials.score(surface, learned, folder, capture, test, picture)
    out |= light_map.score(folder, asset)
    kept = asset / "checkpoints" / f"{StageName.FIELDS_LEARNING}.done.pt"
    if kept.is_file() and not read_row(asset / "report.json")["scene"]["photos"].get("turntable", False):
        out["background_psnr"] = _background_psnr(folder, asset, kept, capture, test, preset, choose_device(device))
    return out


def _background_psnr(
    folder: Path, asset: Path, kept: Path, capture: Capture, test: Capture, preset: Preset, device: torch.device
) -> float:
    environment = Fields.from_state(load_state(kept)["result"], preset, device).environment
    report = read_row(asset / "report.json")
    # F_e has the unit frame, the exposure and the response curve of the job that learned it.
    learned, response = report["capture"], fields.response_of(report)
    for one in (capture, test):
        one.object_center, one.object_radius = np.array(learned["object_center"]), learned["object_radius"]
    rays = PixelRays.from_capture(test, BACKGROUND_PIXELS, False, device).with_exposure(learned["exposure"])
    own, truth = fields.exposures_differ(folder), geometry.true_mesh(folder, capture)
    return fields.background_psnr(environment, rays, truth, own, response)
