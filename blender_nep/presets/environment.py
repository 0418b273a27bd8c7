"""The settings of the environment field F_e."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class EnvironmentPreset:
    """Settings of the environment field F_e, a spherical volume of raw density and log radiance.

    Lengths are in radii of the object's sphere. Costs are weights of terms that are added to the photometric loss. A
    fraction is the part of F_e's learning that is done, 0..1. A value without a source was found by trials on the rendered
    captures (docs/lab).
    """

    resolutions: tuple[tuple[int, int], ...] = ((20, 32), (28, 64), (40, 96))
    """(shells, rows) of the grid, coarse to fine; there are twice as many columns as rows."""
    refine_at: tuple[float, ...] = (0.15, 0.4)
    """Fractions at which the next resolution starts."""
    model: str = "field"
    """Kind of F_e. field: the spherical volume. infinite: a 2-D environment map at infinity, as NeRO and nvdiffrec assume
    (an ablation). none: the photos are cut-outs and show no surroundings (`PhotoAnalysis.plan` decides this)."""
    contraction_radius: float = 12.0
    """Nearer than this, the shells of the grid lie at equal steps of log |x|; beyond it, at equal steps of 1 / |x|. The
    last shell, the sky, lies at infinity."""
    density_gain: float = 16.0
    """Optical depth per unit of softplus(raw density) and of contracted distance."""
    initial_raw_density: float = -4.0
    """Raw density at the start, before softplus. It makes F_e nearly transparent. A start at -7 was worse."""
    march_step: float = 1.0
    """Longest step along a ray, in spacings of the shells."""
    camera_near: float = 0.6
    """F_e is rendered only beyond this distance from a camera. Otherwise F_e would learn each photo as a screen in front of
    its camera."""
    gradient_near: float = 2.0
    """Nearer to the camera than this, gradients of samples at distance t are scaled by (t / gradient_near)^2. 0: never."""
    transmittance_limit: float = 1e-3
    """A ray ends when its transmittance falls to this value; this saves time."""
    depth_limit: float = 1e-3
    """Samples with a smaller optical depth count as clear; this saves time."""
    learning_rate: float = 0.05
    """Adam's learning rate, in units of raw density and of log radiance."""
    rate_decay_from: float = 0.5
    """Fraction from which on the learning rate falls geometrically."""
    last_rate: float = 0.1
    """Learning rate at the end, as a share of `learning_rate`."""
    adam_betas: tuple[float, float] = (0.9, 0.99)
    """Adam's decay rates of the mean gradient and of the mean square. With Adam's default of 0.999, the mean square would
    remember most of all steps."""
    adam_eps: float = 1e-8
    """Adam's epsilon, its default. It is added to the root of the mean square."""
    density_variation: float = 1e-3
    """Cost of the total variation of the raw density, from node to node."""
    color_variation: float = 1e-3
    """Cost of the total variation of the log radiance, from node to node."""
    detail_rows: int = 384
    """Rows of the color detail, a multiple of twice the rows of each grid; there are twice as many columns. A photo of 400
    pixels shows 0.1 degrees a pixel; 384 rows are 0.5 degrees each, the grid's 96 rows 1.9 degrees."""
    detail_step: int = 33
    """Number of steps after which it is decided whether F_e gets a color detail. They must end before `refine_at`."""
    detail_from: float = 0.34
    """Share of the photos' light that must come from beyond `contraction_radius` for F_e to get a color detail. 0: always;
    above 1: never. After so many steps, rooms with a half width of 6 to 11 radii have 0.25 to 0.32, one of 51 radii and a
    photographed studio 0.31 and 0.32, other surroundings at infinity 0.36 and more. After more steps, rooms have less."""
    detail_rays: int = 4096
    """Number of camera rays by which that share is measured."""
    detail_variation: float = 1e-2
    """Cost of the total variation of the color detail, from texel to texel."""
    variation_softness: float = 0.05
    """Differences between nodes below this cost quadratically; larger ones cost linearly, so that edges are allowed."""
    density_penalty: float = 1e-3
    """Cost of the mean of softplus(raw density): a place stays transparent unless the photos show that it is opaque."""
    foreground_opacity: float = 0.05
    """Cost of the foreground opacity: F_e's mean opacity in front of the object. Without it, each photo gets a fog there,
    and lamps are learned 12 to 19 % too bright, so that they shine through it."""
    distortion: float = 0.03
    """Cost of the distortion: how far a ray's light is spread along it (`ops.environment.rendering`). 0: F_e is foggy."""
    regularized_fraction: float = 0.25
    """Share of the shells, drawn anew in each step, whose priors it computes. Those of all took as long as the rendering."""
    regularized_detail: float = 0.1
    """Share of the rows of the color detail, drawn anew in each step, whose prior it computes."""
    coverage_weight: float = 0.015
    """A node has full coverage if the weights with which `coverage_rays` camera rays see it add up to this."""
    coverage_rays: int = 200_000
    """Number of camera rays with which the coverage is measured, after F_e is learned."""
    burnt_gain: float = 3.0
    """How many times as bright as white the light is where photos end at white (docs/lab/burnt-out-light.md)."""
    backdrop_share: tuple[float, float] = (0.1, 0.3)
    """Shares of the surroundings' pixels that are white. Up to the first, white is lamps and windows. From the second on, it
    is a backdrop, which is hardly brighter than white. In between, the gain falls."""
    rays_per_step: int = 4096
    """Rays of a step of F_e alone."""
    steps: int = 2000
    """Number of steps if only F_e is learned, with a given mesh."""
