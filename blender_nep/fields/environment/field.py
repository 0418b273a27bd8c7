"""The prefiltered environment field F_e: the radiance of everything outside the object's unit sphere, in the room's frame.

F_e is a spherical volume centered on the object, from the border |x| = 1 to infinity. Its shells lie at equal steps of the
contracted distance (`ops.environment.segments`): log |x| near the object, 1 / |x| far away. Every shell is an
equirectangular grid (rows from +z to -z, columns with atan2(y, x)). A node holds a raw density and the logarithm of linear
radiance. The density is softplus(raw density) per unit of the contracted distance. The outermost shell is the sky: it lies
at infinity, is opaque, and ends every ray that nothing else stops.

The color detail is one image of all directions from the center, finer than the shells. It is added to the logarithm of the
radiance of what is farther than the contraction radius. Near things get none: seen from other cameras, they lie in other
directions from the center than what is behind them. F_e gets the color detail only if the photos show much that is far: in a
small room it would learn noise.

The paper uses a Mip-NeRF for F_e, which can be queried with cones. Here the volume is prefiltered after the learning
(`prefilter`), so that cones of any width can be queried.
"""

from __future__ import annotations

import math

import numpy as np
import torch
from torch import nn

from blender_nep.fields.environment.grid import resample
from blender_nep.fields.environment.prefilter import PrefilteredEnvironment
from blender_nep.ops.environment.cones import accumulate_coverage
from blender_nep.ops.environment.rendering import EnvironmentVolume, RenderedSegments, render_environment
from blender_nep.ops.environment.samples import Medium, RaySamples, sample_rays
from blender_nep.ops.environment.segments import RaySegments, contracted_length, contracted_radius
from blender_nep.ops.environment.smoothness import add_total_variation_gradient
from blender_nep.presets import EnvironmentPreset
from blender_nep.profiling import profiled

FAR = 1000.0
"""Distance, in object radii, that stands for infinity where a finite number is needed."""


