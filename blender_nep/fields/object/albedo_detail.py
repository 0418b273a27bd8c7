"""Fine detail of the albedo c_a: multiresolution hash grids of logits (Mueller et al. 2022, "Instant Neural Graphics
Primitives", Sec. 3).

The MLP of the albedo sees positions through a smooth encoding. It cannot paint lines that are narrower than about 0.1 radii.
Without another place for such a line, learning carves it into the surface, because a tilted normal reflects darker light.
"""

from __future__ import annotations

import itertools

import torch
from torch import nn

CELLS = (32, 64, 128)
"""Cells along a side of the unit cube [-1, 1]^3, for each grid."""
ENTRIES = 1 << 17
"""Entries of a grid's hash table. The surface of an object crosses about 25,000 cells of the finest grid."""
_PRIMES = (1, 2_654_435_761, 805_459_861)


class AlbedoDetail(nn.Module):
    """Logits that are added to those of the albedo. They are 0 everywhere at first."""

    def __init__(self) -> None:
        super().__init__()
        self.logits = nn.Parameter(torch.zeros(len(CELLS) * ENTRIES, 3))

    def forward(self, points: torch.Tensor) -> torch.Tensor:
        """The logits [n, 3] at points [n, 3] of the unit cube, with a gradient to both: the sum of all grids, each
        interpolated between the eight corners of a cell."""
        cells = torch.tensor(CELLS, device=points.device)
        place = (points.clamp(-1, 1)[:, None] + 1) * 0.5 * cells[:, None]
        low = torch.minimum(place.detach().floor(), cells[:, None] - 1)
        share = (place - low)[:, :, None]
        corners = torch.tensor(list(itertools.product((0, 1), repeat=3)), device=points.device)
        weight = torch.where(corners.bool(), share, 1 - share).prod(-1)
        corner = low.long()[:, :, None] + corners
        x, y, z = (corner[..., k] * prime for k, prime in enumerate(_PRIMES))
        entry = (x ^ y ^ z) % ENTRIES + ENTRIES * torch.arange(len(CELLS), device=points.device)[:, None]
        return nn.functional.embedding_bag(entry.flatten(1), self.logits, per_sample_weights=weight.flatten(1), mode="sum")
