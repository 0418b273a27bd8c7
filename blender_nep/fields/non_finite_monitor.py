"""Counts steps of learning whose loss or gradient is not finite. Such steps are left out; too many of them are an error."""

from __future__ import annotations

from collections.abc import Iterable

import torch

from blender_nep.errors import LearningError
from blender_nep.optimizers import Optimizer

PATIENCE = 20
"""After this many steps in a row that are not finite, learning ends with an error. It is not in the preset: a learning that
works has no such steps, and a learning that does not work has thousands."""
LARGEST_LOSS = 1e6
"""A larger tone-mapped loss counts as infinite."""


class NonFiniteMonitor:
    """Counts the steps whose loss or gradient is not finite.

    Such a step must change nothing, because Adam's moments would keep a NaN for ever.
    """

    def __init__(self) -> None:
        self.in_a_row = 0
        """Number of steps that were left out since the last usable step."""
        self.left_out = 0
        """Number of all steps that were left out so far."""

    def record(self, usable: bool) -> bool:
        """Count the step if it is not `usable`, and return `usable`.

        Raises LearningError after PATIENCE steps in a row that were not usable.
        """
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
        """The counts, for a checkpoint."""
        return {"in_a_row": self.in_a_row, "left_out": self.left_out}

    def load(self, state: dict) -> None:
        """Go on from `state`."""
        self.in_a_row, self.left_out = state["in_a_row"], state["left_out"]


def usable_loss(loss: float) -> bool:
    """Whether the loss is finite and not larger than LARGEST_LOSS."""
    return abs(loss) < LARGEST_LOSS  # False for NaN


def usable_gradients(optimizers: Iterable[Optimizer]) -> bool:
    """Whether all gradients of the optimizers' parameters are finite.

    Only their sums are checked: one NaN or infinity makes the sum not finite. Sums in float64 are slow. So they are taken
    only if a sum in the gradients' own precision is not finite.
    """
    parameters = (parameter for optimizer in optimizers for parameter in optimizer.parameters)
    gradients = [p.grad for p in parameters if p.grad is not None]

    def finite_sums(dtype: torch.dtype | None) -> bool:
        return bool(torch.isfinite(torch.stack([g.sum(dtype=dtype) for g in gradients])).all())

    return not gradients or finite_sums(None) or finite_sums(torch.float64)