class EnvironmentField(nn.Module):
    """The environment field F_e; the module's docstring describes it.

    Args:
        preset: resolutions, priors and learning rate.
        mean_radiance: linear radiance with which the field starts; the photos' geometric mean is best.

    Raises ValueError for an unknown `preset.model`.
    """

    def __init__(self, preset: EnvironmentPreset, mean_radiance: float = 0.2):
        super().__init__()
        if preset.model not in ("field", "infinite", "none"):
            raise ValueError(f"unknown environment model {preset.model!r}: field, infinite or none")
        self.preset = preset
        raw = self._first_grid(math.log(max(mean_radiance, 1e-4)))
        self.raw = nn.Parameter(raw)
        self.detail = nn.Parameter(torch.zeros(0, 0, 3))
        self.register_buffer("coverage", torch.zeros(raw.shape[:3]))
        self.register_buffer("burnt", torch.zeros(raw.shape[:3]))
        self.far_share: torch.Tensor
        self.register_buffer("far_share", torch.tensor(-1.0))  # -1: not measured yet
        self._prefiltered: PrefilteredEnvironment | None = None

    def _first_grid(self, log_radiance: float | torch.Tensor) -> torch.Tensor:
        """The coarsest grid, nearly transparent, with one radiance everywhere."""
        shells, rows = self.resolutions[0]
        raw = torch.empty(shells, rows, 2 * rows, 4)
        raw[..., 0] = -20.0 if self.infinite else self.preset.initial_raw_density
        raw[..., 1:] = log_radiance
        return raw

    @property
    def infinite(self) -> bool:
        """Whether the environment is a 2-D map: only the sky shell counts, and every ray starts from the center."""
        return self.preset.model == "infinite"

    @property
    def known(self) -> bool:
        """Whether the photos show surroundings. If not (cut-outs), the field is black and transparent, its coverage is 0."""
        return self.preset.model != "none"

    @property
    def resolutions(self) -> list[tuple[int, int]]:
        """(shells, rows) of the grid, coarse to fine."""
        if not self.known:
            return [(2, 2)]
        return [(2 if self.infinite else shells, rows) for shells, rows in self.preset.resolutions]

    @property
    def distortion_cost(self) -> float:
        """The cost of the distortion. It is 0 with a color detail.

        With both, the object of a scene at night lost its shape (docs/lab/environment-field.md).
        """
        return 0.0 if len(self.detail) else self.preset.distortion

    @property
    def detail_decided(self) -> bool:
        """Whether `decide_detail` was called."""
        return bool(self.far_share >= 0)

    @property
    def level(self) -> int:
        """Index of the present grid in `resolutions`."""
        return self.resolutions.index((self.raw.shape[0], self.raw.shape[1]))

    @property
    def longest_step(self) -> float:
        """Longest step along a ray, in contracted distance."""
        return self.preset.march_step * contracted_length(self.preset.contraction_radius) / (self.raw.shape[0] - 1)

    def render(
        self,
        origins: torch.Tensor,
        directions: torch.Tensor,
        t_near: torch.Tensor,
        t_far: torch.Tensor,
        half_angle: torch.Tensor | float = 0.0,
        generator: torch.Generator | None = None,
    ) -> RenderedSegments:
        """Volume-render ray segments; differentiable in the field's parameters.

        Args:
            origins, directions: [n, 3], unit frame, directions of unit length.
            t_near, t_far: [n] ends of the segment. With t_far = inf, the ray ends in the sky. For a camera, t_near must be
                at least `preset.camera_near`.
            half_angle: of the pixel's cone, radians. It is not used, because pixels are narrower than a node. For wide
                cones there is `query_cone`.
            generator: with a generator (learning), samples are jittered; with None, they lie in the middle of each step.

        The transmittance is at most `preset.transmittance_limit` where t_far is inf.
        """
        return self._rendered(self.raw, origins, directions, t_near, t_far, generator)

    @profiled("F_e march")
    def _rendered(
        self,
        raw: torch.Tensor,
        origins: torch.Tensor,
        directions: torch.Tensor,
        t_near: torch.Tensor,
        t_far: torch.Tensor,
        generator: torch.Generator | None,
    ) -> RenderedSegments:
        """`render` of a grid like `raw`."""
        if not self.known:
            finite = torch.isfinite(t_far).to(origins.dtype)
            return RenderedSegments(torch.zeros_like(origins), finite, torch.zeros_like(finite))
        jitter = None
        if generator is not None:
            jitter = torch.rand(len(origins), generator=generator, device=origins.device, dtype=origins.dtype)
        if self.infinite:
            origins = torch.zeros_like(origins)
            t_near = torch.full_like(t_near, FAR)
            t_far = torch.where(torch.isinf(t_far), t_far, t_near)
        volume = EnvironmentVolume(
            contraction_radius=self.preset.contraction_radius,
            density_gain=self.preset.density_gain,
            longest_step=self.longest_step,
            gradient_near=self.preset.gradient_near if generator is not None else 0.0,
            transmittance_limit=self.preset.transmittance_limit,
            depth_limit=self.preset.depth_limit,
        )
        segments = RaySegments(origins, directions, t_near, t_far)
        return render_environment(raw, self.detail, segments, volume, jitter=jitter)

    @profiled("F_e priors")
    def regularize(self, generator: torch.Generator | None = None) -> float:
        """Add the gradient of the priors to `raw.grad`, and return the value of the priors.

        Call it after the backward pass of the photometric loss. The priors are needed because the photos do not determine
        the field. They are the total variation of the raw grid (smooth along all three axes, edges allowed) and the mean
        density. Each call takes them on some random neighboring shells, and changes the gradient of these shells in place.
        As a term of the loss, they would fill and add gradients of the whole grid, which took as long as the rendering.
        """
        preset, raw = self.preset, self.raw
        if not self.known:
            return 0.0
        shells = raw.shape[0]
        run = max(2, round(shells * preset.regularized_fraction))
        first = int(torch.randint(0, shells - run + 1, (1,), generator=generator, device=raw.device))
        if raw.grad is None:
            raw.grad = torch.zeros_like(raw)
        slab, gradient = raw.detach()[first : first + run], raw.grad[first : first + run]
        weight = (preset.density_variation, *[preset.color_variation] * 3)
        value = add_total_variation_gradient(slab, weight, preset.variation_softness, gradient)
        density = slab[..., 0].contiguous()  # softplus of values that do not lie side by side is slow
        value = value + preset.density_penalty * torch.nn.functional.softplus(density).mean()
        gradient[..., 0].add_(density.sigmoid(), alpha=preset.density_penalty / density.numel())
        return float(value) + (self._smooth_detail(generator) if len(self.detail) else 0.0)

    def _smooth_detail(self, generator: torch.Generator | None) -> float:
        """Add the gradient of the total variation of some random neighboring rows of the color detail; return its value."""
        rows = len(self.detail)
        run = max(2, round(rows * self.preset.regularized_detail))
        first = int(torch.randint(0, rows - run + 1, (1,), generator=generator, device=self.raw.device))
        if self.detail.grad is None:
            self.detail.grad = torch.zeros_like(self.detail)
        band, gradient = self.detail.detach()[first : first + run], self.detail.grad[first : first + run]
        weight = (self.preset.detail_variation,) * 3
        return float(add_total_variation_gradient(band[None], weight, self.preset.variation_softness, gradient[None]))

    def refine(self, fraction: float) -> bool:
        """Go to the resolution that is due at this fraction of the learning, 0..1. True if the resolution has changed.

        Then `raw` is a new parameter, and the optimizer must be made again.
        """
        due = sum(fraction >= start for start in self.preset.refine_at) if self.known else 0
        if due <= self.level:
            return False
        self.raw = nn.Parameter(resample(self.raw.detach(), *self.resolutions[due]))
        self.coverage, self.burnt = (self.raw.new_zeros(self.raw.shape[:3]) for _ in range(2))
        return True

    @torch.no_grad()
    def decide_detail(self, origins: torch.Tensor, directions: torch.Tensor) -> bool:
        """Ask whether camera rays [n, 3] show enough that is far away. If so, begin anew with a color detail.

        `far_share` becomes the mean transmittance up to the contraction radius, 0..1. F_e begins anew because its grid has
        found places for the far colors without the detail, and keeps them. True if F_e has begun anew. Then `raw` and
        `detail` are new parameters, and the optimizer must be made again.
        """
        preset = self.preset
        along = (origins * directions).sum(-1)
        rest = along * along - (origins * origins).sum(-1)
        end = (rest + preset.contraction_radius**2).clamp(min=0).sqrt() - along
        near = torch.full_like(end, preset.camera_near)
        passed = self.render(origins, directions, near, torch.maximum(end, near)).transmittance
        self.far_share.fill_(passed.mean())
        if float(self.far_share) < preset.detail_from:
            return False
        self.raw = nn.Parameter(self._first_grid(self.raw[..., 1:].mean()).to(self.raw.device))
        self.detail = nn.Parameter(self.raw.new_zeros(preset.detail_rows, 2 * preset.detail_rows, 3))
        return True

    @torch.no_grad()
    def freeze(self, origins: torch.Tensor, directions: torch.Tensor, burnt: torch.Tensor | None = None) -> None:
        """End the learning: measure `coverage` and `burnt` with camera rays [n, 3], so that cones can be queried.

        The coverage of a node is the summed weight with which the rays see it, divided by `preset.coverage_weight`, at
        most 1. That weight is low, because what photos show is known better than what only the object reflects.

        `burnt` [n] bool says at which rays the photos end at white in all channels (`PixelRays.white`; None: at no ray). A
        node's `burnt` is the share of these rays in the summed weight. It is lower if so many rays are burnt that white is a
        backdrop.
        """
        if not self.known:
            return
        if burnt is None:
            burnt = torch.zeros_like(origins[:, 0], dtype=torch.bool)
        told, white = (self._weight_seen(origins[rays], directions[rays]) for rays in (~burnt, burnt))
        seen = told + white
        self.coverage = (seen / self.preset.coverage_weight).clamp(max=1)
        lamps, backdrop = self.preset.backdrop_share
        like_lamps = ((backdrop - burnt.float().mean()) / (backdrop - lamps)).clamp(0, 1)
        self.burnt = like_lamps * torch.where(seen > 0, white / seen, 0)
        self._prefiltered = None

    def _weight_seen(self, origins: torch.Tensor, directions: torch.Tensor) -> torch.Tensor:
        """The summed weights [K, H, W] with which camera rays [n, 3] see the nodes."""
        weight_seen = np.zeros(self.raw.shape[:3], np.float32)
        if self.infinite:
            origins = torch.zeros_like(origins)
        near = torch.full_like(origins[:, 0], FAR if self.infinite else self.preset.camera_near)
        segments = RaySegments(*(part.cpu() for part in (origins, directions, near, torch.full_like(near, torch.inf))))
        samples = sample_rays(segments, self.preset.contraction_radius, self.longest_step, None)
        accumulate_coverage(
            self.raw.detach().cpu().numpy(),
            RaySamples(*(part.contiguous().numpy() for part in samples)),  # type: ignore[arg-type]  # arrays, for Numba
            Medium(self.preset.contraction_radius, self.preset.density_gain, 0.0, 0.0, 0.0),
            weight_seen,
        )
        return torch.from_numpy(weight_seen).to(self.raw.device)

    def _light(self) -> torch.Tensor:
        """The grid [K, H, W, 4] of the light: as `raw`, but brighter where photos end at white."""
        brighter = math.log(self.preset.burnt_gain) * self.burnt
        return torch.cat([self.raw.detach()[..., :1], self.raw.detach()[..., 1:] + brighter[..., None]], -1)

    @profiled("F_e cones")
    @torch.no_grad()
    def query_cone(
        self,
        origins: torch.Tensor,
        directions: torch.Tensor,
        half_angle: torch.Tensor | float,
        t_near: torch.Tensor | None = None,
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Mean radiance [n, 3] in cones from points in the unit sphere, and the coverage [n] by the photos in 0..1.

        Each node's radiance counts as far as the photos show the node: a cone's radiance is 0 where they show nothing.

        origins, unit directions [n, 3]; half_angle [n] or one number, radians, 0 .. pi / 2; t_near [n]: the distance at
        which the environment begins, by default the border |x| = 1.
        """
        if not self.known:
            return torch.zeros_like(origins), torch.zeros_like(origins[:, 0])
        if self._prefiltered is None:
            self._prefiltered = PrefilteredEnvironment(
                self._light(), self.coverage, self.detail, self.preset.density_gain, self.preset.contraction_radius
            )
        if self.infinite:
            origins, t_near = torch.zeros_like(origins), torch.full_like(origins[:, 0], FAR)
        if t_near is None:
            b = (origins * directions).sum(-1)
            t_near = (-b + (b * b - (origins * origins).sum(-1) + 1).clamp(min=0).sqrt()).clamp(min=1e-3)
        half_angle = torch.as_tensor(half_angle, device=origins.device, dtype=origins.dtype).expand(len(origins))
        return self._prefiltered.query(origins, directions, half_angle, t_near)

    @torch.no_grad()
    def typical_distance(self, directions: int = 1000) -> float:
        """Median distance of the surroundings from the object's center, over the directions that the photos show.

        It is FAR if it is farther than that, if the environment is a 2-D map, or if the photos show no surroundings.
        """
        k = torch.arange(directions, device=self.raw.device) + 0.5
        z, around = 1 - 2 * k / directions, math.pi * (1 + math.sqrt(5)) * k
        flat = (1 - z * z).sqrt()
        d = torch.stack([flat * around.cos(), flat * around.sin(), z], -1)
        _, coverage = self.query_cone(torch.zeros_like(d), d, 0.05)
        d = d[coverage > 0.5]
        if self.infinite or not len(d):
            return FAR
        near, distance = torch.ones(len(d), device=d.device), torch.full((len(d),), FAR, device=d.device)
        contracted = torch.linspace(0, contracted_length(self.preset.contraction_radius), 64)[:-1]
        for radius in contracted_radius(contracted, self.preset.contraction_radius).flip(0).tolist():
            passed = self.render(torch.zeros_like(d), d, near, torch.full_like(near, radius)).transmittance
            distance[passed < 0.5] = radius
        return float(distance.median())

    def equirect(self, height: int) -> tuple[torch.Tensor, torch.Tensor]:
        """The light that the photos show, as seen from the object's center: a map for Blender's World.

        Returns radiance [height, 2 height, 3] and coverage [height, 2 height] in 0..1. Cycles maps a direction to u = 0.5 -
        atan2(y, x) / (2 pi), v = 0.5 + atan2(z, hypot(x, y)) / pi; row 0 is +z.
        """
        direction = _equirect_directions(height, self.raw.device)
        radiance, coverage = self.query_cone(torch.zeros_like(direction), direction, 0.5 * math.pi / height)
        return radiance.reshape(height, 2 * height, 3), coverage.reshape(height, 2 * height)

    @torch.no_grad()
    def extrapolated(self, height: int) -> torch.Tensor:
        """All radiance that the field holds, shown by photos or not: a map [height, 2 height, 3] as that of `equirect`."""
        fine = 4 * height
        direction = _equirect_directions(fine, self.raw.device)
        near = torch.ones_like(direction[:, 0])
        radiance = self._rendered(
            self._light(), torch.zeros_like(direction), direction, near, near * torch.inf, None
        ).radiance
        return radiance.reshape(height, 4, 2 * height, 4, 3).mean((1, 3))

    def parameter_groups(self) -> list[dict]:
        """The parameters with their learning rate and settings, for `optimizers.Adam`."""
        p = self.preset
        return [{"params": [self.raw, self.detail], "lr": p.learning_rate, "betas": p.adam_betas, "eps": p.adam_eps}]

    def _load_from_state_dict(self, state_dict, prefix, *arguments):
        stored = state_dict.get(prefix + "raw")
        if stored is not None and stored.shape != self.raw.shape:
            self.raw = nn.Parameter(self.raw.new_empty(stored.shape))
            self.coverage, self.burnt = (self.raw.new_zeros(stored.shape[:3]) for _ in range(2))
        detail = state_dict.get(prefix + "detail")
        if detail is not None and detail.shape != self.detail.shape:
            self.detail = nn.Parameter(self.detail.new_empty(detail.shape))
        self._prefiltered = None
        super()._load_from_state_dict(state_dict, prefix, *arguments)


def _equirect_directions(height: int, device: torch.device) -> torch.Tensor:
    """Unit directions [2 height^2, 3] of the texels of an equirectangular map, row by row."""
    theta = (torch.arange(height, device=device) + 0.5) * math.pi / height
    phi = (0.5 - (torch.arange(2 * height, device=device) + 0.5) / (2 * height)) * 2 * math.pi
    theta, phi = torch.meshgrid(theta, phi, indexing="ij")
    return torch.stack([theta.sin() * phi.cos(), theta.sin() * phi.sin(), theta.cos()], -1).reshape(-1, 3)
