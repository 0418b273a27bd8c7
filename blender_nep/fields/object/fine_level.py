"""The finest level of the SDF: a spline whose coefficients exist only where there is relief.

It holds relief that the other levels' cells are too wide for (`relief.find_relief`). Elsewhere it would only hold noise.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn

from blender_nep.ops.object.bspline_bricks import BRICK, Bricks, bricks_along_axis, sample_bricks

REACH = 3
"""The level is complete so many of its cells around the places of relief, along each axis. At most 3 (`FineLevel.at`)."""


class FineLevel(nn.Module):
    """A level of `cells` cells along an axis. It is 0 everywhere at first, and has room for the coefficients of `bricks`."""

    def __init__(self, cells: int, bricks: int = 0, device: torch.device | None = None) -> None:
        super().__init__()
        self.cells = cells
        self.slot: Tensor
        self.register_buffer("slot", torch.full((bricks_along_axis(cells),) * 3, -1, dtype=torch.int32, device=device))
        self.coefficients = nn.Parameter(torch.zeros(bricks, BRICK, BRICK, BRICK, device=device))

    @classmethod
    @torch.no_grad()
    def at(cls, points: Tensor, cells: int, before: FineLevel | None = None) -> FineLevel:
        """A level that is complete up to REACH of its `cells` from points [n, 3].

        It also has all bricks of the level `before`, with their coefficients.
        """
        level = cls(cells, 0, points.device)
        count = level.slot.shape[0]
        first = ((points + 1) * (0.5 * cells)).floor().long()
        wanted = torch.zeros_like(level.slot, dtype=torch.bool)
        # the first and the last tap that matter, and one between them: no brick lies between two of these
        steps = torch.tensor([-REACH, 1, 2 + REACH], device=points.device)
        for step in torch.cartesian_prod(steps, steps, steps):
            wanted[tuple(((first + step) // BRICK).clamp(0, count - 1).T)] = True
        if before is not None:
            wanted |= before.slot >= 0
        bricks = int(wanted.sum())
        level.slot[wanted] = torch.arange(bricks, dtype=torch.int32, device=points.device)
        level.coefficients = nn.Parameter(level.coefficients.new_zeros(bricks, BRICK, BRICK, BRICK))
        if before is not None:
            old = before.slot >= 0
            level.coefficients[level.slot[old].long()] = before.coefficients[before.slot[old].long()]
        return level

    @property
    def bricks(self) -> Bricks:
        """The spline, for `ops.object.bspline_bricks`."""
        return Bricks(self.slot, self.coefficients, self.cells)

    @torch.no_grad()
    def complete_at(self, points: Tensor) -> Tensor:
        """Whether all coefficients exist that the spline needs at points [n, 3]: [n] bool."""
        ones = self.bricks._replace(coefficients=torch.ones_like(self.coefficients))
        return sample_bricks(ones, points)[:, 0] > 1 - 1e-4
