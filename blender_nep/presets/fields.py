"""The settings of fields learning: the steps, the refinements between them, the losses."""

from __future__ import annotations

from dataclasses import dataclass

REFINEMENTS = (
    "support",
    "hull",
    "hidden_pixels",
    "fine_paint",
    "levels",
    "carve",
    "cavities",
    "relief",
    "object_pixels",
)
"""The names of the refinements between the steps of stage 1 (`fields.refinements`)."""


@dataclass(frozen=True)
class FieldsPreset:
    """Settings of fields learning. Lengths are in radii of the object's sphere; learning rates are Adam's.

    A fraction is the part of the learning of both fields that is done, 0..1. A value without a source was found by trials on
    the rendered captures (docs/lab).
    """

    without: tuple[str, ...] = ()
    """Names of the refinements that are switched off (`fields.refinements`). Each is an ablation."""
    background_steps: int = 300
    """Steps of F_e alone, before both fields are learned. Then the SDF starts from a visual hull. 0: no such steps."""
    steps: int = 1100
    """Steps of both fields together."""
    least_outside: float = 0.05
    """F_e is learned first if the rays of at least this share of the photos' pixels miss the object's sphere. With fewer,
    there is nothing from which to learn F_e."""
    least_contrast: float = 2.0
    """Smallest contrast of a usable visual hull: mean silhouette value inside divided by that outside. With less, the SDF
    starts from a sphere. inf: always so (an ablation). The poorest hull that helped had 2.1."""
    environment_gradient_scale: float = 0.1
    """Scale of F_e's gradients from pixels that may show the object: those that it covers as it is now, if the SDF starts
    from a hull, or else all that see its sphere. With a small scale, the other pixels decide what the surroundings are,
    before the object is known. 1: no scaling (an ablation)."""
    environment_gradient_scale_until: float = 0.5
    """Fraction until which `environment_gradient_scale` holds."""
    object_rays: int = 6144
    """Rays of a step through object pixels. Until these are first found, the rays go through the object's sphere. With few
    such rays, steps are noisy, and the priors outweigh the photos."""
    object_pixels_at: tuple[float, ...] = (0.0, 0.25, 0.5, 0.75)
    """Fractions, rising, at which the object pixels are found."""
    carve_again_at: tuple[float, ...] = (0.5, 0.75)
    """Fractions, rising, at which the object is carved again, when F_e knows the silhouettes better. Empty: never."""
    least_fine_paint: float = 0.17
    """The albedo gets a grid of fine paint if photos from above and from below agree on the fine colors of the hull with at
    least this correlation (`fields.refinements.fine_paint`). Above 1: never."""
    open_cavities_at: float = 0.5
    """Fraction at which the cavities of the object are opened that no silhouette shows. inf: never."""
    held_out_every: int = 101
    """One of so many pixels is held out for the validation error; another number, where these would be columns of photos."""
    validation_pixels: int = 4096
    """Approximate number of held-out pixels on which the validation error is measured."""
    validate_from: float = 0.25
    """Fraction at which the validation error is first measured."""
    validate_every: float = 0.05
    """Fraction from one measurement of the validation error to the next."""
    patience: int = 3
    """If the validation error falls by less than `least_gain` within this many measurements, it is on a plateau."""
    least_gain: float = 0.005
    """Share by which the validation error must fall within `patience` measurements."""
    plateau_step_multiplier: int = 4
    """While the validation error is on a plateau, one step counts as this many: learning ends early. 1: no early end."""
    sphere_rays: int = 512
    """Rays of a step through any pixels that see the object's sphere."""
    outside_rays: int = 768
    """Rays of a step through all other pixels."""
    coarsest_cells: int = 16
    """Cells of the coarsest SDF grid along an axis. Each further level halves the cell."""
    first_levels: int = 3
    """Levels of the SDF grid at the start."""
    last_levels: int = 4
    """Levels of the SDF grid from `refine_at` on. The finest has coarsest_cells * 2^(last_levels - 1) cells on an axis."""
    refine_at: float = 0.45
    """Fraction at which the SDF grid gets its last levels."""
    relief_at: tuple[float, ...] = (0.8, 0.92)
    """Fractions, rising, of searches for relief that is finer than the SDF's grid (`refinements.relief`). Empty: never."""
    relief_pixels: float = 0.25
    """Largest width of the photos' pixels, at the object's distance, for that search, as a share of the SDF's cells."""
    initial_radius: float = 0.6
    """Radius of the sphere from which the SDF starts without a hull. With 0.9, it stayed: it showed the background."""
    head_width: int = 64
    """Neurons in each hidden layer of the color heads."""
    first_sharpness: float = 12.0
    """NeuS sharpness at the start if the SDF starts from a sphere, 1 / object radius."""
    hull_sharpness: float = 40.0
    """NeuS sharpness at the start if the SDF starts from a visual hull, 1 / object radius."""
    last_sharpness: float = 500.0
    """NeuS sharpness at the end, 1 / object radius. While the surface is soft, hollows are filled."""
    sharpness_until: float = 0.5
    """Fraction until which the sharpness rises."""
    first_samples: int = 16
    """Samples of the object field on each ray until `first_samples_until`, while the surface is soft and its band wide."""
    first_samples_until: float = 0.2
    """Fraction from which on a ray has `samples` samples."""
    samples: int = 8
    """Samples of the object field on each ray. Many rays with few samples are better than few rays with many samples."""
    transmittance_limit: float = 5e-3
    """Where the transmittance of the object is below this, F_e behind it is not rendered; this saves time."""
    sdf_rate: float = 0.005
    """Learning rate of the SDF in object radii: the typical step of a touched spline coefficient, in the level with 64
    cells. In other levels it is proportional to the cell width. So coarse levels take large steps, which move whole parts of
    the surface, and the noise of the finest level stays small."""
    sdf_rate_sharpness_power: float = 0.5
    """The SDF's learning rate is proportional to the sharpness to minus this power, because a sharper surface needs smaller
    steps. 0: it does not depend on the sharpness."""
    sdf_betas: tuple[float, float] = (0.9, 0.99)
    """Adam's decay rates of the SDF's mean gradient and mean square. The default of 0.999 would remember most steps."""
    head_rate: float = 5e-3
    """Learning rate of the color heads."""
    head_rate_decay_from: float = 0.7
    """Fraction from which on the learning rate of the color heads falls geometrically. The colors must follow the shape for
    as long as the shape changes."""
    head_betas: tuple[float, float] = (0.9, 0.99)
    """Adam's decay rates for the color heads, as `sdf_betas`."""
    warm_up_steps: int = 50
    """Steps over which F_o's learning rates rise from 0, because Adam's first mean squares are means of few gradients."""
    colors_first_steps: int = 50
    """Steps of F_e and the colors alone after a hull. Led by the first colors, the SDF would lose parts of the hull."""
    sdf_rate_decay_from: float = 0.3
    """Fraction from which on the SDF's learning rate falls geometrically."""
    last_rate: float = 0.03
    """F_o's learning rates at the end, as a share of their full values."""
    eikonal: float = 0.02
    """Weight of the eikonal loss, the mean of (|gradient of the SDF| - 1)^2. With 0.1, as in NeuS, the SDF without masks
    stays the sphere from which it starts."""
    curvature: float = 5e-4
    """Weight of the curvature loss, the mean of sqrt(|Hessian of the SDF|^2 + 1) at surface points, in 1 / object radius.
    0: no curvature loss (an ablation)."""
    curvature_decay_from: float = 0.5
    """Fraction from which on the weight of the curvature loss falls geometrically."""
    last_curvature: float = 1e-4
    """Weight of the curvature loss at the end."""
    mask: float = 0.5
    """Weight of the binary cross entropy between the object's opacity and the masks, if there are masks."""
    highlight_threshold: float = 3.0
    """Radiance above which an object pixel is a highlight, as a multiple of the photos' typical radiance. Highlights count
    little: they move with the camera and would dominate the error. inf: they count in full (an ablation)."""
    dynamic_weight: bool = False
    """True: the weight w_s of eq. 4, see `fields.rendering.dynamic_weight` (an ablation)."""
    dynamic_weight_cap: float = 1.5
    """u of eq. 4: the largest w_s. The paper's value."""
    decomposition: bool = True
    """False: one radiance head of position, normal and view direction, as in plain NeuS (an ablation)."""
    least_explanation_ratio: float = 1.4
    """Smallest explanation ratio: error of F_e alone divided by error of the object, on the object's pixels. With less, the
    sphere counts as empty. 0 turns the check off. Measured: 0.6 and 1.1 for empty spheres, 1.9 to 8.6 for objects."""
    explanation_pixels: int = 16384
    """Number of pixels that see the object's sphere, from which the explanation ratio is measured."""
    explanation_opacity: float = 0.9
    """Opacity above which the object covers a pixel, for the explanation ratio."""
    explanation_least_share: float = 0.001
    """If the object covers less than this share of `explanation_pixels`, the explanation ratio is 0."""

    def __post_init__(self) -> None:
        unknown = [name for name in self.without if name not in REFINEMENTS]
        if unknown:
            raise ValueError(f"there is no refinement named {', '.join(unknown)}: choose among {', '.join(REFINEMENTS)}")
