"""Tiny captures made on the spot, and rooms that learn nothing, for the tests of the job around them."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace

import blender_nep  # noqa: F401  # isort: skip  # before torch: it sets how OpenMP threads wait
import numpy as np
import OpenEXR
import pytest
import torch
import trimesh
from PIL import Image

from blender_nep.errors import LearningError
from blender_nep.job.stages import Rooms
from blender_nep.materials.training import Materials
from blender_nep.surface.extraction import Surface

CENTER, RADIUS = np.array([0.3, -0.2, 0.5]), 0.8


def look_at(position: np.ndarray, target: np.ndarray) -> np.ndarray:
    """A camera-to-world matrix [4, 4] at `position`, looking at `target`, z up."""
    back = (position - target) / np.linalg.norm(position - target)
    right = np.cross([0.0, 0.0, 1.0], back)
    right /= np.linalg.norm(right)
    matrix = np.eye(4)
    matrix[:3, :4] = np.stack([right, np.cross(back, right), back, position], 1)
    return matrix


def write_exr(path: Path, pixels: np.ndarray) -> None:
    """[H, W, 3 or 4] as half float, or a dict of channels."""
    channels = pixels if isinstance(pixels, dict) else {"RGBA"[: pixels.shape[-1]]: pixels.astype(np.float16)}
    OpenEXR.File({"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}, channels).write(str(path))


@dataclass
class TinyCapture:
    """A folder with a capture of a grey ball of radius `ball` before a gradient, and its transforms as a dict."""

    folder: Path
    meta: dict

    def save(self) -> Path:
        """Write transforms.json and return the folder."""
        (self.folder / "transforms.json").write_text(json.dumps(self.meta))
        return self.folder


@pytest.fixture
def make_capture(tmp_path):
    """make_capture(views, size, suffix, masks, alpha, bounds) -> TinyCapture, already written."""

    def make(views=6, size=24, suffix=".exr", masks=False, alpha=False, bounds=True, ball=0.5, name="capture"):
        folder = tmp_path / name
        (folder / "images").mkdir(parents=True)
        (folder / "masks").mkdir()
        focal = 1.2 * size
        meta = {"w": size, "h": size, "fl_x": focal, "fl_y": focal, "cx": size / 2, "cy": size / 2, "frames": []}
        if bounds:
            meta |= {"object_center": CENTER.tolist(), "object_radius": RADIUS}
        y, x = np.mgrid[:size, :size] + 0.5
        for i in range(views):
            turn, rise = 2.4 * i, 0.9 * np.sin(1.7 * i)
            position = CENTER + 2.5 * np.array([np.cos(turn) * np.cos(rise), np.sin(turn) * np.cos(rise), np.sin(rise)])
            matrix = look_at(position, CENTER)
            local = np.stack([(x - size / 2) / focal, -(y - size / 2) / focal, -np.ones_like(x)], -1)
            direction = local @ matrix[:3, :3].T
            direction /= np.linalg.norm(direction, axis=-1, keepdims=True)
            along = ((CENTER - position) * direction).sum(-1)
            covered = np.linalg.norm(position + along[..., None] * direction - CENTER, axis=-1) < ball
            photo = np.where(covered[..., None], 0.4, 0.2 + 0.1 * direction).astype(np.float32)
            coverage = covered.astype(np.float32)
            frame = {"file_path": f"images/{i:03d}{suffix}", "transform_matrix": matrix.tolist()}
            if alpha:
                photo = np.concatenate([photo * coverage[..., None], coverage[..., None]], -1)
            if suffix == ".exr":
                write_exr(folder / frame["file_path"], photo)
            else:
                Image.fromarray(np.round(255 * photo).astype(np.uint8)).save(folder / frame["file_path"])
            if masks:
                frame["mask_path"] = f"masks/{i:03d}.png"
                Image.fromarray(np.round(255 * coverage).astype(np.uint8)).save(folder / frame["mask_path"])
            meta["frames"].append(frame)
        tiny = TinyCapture(folder, meta)
        tiny.save()
        return tiny

    return make


class BallRooms(Rooms):
    """Rooms that know the answer, a grey ball, and count steps instead of learning."""

    def __init__(self, steps: int = 5, on_step=None, fail: Exception | None = None) -> None:
        self.steps, self.on_step, self.fail = steps, on_step, fail
        self.entered: list[str] = []
        self.started_at: dict[str, int] = {}

    def _loop(self, room, progress, checkpoint) -> int:
        self.entered.append(room)
        state = checkpoint.load() or {"step": 0}
        self.started_at[room] = state["step"]
        for step in range(state["step"], self.steps):
            if self.on_step is not None:
                self.on_step(room, step)
            if checkpoint.due():
                checkpoint.save({"step": step, "array": np.arange(3), "tensor": torch.ones(2)})
            progress(step + 1, self.steps, 1.0 / (step + 1))
        return self.steps

    def learn_fields(self, rays, preset, *, seed, device, progress, checkpoint, surface=None):
        self._loop("fields_learning", progress, checkpoint)
        if self.fail is not None:
            raise self.fail
        report = {"loss": 0.1, "skipped": {"nothing": "a test"}}
        return SimpleNamespace(object_field="ball", environment=GreyLight(), report=report)

    def pack_fields(self, fields):
        return {"report": fields.report}

    def unpack_fields(self, state, preset, device):
        return SimpleNamespace(object_field="ball", environment=GreyLight(), report=state["report"])

    def extract_surface(self, object_field, preset):
        self.entered.append("surface")
        if object_field != "ball":
            raise LearningError("no surface")
        return ball_surface(), {"faces": 80}

    def load_surface(self, mesh, capture, preset):
        return ball_surface()

    def learn_materials(self, surface, environment, rays, preset, *, seed, device, progress, checkpoint):
        self._loop("material_learning", progress, checkpoint)
        return Materials(**ball_textures(), report={"texels": 64})


class GreyLight:
    """A uniform environment."""

    coverage = 1.0

    def equirect(self, height):
        return torch.full((height, 2 * height, 3), 0.5), torch.full((height, 2 * height), self.coverage)


def ball_surface() -> Surface:
    """A ball of radius 0.5 / RADIUS in the unit frame, with UVs of a kind."""
    mesh = trimesh.creation.icosphere(2, 0.5 / RADIUS)
    unit = np.asarray(mesh.vertices) / (0.5 / RADIUS)
    uv = 0.5 + 0.4 * unit[:, :2]
    return Surface(np.asarray(mesh.vertices), np.asarray(mesh.faces, np.int64), unit, uv)


def ball_textures() -> dict[str, np.ndarray]:
    """Textures 16 x 16 that change from row to row and column to column."""
    ramp = np.linspace(0, 1, 16, dtype=np.float32)
    albedo = np.stack(np.broadcast_arrays(ramp[:, None], ramp[None, :], np.float32(0.25)), -1).astype(np.float32)
    flat = np.ones((16, 16), np.float32)
    return {"albedo": albedo, "roughness": flat * ramp[:, None], "metallic": flat * ramp, "confidence": flat}
