"""Prefilters the environment field for cones. Each level holds, for every shell, means over wider discs of directions.

The means are taken of what is seen from the center: of each node's weight w = transmittance from the center * opacity, and
of w times its radiance. Means of opacities would let light leak through walls: what stands behind an opaque node would count
again for its transparent neighbors. Each level is then turned back into opacities. Composited from the center, they give
exactly these mean weights; from other points, they give the parallax.

The weights are integrated on a grid finer than the field's, because the mean of an exponential between two nodes is not the
mean of its values at the nodes. The discs are true discs on the sphere, also at the poles. So each pair of rows has its own
convolution kernel over the azimuth; the convolutions are done by FFT along the columns.
"""

from __future__ import annotations

import math

import numpy as np
import torch

from blender_nep.fields.environment.grid import resample
from blender_nep.ops.environment.cones import Levels, composite_cones
from blender_nep.ops.environment.segments import contracted_length, contracted_radius, far_share
from blender_nep.ops.environment.spherical_grid import COLOR_LIMIT
from blender_nep.ops.environment.weights import from_weights, weights_from_center

FINER_ROWS = 2
"""Rows of the finest level divided by rows of the field; the same for columns."""
RATIO = 1.6
"""Angular radius of each level divided by that of the level before it, up to DENSE_FROM."""
DENSE_FROM = math.radians(6)
"""From this angular radius on, there are two levels for each RATIO. A cone between two levels gets a mixture of both, which
blurs its edge. The blur is large for wide cones, and their levels are small."""
LEAST_TEXELS = 3
"""A level has fewer rows only if its disc's radius is larger than this number of texels."""
SMALLEST_ROWS = 48
"""No level is halved to fewer rows than this: the interpolation of a coarse level would blur the edge of its discs."""
TENT_RADIUS = math.sqrt(2 / 3)
"""Radius, in texels, of the disc that has the same variance as bilinear interpolation. Bilinear interpolation has the
variance 1/6 for each axis; a disc of radius r has r^2 / 4."""


def disc_mean(values: torch.Tensor, radius: float) -> torch.Tensor:
    """Means over discs of angular `radius` (radians) of values [K, H, W, C] on cell-centered equirectangular shells."""
    _, rows, columns, _ = values.shape
    theta = (torch.arange(rows, dtype=values.dtype) + 0.5) * math.pi / rows
    phi = torch.arange(columns, dtype=values.dtype) * 2 * math.pi / columns
    z, sine = theta.cos(), theta.sin()
    cosine = z[:, None, None] * z[None, :, None] + sine[:, None, None] * sine[None, :, None] * phi.cos()
    angle = torch.acos(cosine.clamp(-1, 1))
    texel = math.pi / rows
    kernel = ((radius - angle) / texel + 0.5).clamp(0, 1) * sine[None, :, None]
    kernel = kernel / kernel.sum(dim=(1, 2), keepdim=True)
    # the kernel is even in azimuth, so its spectrum is real
    kernel = torch.fft.rfft(kernel, dim=2).real.permute(2, 0, 1).contiguous()
    spectrum = torch.view_as_real(torch.fft.rfft(values, dim=2)).permute(2, 1, 0, 3, 4)
    mixed = torch.bmm(kernel, spectrum.reshape(len(kernel), rows, -1)).reshape(spectrum.shape)
    return torch.fft.irfft(torch.view_as_complex(mixed.permute(2, 1, 0, 3, 4).contiguous()), n=columns, dim=2)


