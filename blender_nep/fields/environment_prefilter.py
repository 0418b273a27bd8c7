"""The environment field prefiltered for cones: levels of means over ever wider discs of directions, for every shell.

What is averaged is what can be seen from the centre: each node's weight w = transmittance from the centre * opacity,
and w times its radiance. A mean of opacities would let light leak through walls, because what stands behind an opaque
node would count again for its transparent neighbours. Each level is then turned back into opacities that composite, from
the centre, to just these mean weights; off the centre they give the parallax.

The weights are integrated on a grid finer than the field's: the mean of an exponential between two nodes is not the
mean of its values there. The discs are true discs on the sphere, also at the poles: a convolution that turns with the
azimuth, done by FFT along the columns, one pair of rows at a time.
"""

from __future__ import annotations

import math

import torch

from blender_nep.fields.environment_grid import resample
from blender_nep.ops.environment_cones import composite_cones, level_list

FINER_ROWS = 2
"""Rows (and columns) of the finest level for each of the field's."""
FINER_SHELLS = 4
"""Radial steps in which the weights of one shell spacing are integrated."""
RATIO = 1.6
"""Angular radius of each level over that of the level before it."""
SMALLEST_ROWS = 12
TENT_RADIUS = math.sqrt(2 / 3)
"""Radius, in texels, of the disc with the variance of bilinear interpolation (a tent has 1/6 an axis, a disc r^2 / 4)."""


def disc_mean(values: torch.Tensor, radius: float) -> torch.Tensor:
    """Means over discs of angular `radius` (radians) of values [K, H, W, C] on cell-centred equirectangular shells."""
    _, rows, columns, _ = values.shape
    theta = (torch.arange(rows, dtype=values.dtype) + 0.5) * math.pi / rows
    phi = torch.arange(columns, dtype=values.dtype) * 2 * math.pi / columns
    z, sine = theta.cos(), theta.sin()
    cosine = z[:, None, None] * z[None, :, None] + sine[:, None, None] * sine[None, :, None] * phi.cos()
    angle = torch.acos(cosine.clamp(-1, 1))
    texel = math.pi / rows
    kernel = ((radius - angle) / texel + 0.5).clamp(0, 1) * sine[None, :, None]
    kernel = kernel / kernel.sum(dim=(1, 2), keepdim=True)
    # the kernel is even in azimuth: its spectrum is real
    kernel = torch.fft.rfft(kernel, dim=2).real.permute(2, 0, 1).contiguous()
    spectrum = torch.view_as_real(torch.fft.rfft(values, dim=2)).permute(2, 1, 0, 3, 4)
    mixed = torch.bmm(kernel, spectrum.reshape(len(kernel), rows, -1)).reshape(spectrum.shape)
    return torch.fft.irfft(torch.view_as_complex(mixed.permute(2, 1, 0, 3, 4).contiguous()), n=columns, dim=2)


def visible_weights(opacity: torch.Tensor) -> torch.Tensor:
    """Compositing weights [K, ...] from the centre of opacities [K, ...] of shells, first shell innermost."""
    clear = torch.cumprod(1 - opacity, 0)
    return opacity * torch.cat([torch.ones_like(clear[:1]), clear[:-1]])


def from_weights(weighted: torch.Tensor) -> torch.Tensor:
    """Opacities that composite to given weights: [K, ..., 5] (w radiance, w, w coverage) -> the same premultiplied by
    opacity. Where nothing is left to see, a shell is opaque and goes on with the colour before it."""
    weight = weighted[..., 3:4]
    left = 1 - torch.cat([torch.zeros_like(weight[:1]), weight.cumsum(0)[:-1]])
    out = torch.empty_like(weighted)
    before = weighted.sum(0)
    for k in range(len(weighted)):
        mean = torch.where(weight[k] > 1e-6, weighted[k] / weight[k].clamp(min=1e-6), before)
        mean[..., 3] = 1
        opacity = torch.where(left[k] > 1e-4, (weight[k] / left[k].clamp(min=1e-4)).clamp(0, 1), torch.ones_like(left[k]))
        out[k] = mean * opacity
        before = mean
    out[-1] = before
    return out


