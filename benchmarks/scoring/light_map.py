"""Scores the light of an asset (`environment.exr`) against the true light of a rendered turntable (`light.exr`)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch

from benchmarks.row_files import read_row
from benchmarks.scoring.materials import read_channels
from blender_nep.tone_mapping import tone_map

TRUTH = "light.exr"
"""The true light, as `backend/synthetic.py --turntable` writes it. The same name is in its turntable.py."""
ROWS = 32
"""Both maps are compared with so many rows. Finer than that, light that no photo shows is not looked for."""


def score(folder: Path, asset: Path) -> dict[str, float | list[float]]:
    """How the asset's light agrees with that of the capture; {} if the capture does not tell it.

    Both are in the room as the object stood in the first photo. So nothing is said if the job did not learn from that photo.

    light_psnr: dB in tone-mapped space, over all directions. light_correlation: of the tone-mapped brightness.
    light_ratio: for each channel, the mean true radiance divided by the mean radiance that was found.
    """
    if not (folder / TRUTH).is_file():
        return {}
    first = [read_row(file)["frames"][0]["file_path"] for file in (folder / "transforms.json", asset / "cameras.json")]
    if Path(first[0]).name != Path(first[1]).name:
        return {}
    return compare(read_map(folder / TRUTH), read_map(asset / "environment.exr"))


def compare(true: np.ndarray, found: np.ndarray) -> dict[str, float | list[float]]:
    """The scores of `score` for two maps [h, 2 h, 3] of linear radiance, whose numbers of rows are multiples of ROWS."""
    true, found = coarse(true), coarse(found)
    polar = (np.arange(ROWS) + 0.5) / ROWS * np.pi
    weight = np.repeat(np.sin(polar)[:, None], 2 * ROWS, 1)
    weight /= weight.sum()
    toned = [tone_map(torch.from_numpy(light)).clamp(0, 1).numpy() for light in (true, found)]
    error = (weight[..., None] * (toned[0] - toned[1]) ** 2).sum() / 3
    means = [(weight[..., None] * light).sum((0, 1)) for light in (true, found)]
    covariance = np.cov(*(light.mean(-1).ravel() for light in toned), aweights=weight.ravel())
    return {
        "light_psnr": float(-10 * np.log10(max(error, 1e-12))),
        "light_correlation": float(covariance[0, 1] / max(np.sqrt(covariance[0, 0] * covariance[1, 1]), 1e-12)),
        "light_ratio": (means[0] / np.maximum(means[1], 1e-12)).tolist(),
    }


def coarse(light: np.ndarray) -> np.ndarray:
    """The map [h, 2 h, 3] as means of blocks, [ROWS, 2 ROWS, 3]. Raises ValueError if the rows are no multiple of ROWS."""
    rows = len(light)
    if rows % ROWS or light.shape[1] != 2 * rows:
        raise ValueError(f"a map of {rows} x {light.shape[1]} is not cut into {ROWS} x {2 * ROWS} blocks")
    block = rows // ROWS
    return light.reshape(ROWS, block, 2 * ROWS, block, 3).mean((1, 3)).astype(np.float32)


def read_map(path: Path) -> np.ndarray:
    """The radiance [h, 2 h, 3] of an OpenEXR file."""
    channels = read_channels(path)
    return channels["RGB"] if "RGB" in channels else np.stack([channels[name] for name in "RGB"], -1)
