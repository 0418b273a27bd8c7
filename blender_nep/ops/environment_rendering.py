"""Differentiable volume rendering of the environment field: chooses the Numba or the torch body by device."""

from __future__ import annotations

import torch

from blender_nep.ops import environment_rendering_numba as kernels
from blender_nep.ops import environment_rendering_torch as reference
from blender_nep.ops.environment_segments import scale_invariant_segments
from blender_nep.ops.precision import at_least_float32

MAXIMUM_STEPS = 512


class _RenderNumba(torch.autograd.Function):
    @staticmethod
    def forward(ctx, raw, origins, directions, segments, offsets, jitter, infinite, settings):
        log_radius, density_gain, gradient_near, transmittance_limit, depth_limit = settings
        keep = ctx.needs_input_grad[0]
        n, m = len(origins), int(offsets[-1]) if keep else 0
        grid = raw.detach().numpy()
        radiance, transmittance = raw.new_empty((n, 3)), raw.new_empty(n)
        live = torch.empty(n, dtype=torch.int64)
        cells = torch.empty((m, 3), dtype=torch.int32)
        fractions, local = raw.new_empty((m, 3)), raw.new_empty((m, 7))
        kernels.march(
            grid,
            origins.numpy(),
            directions.numpy(),
            *(part.numpy() for part in segments),
            offsets.numpy(),
            jitter.numpy(),
            infinite.numpy(),
            log_radius,
            density_gain,
            gradient_near,
            transmittance_limit,
            depth_limit,
            keep,
            radiance.numpy(),
            transmittance.numpy(),
            live.numpy(),
            cells.numpy(),
            fractions.numpy(),
            local.numpy(),
        )
        ctx.shape = grid.shape
        ctx.records = (offsets, live, cells, fractions, local, radiance.clone(), transmittance.clone())
        return radiance, transmittance

    @staticmethod
    def backward(ctx, g_radiance, g_transmittance):
        offsets, live, cells, fractions, local, radiance, transmittance = ctx.records
        g_samples = local.new_empty((len(local), 4))
        used = torch.zeros(len(local), dtype=torch.uint8)
        kernels.sample_gradients(
            offsets.numpy(),
            live.numpy(),
            local.numpy(),
            radiance.numpy(),
            transmittance.numpy(),
            g_radiance.contiguous().numpy(),
            g_transmittance.contiguous().numpy(),
            g_samples.numpy(),
            used.numpy(),
        )
        order, start = kernels.order_by_row(used.numpy(), cells.numpy(), ctx.shape[1])
        g_raw = local.new_zeros(ctx.shape)
        for parity in (0, 1):
            kernels.scatter_rows(order, start, cells.numpy(), fractions.numpy(), g_samples.numpy(), g_raw.numpy(), parity)
        return g_raw, None, None, None, None, None, None, None


def render_environment(
    raw: torch.Tensor,
    origins: torch.Tensor,
    directions: torch.Tensor,
    t_near: torch.Tensor,
    t_far: torch.Tensor,
    *,
    outer_radius: float,
    relative_step: float,
    density_gain: float,
    jitter: torch.Tensor | None = None,
    gradient_near: float = 0.0,
    transmittance_limit: float = 1e-4,
    depth_limit: float = 1e-5,
    body: str = "auto",
) -> tuple[torch.Tensor, torch.Tensor]:
    """Radiance and transmittance of ray segments through a spherical grid; differentiable in the grid.

    Args:
        raw: [K, H, W, 4] raw density (softplus, times density_gain, per unit of dt / |x|) and log radiance.
        origins, directions: [n, 3]; t_near, t_far: [n], t_far may be inf: the outermost shell then closes the ray.
        relative_step: longest step as a fraction of the distance from the origin.
        jitter: [n] in [0, 1), or None for the middle of each step.
        gradient_near: below this distance from the camera, gradients are scaled by (t / gradient_near)^2 [Philip and
            Deschaintre 2023, "Floaters No More"]: samples are denser there and views fewer.
        transmittance_limit, depth_limit: what the Numba body may neglect.
        body: "auto" (Numba on the CPU, torch elsewhere), "numba" or "torch".

    Returns:
        radiance [n, 3] premultiplied, transmittance [n].
    """
    raw, origins, directions, t_near, t_far = at_least_float32(raw, origins, directions, t_near, t_far)
    with torch.no_grad():
        segments = scale_invariant_segments(origins, directions, t_near, t_far, outer_radius)
        infinite = torch.isinf(t_far)
        slots = torch.ceil(segments[3] / relative_step).long().clamp_max(MAXIMUM_STEPS)
        offsets = torch.zeros(len(origins) + 1, dtype=torch.int64, device=raw.device)
        torch.cumsum(slots + infinite.long(), 0, out=offsets[1:])
        if jitter is None:
            jitter = torch.full_like(t_near, 0.5)
    log_radius = float(torch.log(torch.tensor(outer_radius, dtype=torch.float64)))
    if body == "torch" or (body == "auto" and raw.device.type != "cpu"):
        return reference.render(
            raw, origins, directions, *segments, offsets, jitter, infinite, log_radius, density_gain, gradient_near
        )
    settings = (log_radius, density_gain, gradient_near, transmittance_limit, depth_limit)
    return _RenderNumba.apply(
        raw, origins.contiguous(), directions.contiguous(), segments, offsets, jitter.contiguous(), infinite, settings
    )
