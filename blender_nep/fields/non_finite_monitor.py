"""Steps of learning whose loss or gradient is not finite: left out, counted, and given up on when there are too many."""

from __future__ import annotations

from collections.abc import Iterable

import torch

from blender_nep.errors import LearningError

PATIENCE = 20
"""Steps in a row that may fail before learning is given up. Not in the preset: a learning that works has none, and one that
does not has thousands."""
LARGEST_LOSS = 1e6
"""A tone-mapped loss beyond it is as good as infinite."""


class NonFiniteMonitor:
    """Records of every step whether its loss and gradient were finite.

    A step that is not finite must change nothing: Adam's moments would keep a NaN for ever.
    """

    def __init__(self) -> None:
        self.in_a_row = 0
        """Steps that were left out since the last one that was not."""
        self.left_out = 0
        """Steps that were left out so far."""

    def record(self, usable: bool) -> bool:
        """Counts a step that was not `usable`; returns `usable`. Raises LearningError after PATIENCE such steps in a row."""
        self.in_a_row = 0 if usable else self.in_a_row + 1
        self.left_out += not usable
        if self.in_a_row >= PATIENCE:
            raise LearningError(
                "The photometric loss or its gradient is not finite.",
                "Check the photos for extreme values and the object sphere with `blender-nep info`.",
                "learning.not_finite",
            )
        return usable

    def state(self) -> dict:
        """For a checkpoint."""
        return {"in_a_row": self.in_a_row, "left_out": self.left_out}

    def load(self, state: dict) -> None:
        """Go on from `state`."""
        self.in_a_row, self.left_out = state["in_a_row"], state["left_out"]


def usable_loss(loss: float) -> bool:
    """Whether a loss is a number that one can learn from."""
    return abs(loss) < LARGEST_LOSS  # False for NaN


def usable_gradients(optimisers: Iterable[torch.optim.Optimizer]) -> bool:
    """Whether all gradients of the optimisers' parameters are finite; by their sums, which one NaN or Inf spoils."""
    parameters = (p for optimiser in optimisers for group in optimiser.param_groups for p in group["params"])
    sums = [p.grad.sum(dtype=torch.float64) for p in parameters if p.grad is not None]
    return not sums or bool(torch.isfinite(torch.stack(sums)).all())
