"""Places samples on rays near a surface, and composites the samples of an SDF. The bodies are Numba's on the CPU, and plain
torch elsewhere.

The weights are those of NeuS (Wang et al. 2021): alpha = 1 - phi(f_{i+1}) / phi(f_i), where phi is the logistic function.
The rays are independent, so results do not depend on the number of threads.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch
from numba import prange
from torch.autograd.function import once_differentiable

from blender_nep.ops.compilation import kernel
from blender_nep.ops.precision import at_least_float32

_LEAST_OPACITY = 1e-6
"""The mean distance of a ray is divided by at least this opacity."""
_LARGEST_EXPONENT = 700.0
"""exp(700) is finite in float64. Between two samples that both lie deeper, alpha is 0 in the Numba body. Samples in a band
around the surface (`fields.object.volume_rendering.BAND`) never lie so deep."""
_BLOCK = 256
"""So many rays use the same work arrays, because making arrays takes time."""


class Composited(NamedTuple):
    """The samples of m rays, composited along each ray."""

    opacity: torch.Tensor
    """[m] 0..1: the sum of the weights"""
    depth: torch.Tensor
    """[m] weighted mean distance along the ray"""
    gradient: torch.Tensor
    """[m, 3] weighted sum of the SDF's gradients"""
    eikonal: torch.Tensor
    """[m] mean of (|gradient of the SDF| - 1)^2 over the samples"""


@kernel(parallel=True, error_model="numpy")
def _place(spans, count, jitter, t):
    """Fill t [m, samples + 1], as `place_samples`."""
    last = t.shape[1] - 1
    for ray in prange(t.shape[0]):
        total = 0.0
        for span in range(count[ray]):
            total += max(spans[ray, span, 1] - spans[ray, span, 0], 0.0)
        span, before = 0, 0.0
        length = max(spans[ray, 0, 1] - spans[ray, 0, 0], 0.0)
        for i in range(last + 1):
            if i == 0:
                u = 0.0
            elif i == last:
                u = total
            else:
                u = (i - 1 + jitter[ray]) / (last - 1) * total
            while u > before + length and span + 1 < count[ray]:
                before += length
                span += 1
                length = max(spans[ray, span, 1] - spans[ray, span, 0], 0.0)
            t[ray, i] = spans[ray, span, 0] + (u - before)


def place_samples(
    spans: torch.Tensor, count: torch.Tensor, samples: int, jitter: torch.Tensor, body: str = "auto"
) -> torch.Tensor:
    """Ordered distances [m, samples + 1], spread evenly over each ray's spans.

    spans [m, s, 2] are starts and ends of distances along the rays, of which the first count [m] are used; jitter [m] is in
    0..1. body: "auto" (Numba on the CPU, torch elsewhere), "numba" or "torch".
    """
    if body == "numba" or (body == "auto" and spans.device.type == "cpu"):
        t = spans.new_empty(len(spans), samples + 1)
        _place(spans.contiguous().numpy(), count.numpy(), jitter.to(spans.dtype).numpy(), t.numpy())
        return t
    length = (spans[..., 1] - spans[..., 0]).clamp(min=0)
    length = length * (torch.arange(spans.shape[1], device=spans.device) < count[:, None])
    end = length.cumsum(1)
    inner = (torch.arange(samples - 1, device=spans.device) + jitter[:, None]) / (samples - 1)
    u = torch.cat([torch.zeros_like(inner[:, :1]), inner, torch.ones_like(inner[:, :1])], 1) * end[:, -1:]
    which = (u[..., None] > end[:, None, :]).sum(-1).clamp(max=spans.shape[1] - 1)
    which = torch.minimum(which, (count[:, None] - 1).long())
    before = (end - length).gather(1, which)
    return spans[..., 0].gather(1, which) + (u - before)


def neus_weights(sdf: torch.Tensor, sharpness: float) -> torch.Tensor:
    """Weights [n, k] of the k sections between k + 1 ordered samples of the SDF [n, k + 1].

    alpha is computed from differences of log-sigmoids, and so it is exact deep inside the object. There both phi vanish, and
    the published (p - n + 1e-5) / (p + 1e-5) tends to 1 although alpha does not.
    """
    log_phi = torch.nn.functional.logsigmoid(sharpness * sdf)
    delta = (log_phi[:, 1:] - log_phi[:, :-1]).clamp(max=0)
    before = torch.nn.functional.pad(torch.cumsum(delta[:, :-1], 1), (1, 0))
    return before.exp() * -torch.expm1(delta)


@kernel(parallel=True, error_model="numpy")
def _composite(field, inverse, t, out):
    """Fill out [m, 6]: opacity, depth, gradient and eikonal of `Composited`.

    field [m, k + 1, 4] are values and gradients of the SDF, inverse [m, k + 1] = 1 / phi - 1, t [m, k + 1] distances.
    """
    last = field.shape[1] - 1
    for ray in prange(field.shape[0]):
        clear, before, opacity, depth = 1.0, 0.0, 0.0, 0.0  # sums are in float64
        gx, gy, gz, eikonal = 0.0, 0.0, 0.0, 0.0
        for i in range(last + 1):
            weight = 0.0
            if i < last and inverse[ray, i + 1] > inverse[ray, i]:
                alpha = (inverse[ray, i + 1] - inverse[ray, i]) / (1 + inverse[ray, i + 1])
                weight = clear * alpha
                clear *= (1 + inverse[ray, i]) / (1 + inverse[ray, i + 1])
            share = (before + weight) / 2
            x, y, z = field[ray, i, 1], field[ray, i, 2], field[ray, i, 3]
            gx += share * x
            gy += share * y
            gz += share * z
            depth += share * t[ray, i]
            opacity += weight
            eikonal += (np.sqrt(x * x + y * y + z * z) - 1) ** 2
            before = weight
        out[ray, 0], out[ray, 1] = opacity, depth / max(opacity, _LEAST_OPACITY)
        out[ray, 2], out[ray, 3], out[ray, 4], out[ray, 5] = gx, gy, gz, eikonal / (last + 1)


