"""Resamples and pads the spherical grid [K, H, W, C].

The axes are shells, cell-centered rows from +z to -z, periodic columns with atan2(y, x), and channels.
"""

from __future__ import annotations

import torch


def resample(raw: torch.Tensor, shells: int, rows: int) -> torch.Tensor:
    """The grid at another resolution [shells, rows, 2 rows, C], by trilinear interpolation, periodic in the columns."""
    old_rows = raw.shape[1]
    padded = pad_angles(raw).permute(3, 0, 1, 2)[None]
    device = raw.device
    k = torch.linspace(-1.0, 1.0, shells, device=device)
    j = ((torch.arange(rows, device=device) + 0.5) * (old_rows / rows) + 0.5) * (2 / (old_rows + 1)) - 1
    c = ((torch.arange(2 * rows, device=device) + 0.5) * (old_rows / rows) + 0.5) * (2 / (2 * old_rows + 1)) - 1
    place = torch.stack(torch.meshgrid(k, j, c, indexing="ij")[::-1], -1)[None].to(raw.dtype)
    sampled = torch.nn.functional.grid_sample(padded, place, mode="bilinear", align_corners=True)
    return sampled[0].permute(1, 2, 3, 0).contiguous()


def pad_angles(raw: torch.Tensor) -> torch.Tensor:
    """[K, H, W, C] -> [K, H + 2, W + 2, C]: one more row beyond each pole, and one more column at each side.

    A row beyond a pole is the row at the pole, turned by half a turn. The columns are periodic.
    """
    half = raw.shape[2] // 2
    rows = torch.cat([raw[:, :1].roll(half, 2), raw, raw[:, -1:].roll(half, 2)], 1)
    return torch.cat([rows[:, :, -1:], rows, rows[:, :, :1]], 2)
