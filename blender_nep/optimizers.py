"""The optimizers of the engine: Adam, and Adam for grids.

They are no subclasses of torch.optim.Optimizer, because the first object of that class imports torch's compiler. That takes
more than two CPU seconds in each process, and nothing here is compiled by it.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable
from typing import Any

import torch
from torch.optim.adam import adam

from blender_nep.ops.object.touched import touched_mean_square


class Optimizer(ABC):
    """Groups of parameters with their settings, and the moments of each parameter.

    parameters: tensors, or dicts with `params` and settings of their own. `settings` hold for what a group does not set
    itself. The settings of a group, such as `lr`, may be changed between two steps.
    """

    def __init__(self, parameters: Iterable[torch.Tensor] | Iterable[dict], **settings: object) -> None:
        parts: list = list(parameters)
        groups: list[dict] = parts if parts and isinstance(parts[0], dict) else [{"params": parts}]
        self.param_groups = [{**settings, **group, "params": list(group["params"])} for group in groups]
        self.moments: dict[torch.Tensor, dict[str, Any]] = {}

    @property
    def parameters(self) -> list[torch.Tensor]:
        """The parameters of all groups."""
        return [parameter for group in self.param_groups for parameter in group["params"]]

    def zero_grad(self) -> None:
        """Remove the gradients of all parameters."""
        for parameter in self.parameters:
            parameter.grad = None

    @abstractmethod
    def step(self) -> None:
        """Change each parameter that has a gradient."""

    def state(self) -> list[dict[str, Any]]:
        """The moments of each parameter, for a checkpoint; empty for a parameter that had no gradient yet.

        They are not copied.
        """
        return [self.moments.get(parameter, {}) for parameter in self.parameters]

    def load(self, state: list[dict[str, Any]]) -> None:
        """Go on from `state` of an optimizer with the same parameters."""
        for parameter, moments in zip(self.parameters, state, strict=True):
            if moments:
                self.moments[parameter] = {
                    name: value.to(parameter.device) if isinstance(value, torch.Tensor) else value
                    for name, value in moments.items()
                }


class Adam(Optimizer):
    """Adam (Kingma and Ba 2015), by torch's function, for parameters of one device in each group."""

    def __init__(
        self,
        parameters: Iterable[torch.Tensor] | Iterable[dict],
        lr: float = 1e-3,
        betas: tuple[float, float] = (0.9, 0.999),
        eps: float = 1e-8,
    ) -> None:
        super().__init__(parameters, lr=lr, betas=betas, eps=eps)

    @torch.no_grad()
    def step(self) -> None:
        for group in self.param_groups:
            learned = [p for p in group["params"] if p.grad is not None]
            moments = [self._moments_of(p) for p in learned]
            if learned:
                adam(
                    learned,
                    [p.grad for p in learned],
                    [one["mean"] for one in moments],
                    [one["square"] for one in moments],
                    [],
                    [one["step"] for one in moments],
                    fused=True,
                    amsgrad=False,
                    maximize=False,
                    weight_decay=0.0,
                    lr=group["lr"],
                    beta1=group["betas"][0],
                    beta2=group["betas"][1],
                    eps=group["eps"],
                )

    def _moments_of(self, parameter: torch.Tensor) -> dict[str, Any]:
        if parameter not in self.moments:
            self.moments[parameter] = {
                "step": torch.zeros((), device=parameter.device),
                "mean": torch.zeros_like(parameter),
                "square": torch.zeros_like(parameter),
            }
        return self.moments[parameter]


class UniformAdam(Optimizer):
    """Adam for grids, with one second moment for each tensor.

    Plain Adam gives each voxel a unit step of its own. So the noise in rarely seen voxels makes the surface rough. A single
    second moment for a level keeps the smoothness of the gradient field (AdamUniform, Nicolet et al. 2021, "Large Steps in
    Inverse Rendering of Geometry", sec. 4). Here it is the mean square of the touched entries; in the paper it is the
    maximum.

    The typical step of a touched entry is `lr` times `scale`, in the parameter's units. Each group of parameters may have a
    `scale` of its own; its default is 1.
    """

    def __init__(
        self, parameters: Iterable[torch.Tensor] | Iterable[dict], lr: float, betas: tuple[float, float] = (0.9, 0.99)
    ) -> None:
        super().__init__(parameters, lr=lr, betas=betas, scale=1.0)

    @torch.no_grad()
    def step(self) -> None:
        for group in self.param_groups:
            b1, b2 = group["betas"]
            for p in group["params"]:
                if p.grad is None:
                    continue
                if p not in self.moments:
                    self.moments[p] = {"step": 0, "mean": torch.zeros_like(p), "square": p.new_zeros(())}
                moments = self.moments[p]
                moments["step"] += 1
                step = moments["step"]
                moments["mean"].lerp_(p.grad, 1 - b1)
                moments["square"].lerp_(touched_mean_square(p.grad), 1 - b2)
                scale = (moments["square"] / (1 - b2**step)).sqrt().clamp(min=1e-20)
                length = group["scale"] * group["lr"] / (1 - b1**step) / scale
                p.addcmul_(moments["mean"], length, value=-1)