def weights_from_centre(raw: torch.Tensor, coverage: torch.Tensor, density_gain: float, spacing: float) -> torch.Tensor:
    """What each shell contributes to the view from the centre: (w radiance, w, w coverage) [K, H', W', 5].

    raw [K, H, W, 4], coverage [K, H, W]; spacing of the shells in log |x|. Radial integrals are taken in FINER_SHELLS
    steps a spacing, and each step's weight is shared between the two shells beside it.
    """
    shells, rows = raw.shape[0], raw.shape[1] * FINER_ROWS
    nodes = resample(torch.cat([raw, coverage[..., None]], -1), shells, rows)
    out = nodes.new_zeros(nodes.shape[:3] + (5,))
    passed = nodes.new_ones(nodes.shape[1:3])
    for k in range(shells - 1):
        for step in range(FINER_SHELLS):
            f = (step + 0.5) / FINER_SHELLS
            value = torch.lerp(nodes[k], nodes[k + 1], f)
            depth = torch.nn.functional.softplus(value[..., 0]) * (density_gain * spacing / FINER_SHELLS)
            weight = -torch.expm1(-depth) * passed
            passed = passed * torch.exp(-depth)
            value = torch.cat([value[..., 1:4].clamp(-9, 9).exp(), torch.ones_like(value[..., :1]), value[..., 4:]], -1)
            value = weight[..., None] * value
            out[k] += (1 - f) * value
            out[k + 1] += f * value
    sky = torch.cat([nodes[-1, ..., 1:4].clamp(-9, 9).exp(), torch.ones_like(passed)[..., None], nodes[-1, ..., 4:]], -1)
    out[-1] += passed[..., None] * sky
    return out


def _halve(values: torch.Tensor) -> torch.Tensor:
    shells, rows, columns, channels = values.shape
    return values.reshape(shells, rows // 2, 2, columns // 2, 2, channels).mean(dim=(2, 4))


def _divisible(values: torch.Tensor) -> bool:
    return values.shape[1] % 4 == 0 and values.shape[1] // 2 >= SMALLEST_ROWS


class PrefilteredEnvironment:
    """A frozen environment field that answers cones.

    raw [K, H, W, 4] (raw density, log radiance); coverage [K, H, W] in 0..1. Lives on the CPU.
    """

    def __init__(self, raw: torch.Tensor, coverage: torch.Tensor, density_gain: float, outer_radius: float) -> None:
        raw, coverage = raw.detach().cpu().float(), coverage.detach().cpu().float()
        spacing = math.log(outer_radius) / (raw.shape[0] - 1)
        self.shell_radii = torch.exp(torch.arange(raw.shape[0]) * spacing)
        values = weights_from_centre(raw, coverage, density_gain, spacing)
        radius = TENT_RADIUS * math.pi / values.shape[1]
        levels, self.radii = [from_weights(values)], [radius]
        while radius < math.pi / 2:
            radius *= RATIO
            while _divisible(values) and radius > 3 * math.pi / values.shape[1]:
                values = _halve(values)
            texel = math.pi / values.shape[1]
            stored = disc_mean(values, math.sqrt(radius**2 - (TENT_RADIUS * texel) ** 2)).clamp(min=0)
            while _divisible(stored) and radius > 2.5 * math.pi / stored.shape[1]:
                stored = _halve(stored)
            levels.append(from_weights(stored))
            self.radii.append(radius)
        # a shell that no level gives any weight needs no lookup
        self.occupied = torch.stack([level[..., 3].amax((1, 2)) for level in levels]).amax(0) > 1e-4
        self.levels = level_list(levels)

    def query(self, origins: torch.Tensor, directions: torch.Tensor, half_angle: torch.Tensor,
              near: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Mean radiance [n, 3] and coverage [n] in cones."""
        out = composite_cones(self.levels, self.radii, self.shell_radii, self.occupied, origins, directions, near,
                              half_angle)
        return out[:, :3], out[:, 3].clamp(0, 1)
