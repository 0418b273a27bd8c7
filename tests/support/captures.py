"""Tiny captures made on the spot."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import OpenEXR

CENTER, RADIUS = np.array([0.3, -0.2, 0.5]), 0.8


def look_at(position: np.ndarray, target: np.ndarray) -> np.ndarray:
    """A camera-to-world matrix [4, 4] at `position`, looking at `target`, z up."""
    back = (position - target) / np.linalg.norm(position - target)
    right = np.cross([0.0, 0.0, 1.0], back)
    right /= np.linalg.norm(right)
    matrix = np.eye(4)
    matrix[:3, :4] = np.stack([right, np.cross(back, right), back, position], 1)
    return matrix


def camera_ring(
    count: int, elevations: tuple[float, ...], size: int, focal: float
) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Cameras 3.2 from the origin, which look at it from these elevations (degrees) in turn.

    For each: its position [3], camera-to-world matrix [4, 4], and the unit directions [size^2, 3] of its pixels' rays.
    """
    row, column = np.mgrid[:size, :size] + 0.5
    local = np.stack([(column - size / 2) / focal, (size / 2 - row) / focal, -np.ones_like(row)], -1).reshape(-1, 3)
    local /= np.linalg.norm(local, axis=1, keepdims=True)
    for k in range(count):
        around, up = 2.4 * k, np.radians(elevations[k % len(elevations)])
        position = 3.2 * np.array([np.cos(around) * np.cos(up), np.sin(around) * np.cos(up), np.sin(up)])
        matrix = look_at(position, np.zeros(3))
        yield position, matrix, local @ matrix[:3, :3].T


def write_exr(path: Path, pixels: np.ndarray) -> None:
    """Write pixels [H, W, 3 or 4] as half floats, or a dict of channels as they are."""
    channels = pixels if isinstance(pixels, dict) else {"RGBA"[: pixels.shape[-1]]: pixels.astype(np.float16)}
    OpenEXR.File({"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}, channels).write(str(path))


@dataclass
class TinyCapture:
    """A folder with a capture of a gray ball of radius `ball` before a gradient, and its transforms as a dict."""

    folder: Path
    meta: dict

    def save(self) -> Path:
        """Write transforms.json and return the folder."""
        (self.folder / "transforms.json").write_text(json.dumps(self.meta))
        return self.folder