def _halve(values: torch.Tensor) -> torch.Tensor:
    shells, rows, columns, channels = values.shape
    return values.reshape(shells, rows // 2, 2, columns // 2, 2, channels).mean(dim=(2, 4))


def _divisible(values: torch.Tensor) -> bool:
    return values.shape[1] % 4 == 0 and values.shape[1] // 2 >= SMALLEST_ROWS


def _add_detail(values: torch.Tensor, detail: torch.Tensor, far: torch.Tensor) -> np.ndarray:
    """Multiply the radiance of values [K, H, W, 5] by what the color detail [D, 2 D, 3] means; return what is finer.

    far [K] in 0..1 is the share of the detail in each shell. A value gets the mean of the factor over its texel, because the
    shells vary little within a texel. The result [D, 2 D, 3] is the factor divided by its interpolated means. Without color
    detail (D = 0), it is 1 everywhere.
    """
    rows, parts = values.shape[1], len(detail) // values.shape[1]
    if not len(detail):
        return np.ones((2 * rows, 4 * rows, 3), np.float32)
    exponent = detail.detach().cpu().float()
    for shell in far.nonzero()[:, 0].tolist():
        factor = (far[shell] * exponent).clamp(-COLOR_LIMIT, COLOR_LIMIT).exp()
        mean = factor.reshape(rows, parts, 2 * rows, parts, 3).mean(dim=(1, 3))
        values[shell, ..., :3] *= mean
    # the last shell, the sky, has the full share
    return (factor / resample(mean[None].expand(2, -1, -1, -1), 2, len(factor))[0]).contiguous().numpy()


class PrefilteredEnvironment:
    """A learned environment field, as far as photos show it, that can be queried with cones.

    raw [K, H, W, 4] is raw density and log radiance; coverage [K, H, W] is in 0..1; detail [D, 2 D, 3] is added to the log
    radiance of all shells, D a multiple of FINER_ROWS H, or 0. The levels are kept on the CPU.
    """

    def __init__(
        self,
        raw: torch.Tensor,
        coverage: torch.Tensor,
        detail: torch.Tensor,
        density_gain: float,
        contraction_radius: float,
    ) -> None:
        length = contracted_length(contraction_radius)
        u = torch.linspace(0, length, raw.shape[0])
        spacing = length / (raw.shape[0] - 1)
        self.shell_radii, self.far = contracted_radius(u, contraction_radius), far_share(u, contraction_radius)
        if not len(detail):
            self.far = torch.zeros_like(self.far)
        values = weights_from_center(raw, coverage, density_gain, spacing, FINER_ROWS * raw.shape[1])
        # A node that no photo shows holds no light of the scene: it began so, or the smoothness prior filled it in.
        values[..., :3] *= values[..., 4:] / values[..., 3:4].clamp_min(1e-9)
        self.detail = _add_detail(values, detail, self.far)
        # a shell that is nowhere visible from the center needs no lookup
        self.occupied = values[..., 3].amax((1, 2)) > 1e-4
        radius = TENT_RADIUS * math.pi / values.shape[1]
        levels, self.radii = [from_weights(values)], [radius]
        while radius < math.pi / 2:
            radius *= RATIO if len(self.radii) == 1 or radius < DENSE_FROM else math.sqrt(RATIO)
            while _divisible(values) and radius > LEAST_TEXELS * math.pi / values.shape[1]:
                values = _halve(values)
            texel = math.pi / values.shape[1]
            stored = disc_mean(values, math.sqrt(radius**2 - (TENT_RADIUS * texel) ** 2)).clamp(min=0)
            levels.append(from_weights(stored))
            self.radii.append(radius)
        self.levels = Levels.joined(levels)
        self.dense_from = max(sum(radius < DENSE_FROM for radius in self.radii), 1)

    def query(
        self, origins: torch.Tensor, directions: torch.Tensor, half_angle: torch.Tensor, near: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Mean radiance [n, 3] and coverage [n] in 0..1 in cones that begin at the distances near [n].

        origins, unit directions [n, 3], unit frame; half_angle [n] radians.
        """
        out = composite_cones(
            self.levels,
            self.radii,
            self.dense_from,
            self.detail,
            self.shell_radii,
            self.occupied,
            self.far,
            origins,
            directions,
            near,
            half_angle,
        )
        return out[:, :3], out[:, 3].clamp(0, 1)