@kernel(parallel=True, error_model="numpy")
def _composite_backward(field, inverse, t, sharpness, out, grad, field_grad):
    """Fill field_grad [m, k + 1, 4], the adjoint of `_composite`. out, grad [m, 6]: its result, and the gradient of that."""
    last = field.shape[1] - 1
    for block in prange((field.shape[0] + _BLOCK - 1) // _BLOCK):
        # Section i lies between samples i and i + 1. It is entry i + 1 of `weight` and `slope`. No entry is read before
        # it is written. So the ends need the conditions below.
        weight, slope = np.empty(last + 1), np.empty(last + 1)  # slope: the gradient by log(1 - alpha)
        behind = np.empty(last)  # the transmittance behind a section
        value = np.empty(last + 1)  # what a sample costs if its share is 1
        for ray in range(block * _BLOCK, min((block + 1) * _BLOCK, field.shape[0])):
            opaque = max(out[ray, 0], _LEAST_OPACITY)
            g_depth = grad[ray, 1] / opaque
            g_opacity = grad[ray, 0] - (g_depth * out[ray, 1] if out[ray, 0] > _LEAST_OPACITY else 0.0)
            clear = 1.0
            for i in range(last + 1):
                value[i] = g_depth * t[ray, i]
                for axis in range(3):
                    value[i] += grad[ray, 2 + axis] * field[ray, i, 1 + axis]
                if i < last:
                    ratio = min((1 + inverse[ray, i]) / (1 + inverse[ray, i + 1]), 1.0)
                    weight[i + 1] = clear * (1 - ratio)
                    clear *= ratio
                    behind[i] = clear
            later = 0.0
            for i in range(last - 1, -1, -1):
                price = g_opacity + (value[i] + value[i + 1]) / 2
                slope[i + 1] = later - price * behind[i] if inverse[ray, i + 1] >= inverse[ray, i] else 0.0
                later += price * weight[i + 1]
            for i in range(last + 1):
                front, back = (slope[i] if i > 0 else 0.0), (slope[i + 1] if i < last else 0.0)
                field_grad[ray, i, 0] = sharpness * (inverse[ray, i] / (1 + inverse[ray, i])) * (front - back)
                share = ((weight[i] if i > 0 else 0.0) + (weight[i + 1] if i < last else 0.0)) / 2
                x, y, z = field[ray, i, 1], field[ray, i, 2], field[ray, i, 3]
                length = np.sqrt(x * x + y * y + z * z)
                pull = 2 * grad[ray, 5] / (last + 1) * (length - 1) / length if length > 0 else 0.0
                field_grad[ray, i, 1] = share * grad[ray, 2] + pull * x
                field_grad[ray, i, 2] = share * grad[ray, 3] + pull * y
                field_grad[ray, i, 3] = share * grad[ray, 4] + pull * z


class _Composite(torch.autograd.Function):
    @staticmethod
    def forward(ctx, field, t, sharpness):
        inverse = (-sharpness * field[..., 0].double()).clamp(max=_LARGEST_EXPONENT).exp()
        out = field.new_empty(len(field), 6)
        _composite(field.detach().numpy(), inverse.detach().numpy(), t.detach().numpy(), out.numpy())
        ctx.save_for_backward(field, inverse, t, out)
        ctx.sharpness = sharpness
        return out

    @staticmethod
    @once_differentiable
    def backward(ctx, grad):
        field, inverse, t, out = (value.detach() for value in ctx.saved_tensors)
        field_grad = torch.empty_like(field)
        _composite_backward(
            field.numpy(),
            inverse.numpy(),
            t.numpy(),
            ctx.sharpness,
            out.numpy(),
            grad.contiguous().numpy(),
            field_grad.numpy(),
        )
        return field_grad, None, None


def composite(field: torch.Tensor, t: torch.Tensor, sharpness: float, body: str = "auto") -> Composited:
    """Composite the samples of m rays.

    field [m, k + 1, 4]: values and gradients of the SDF at the ordered distances t [m, k + 1], which get no gradient;
    sharpness in 1 / unit of the SDF. Gradient and distance of a section are the means of its two ends. body: "auto" (Numba
    on the CPU, torch elsewhere), "numba" or "torch".
    """
    field, t = at_least_float32(field, t.detach())
    if body == "numba" or (body == "auto" and field.device.type == "cpu"):
        out = _Composite.apply(field.contiguous(), t.contiguous(), float(sharpness))
        return Composited(out[:, 0], out[:, 1], out[:, 2:5], out[:, 5])
    weights = neus_weights(field[..., 0], sharpness)
    opacity = weights.sum(1)
    share = 0.5 * torch.nn.functional.pad(weights, (1, 0)) + 0.5 * torch.nn.functional.pad(weights, (0, 1))
    gradient = (share[..., None] * field[..., 1:4]).sum(1)
    depth = (share * t).sum(1) / opacity.clamp(min=_LEAST_OPACITY)
    return Composited(opacity, depth, gradient, ((field[..., 1:4].norm(dim=-1) - 1) ** 2).mean(1))
