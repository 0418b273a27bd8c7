"""The environment field prefiltered for cones: levels of means over ever wider discs of directions, for every shell.

What is averaged is what can be seen from the centre: each node's weight w = transmittance from the centre * opacity,
and w times its radiance. A mean of opacities would let light leak through walls, because what stands behind an opaque
node would count again for its transparent neighbours. Each level is then turned back into opacities that composite, from
the centre, to just these mean weights; off the centre they give the parallax.

The discs are true discs on the sphere, also at the poles: a convolution that turns with the azimuth, done by FFT along
the columns, one pair of rows at a time.
"""

from __future__ import annotations

import math

import torch

from blender_nep.ops.environment_cones import level_list, march_cones

WIDE_ROWS = 16
"""Rows of the coarsest levels; wider discs than its texels are stored at this size."""
WIDE_DEGREES = (14.0, 22.0, 33.0, 48.0, 68.0, 90.0)
"""Angular radii of the levels beyond the pyramid, degrees."""


def disc_mean(values: torch.Tensor, radius: float) -> torch.Tensor:
    """Means over discs of angular `radius` (radians) of values [K, H, W, C] on cell-centred equirectangular shells."""
    _, rows, columns, _ = values.shape
    theta = (torch.arange(rows, dtype=torch.float64) + 0.5) * math.pi / rows
    phi = torch.arange(columns, dtype=torch.float64) * 2 * math.pi / columns
    z, sine = theta.cos(), theta.sin()
    cosine = z[:, None, None] * z[None, :, None] + sine[:, None, None] * sine[None, :, None] * phi.cos()
    angle = torch.acos(cosine.clamp(-1, 1))
    texel = math.pi / rows
    kernel = ((radius - angle) / texel + 0.5).clamp(0, 1) * sine[None, :, None]
    kernel = kernel / kernel.sum(dim=(1, 2), keepdim=True)
    spectrum = torch.fft.rfft(values.double(), dim=2)
    # the kernel is even in azimuth: its spectrum is real
    mixed = torch.einsum("tsf,ksfc->ktfc", torch.fft.rfft(kernel, dim=2).real.to(spectrum.dtype), spectrum)
    return torch.fft.irfft(mixed, n=columns, dim=2).to(values.dtype)


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
    before = weighted[0] / weighted[0, ..., 3:4].clamp(min=1e-9)
    for k in range(len(weighted)):
        mean = torch.where(weight[k] > 1e-6, weighted[k] / weight[k].clamp(min=1e-9), before)
        mean[..., 3] = 1
        opacity = torch.where(left[k] > 1e-4, (weight[k] / left[k].clamp(min=1e-4)).clamp(0, 1), torch.ones_like(left[k]))
        out[k] = mean * opacity
        before = mean
    out[-1] = before
    return out


def _halve(values: torch.Tensor) -> torch.Tensor:
    shells, rows, columns, channels = values.shape
    return values.reshape(shells, rows // 2, 2, columns // 2, 2, channels).mean(dim=(2, 4))


class PrefilteredEnvironment:
    """A frozen environment field that answers cones.

    raw [K, H, W, 4] (raw density, log radiance); coverage [K, H, W] in 0..1. Lives on the CPU.
    """

    def __init__(self, raw: torch.Tensor, coverage: torch.Tensor, density_gain: float, outer_radius: float) -> None:
        raw, coverage = raw.detach().cpu(), coverage.detach().cpu()
        self.outer_radius, self.spacing = outer_radius, math.log(outer_radius) / (raw.shape[0] - 1)
        opacity = 1 - torch.exp(-torch.nn.functional.softplus(raw[..., :1]) * density_gain * self.spacing)
        opacity[-1] = 1  # the sky closes every ray
        radiance = raw[..., 1:].clamp(-9, 9).exp()
        nodes = torch.cat([radiance, torch.ones_like(opacity), coverage[..., None]], -1)
        values = visible_weights(opacity) * nodes
        self.levels, self.radii = [opacity * nodes], [0.5 * math.pi / raw.shape[1]]
        while values.shape[1] % 2 == 0 and values.shape[1] // 2 >= WIDE_ROWS:
            radius = math.pi / values.shape[1]
            values = _halve(disc_mean(values, math.sqrt(radius**2 - self.radii[-1] ** 2)))
            self.levels.append(from_weights(values))
            self.radii.append(radius)
        for degrees in WIDE_DEGREES:
            radius = math.radians(degrees)
            if radius > 1.2 * self.radii[-1]:
                self.levels.append(from_weights(disc_mean(values, radius)))
                self.radii.append(radius)
        self.levels = level_list(self.levels)

    def query(self, origins: torch.Tensor, directions: torch.Tensor, half_angle: torch.Tensor,
              near: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Mean radiance [n, 3] and coverage [n] in cones."""
        out = march_cones(self.levels, self.radii, origins, directions, near, half_angle, self.outer_radius,
                          self.spacing)
        return out[:, :3], out[:, 3].clamp(0, 1)
