"""A folder of a batch as `blender-nep batch` leaves it, with small made-up assets."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

SPOTS = {
    (1, 0, 0): (1, 0, 0),
    (0, 1, 0): (0, 1, 0),
    (0, 0, 1): (0, 0, 1),
    (-1, 0, 0): (0, 1, 1),
    (0, -1, 0): (1, 0, 1),
    (0, 0, -1): (1, 1, 0),
}
"""{direction in the capture's frame: color of the light from there}. From elsewhere comes hardly any light."""


def write_batch(folder: Path, objects: list[dict[str, Any]], **keys: Any) -> Path:
    """Write FOLDER/batch.json with these entries, which need only what differs from a finished object."""
    usual = {"state": "done", "stage": None, "fraction": 1.0, "eta_s": None, "warnings": [], "error": None}
    told = {
        "format": 1,
        "preset": "balanced",
        "started": "2026-11-23T10:00:00+00:00",
        "updated": "2026-11-23T11:30:00+02:00",
        "objects": [usual | found for found in objects],
    }
    folder.mkdir(exist_ok=True)
    (folder / "batch.json").write_text(json.dumps(told | keys), encoding="utf-8")
    return folder


def write_mirror_ball(folder: Path, **report: Any) -> Path:
    """Write the asset of a mirror ball of radius 1 in the light of `SPOTS`, into a new folder."""
    folder.mkdir(parents=True)
    # not at the top: Blender, which runs files of tests as scripts, would import torch in two seconds and not use it
    import trimesh

    from blender_nep.asset.export import TexturedMesh, write_exr, write_glb

    ball = trimesh.creation.icosphere(4)
    vertices = np.asarray(ball.vertices)
    small = np.ones((4, 4), np.float32)
    textures = {"albedo": np.full((4, 4, 3), 0.95, np.float32), "roughness": 0 * small, "metallic": small}
    mesh = TexturedMesh(vertices, np.asarray(ball.faces), vertices, np.zeros((len(vertices), 2)), textures)
    write_glb(folder / "asset.glb", mesh)
    write_exr(folder / "environment.exr", spotted_light(64))
    Image.fromarray(picture(800, 400)).save(folder / "preview.png")
    (folder / "log.txt").write_text("done\n", encoding="utf-8")
    materials = [
        {"share": 0.25, "albedo": [0.2, 0.0, 1.0], "roughness": 0.3, "metallic": 0.0},
        {"share": 0.75, "albedo": [1.0, 0.5, 0.0], "roughness": 0.05, "metallic": 1.0},
    ]
    stages = {
        "fields_learning": {"held_out_error": [0.07, 0.0379, None]},
        "surface": {"faces": 23998},
        "material_learning": {"residual": 0.0426},
    }
    told = {"seconds_total": 354.4, "peak_memory_mb": 1735.2, "materials": materials, "stages": stages, "warnings": []}
    (folder / "report.json").write_text(json.dumps(told | report), encoding="utf-8")
    return folder


def spotted_light(height: int) -> np.ndarray:
    """An environment map [height, 2 height, 3] with the spots, as docs/conventions.md places directions."""
    up = math.pi * (0.5 - (np.arange(height) + 0.5) / height)
    around = 2 * math.pi * (0.5 - (np.arange(2 * height) + 0.5) / (2 * height))
    flat = np.cos(up)[:, None]
    toward = np.stack(
        [flat * np.cos(around), flat * np.sin(around), np.broadcast_to(np.sin(up)[:, None], (height, 2 * height))], -1
    )
    light = np.full((height, 2 * height, 3), 0.02, np.float32)
    for direction, color in SPOTS.items():
        light[toward @ np.array(direction) > math.cos(math.radians(16))] = color
    return light


def picture(width: int, height: int) -> np.ndarray:
    """A picture [height, width, 3] uint8 about as busy as a photo."""
    y, x = np.mgrid[:height, :width] / height
    waves = [0.5 + 0.3 * np.sin(8 * x + 5 * y * k) + 0.2 * np.sin(40 * x * y + k) for k in range(3)]
    noise = np.random.default_rng(0).normal(0, 0.02, (height, width, 3))
    return np.clip(255 * (np.stack(waves, -1) + noise), 0, 255).astype(np.uint8)
