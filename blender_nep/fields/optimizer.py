"""Adam for grids: one step size for a whole level instead of one for every voxel.

Plain Adam gives each voxel a unit step of its own. So the noise in rarely seen voxels makes the surface rough. A single
second moment for a level keeps the smoothness of the gradient field (AdamUniform, Nicolet et al. 2021, "Large Steps in
Inverse Rendering of Geometry", sec. 4). Here it is the mean square of the touched entries; in the paper it is the maximum.
"""

from __future__ import annotations

import torch

from blender_nep.ops.touched import touched_mean_square


class UniformAdam(torch.optim.Optimizer):
    """Adam with one second moment for each tensor.

    The typical step of a touched entry is `lr` times `scale`, in the parameter's units. Each group of parameters may have a
    `scale` of its own; its default is 1.
    """

    def __init__(self, params, lr: float, betas: tuple[float, float] = (0.9, 0.99)) -> None:
        super().__init__(params, {"lr": lr, "betas": betas, "scale": 1.0})

    @torch.no_grad()
    def step(self) -> None:  # type: ignore[override]  # no closure: the loss of a step is computed once
        for group in self.param_groups:
            b1, b2 = group["betas"]
            for p in group["params"]:
                if p.grad is None:
                    continue
                state = self.state[p]
                if not state:
                    state["step"], state["mean"] = 0, torch.zeros_like(p)
                    state["square"] = torch.zeros((), device=p.device)
                state["step"] += 1
                state["mean"].lerp_(p.grad, 1 - b1)
                state["square"].lerp_(touched_mean_square(p.grad), 1 - b2)
                scale = (state["square"] / (1 - b2 ** state["step"])).sqrt().clamp(min=1e-20)
                length = group["scale"] * group["lr"] / (1 - b1 ** state["step"]) / scale
                p.addcmul_(state["mean"], length, value=-1)
