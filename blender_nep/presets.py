"""The presets: every number that a user or an ablation may change, with its unit and its source.

`preview`, `balanced` and `quality` run the same program; they differ in run time and error.
"""

from __future__ import annotations

from dataclasses import dataclass, field


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
    """Scale of F_e's gradients from pixels that see the object's sphere. With a small scale, the other pixels decide what
    the surroundings are, before the object is known. 1: no scaling (an ablation)."""
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
    (an ablation). none: the photos are cut-outs and show no surroundings (`scene_analysis` decides this)."""
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
    detail_at: float = 0.06
    """Fraction at which it is decided whether F_e gets a color detail. It must lie before `refine_at`."""
    detail_from: float = 0.37
    """Share of the photos' light that must come from beyond `contraction_radius` for F_e to get a color detail. 0: always;
    above 1: never. At that fraction, rooms with a half width of 6 to 11 radii have 0.27 to 0.35, farther surroundings 0.40
    to 0.65."""
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
    rays_per_step: int = 4096
    """Rays of a step of F_e alone."""
    steps: int = 2000
    """Number of steps if only F_e is learned, with a given mesh."""


@dataclass(frozen=True)
class SurfacePreset:
    """Settings of the surface stage."""

    grid: int = 224
    """Marching-cubes samples along each side of [-1, 1]^3."""
    unwrapped_faces: int = 12_000
    """Largest number of faces, about, after decimation, when the UV atlas is made. xatlas takes about 3 s for 20,000 faces
    and 14 s for 60,000."""
    faces: int = 120_000
    """Largest number of faces of the mesh, after its edges are halved where the surface bends."""
    relief_faces: int = 300_000
    """The same where the SDF has relief that is finer than its grid."""
    chord_error: float = 1.5e-4
    """Edges that are farther from the surface than this, in object radii, are halved (`surface.subdivision`)."""
    asset_faces: int = 0
    """Largest number of faces of the asset's mesh (--faces). If it is smaller than `faces`, the asset gets a normal map that
    carries the difference. 0: the asset has the mesh on which materials are learned."""
    normal_texels: int = 2048
    """Side of the normal map in texels."""
    atlas_texels: int = 1024
    """Side of the UV atlas in texels while it is packed; `padding_texels` are such texels."""
    padding_texels: int = 3
    """Free texels of the atlas between charts. Textures of half its side, or less, have less than two texels there."""


EVIDENCE = ("residual", "spread", "hue", "third_moment")
"""What tells the roughness or the class of a material (`materials.evidence`)."""


@dataclass(frozen=True)
class MaterialPreset:
    """Settings of material learning. Residuals and costs are in tone-mapped radiance: black is 0, white is 1.

    A value without a source was found by trials on the rendered captures (docs/lab).
    """

    samples: int = 30_000
    """Number of photo pixels from which the materials are learned. There are twice as many if the materials vary."""
    least_cosine: float = 0.25
    """Smallest cosine between normal and view direction; pixels at more grazing angles are left out."""
    roughness_levels: tuple[float, ...] = (0.03, 0.06, 0.1, 0.13, 0.17, 0.22, 0.28, 0.36, 0.46, 0.6, 0.78, 1.0)
    """Roughness levels (Principled's roughness) at which the specular light is prefiltered."""
    diffuse_cones: int = 8
    """Cones of the diffuse lobe (paper, section 3.3) at a point that a cone hits."""
    specular_cones: int = 4
    """Cones of the specular lobe (paper, section 3.3): at a point that a cone hits, and at a photo sample for each roughness
    level."""
    irradiance_cones: int = 32
    """Cones of the diffuse lobe at a photo sample. They are traced once."""
    use_cones: bool = True
    """False: the cones are replaced by as many thin rays (the paper's ablation without cones)."""
    levels: int = 2
    """N, the number of surface interactions by the rendering equation before the terminal MLP. 0: no indirect light (an
    ablation)."""
    terminal_steps: int = 300
    """Adam's steps for the terminal MLP."""
    terminal_rate: float = 3e-3
    """Adam's learning rate for the terminal MLP."""
    terminal_batch: int = 4096
    """Photo samples a step for the terminal MLP."""
    residual: bool = True
    """Whether the light that no photo shows is learned from the object's reflections of it. False is an ablation."""
    unseen_rows: int = 32
    """Rows of the map of the unseen light; there are twice as many columns."""
    unseen_samples: int = 8000
    """Number of photo pixels from which the unseen light is learned."""
    unseen_steps: int = 80
    """Adam's steps each time that the unseen light is learned. A trial of another roughness takes half as many."""
    unseen_smoothness: float = 0.02
    """Cost of the total variation of the map of the unseen light, from texel to texel."""
    unseen_softness: float = 0.03
    """Tone-mapped differences from texel to texel below this cost quadratically, above linearly."""
    unseen_rate: float = 0.2
    """Adam's learning rate of the map's log radiance at the start: lamps are a hundred times brighter than walls. The rate
    falls to a tenth."""
    unseen_albedo_rate: float = 0.05
    """Adam's learning rate of the albedos' logits, while the unseen light is learned. It falls as `unseen_rate`."""
    unseen_roughness_factors: tuple[float, ...] = (0.8, 1.25)
    """Factors by which a lower and a higher roughness are tried while the unseen light is learned."""
    unseen_prior: float = 1e-2
    """Cost of the map's deviation from the expected one, so that it changes only if that explains the photos better."""
    unseen_color: float = 0.01
    """Cost of the share of the map's flux that is not gray. It is needed because colored light on a gray object looks like
    white light on a colored object."""
    label_pixels: int = 240_000
    """Number of label pixels: pixels that show which material lies where. Their light is that of the nearest samples. There
    are three times as many if the materials vary."""
    metallic: tuple[float, ...] = (0.0, 1.0)
    """Values of metallic that are tried."""
    without: tuple[str, ...] = ()
    """Names of `EVIDENCE` that does not count (ablations). The field `residual` is about the unseen light instead."""
    metal_margin: float = -0.03
    """Share by which the residual of a metal must be lower than that of a dielectric; below 0: may be higher. This prior
    decides where the photos do not. On rendered objects, the residual of the wrong class is 18 to 48 % higher."""
    hue_margin: float = 0.15
    """Largest share by which the hue of what differs between photos changes a metal's residual (`evidence.hue`)."""
    sure_margin: float = 0.15
    """Where all residuals are higher by this share in the other class, that class is not tried again. inf: never sure."""
    least_roughness: float = 0.03
    """Smallest roughness (Principled's) that a material may have."""
    clip: float = 0.25
    """Larger residuals are clipped to this, because they come from wrong geometry and not from the material."""
    region: float = 0.12
    """Width of the regions of the surface to which candidate materials are fitted, in object radii."""
    candidates: int = 120
    """Largest number of candidate materials: those of the regions with the most samples."""
    most_materials: int = 6
    """Largest number of materials in the palette."""
    gain: float = 0.05
    """Share by which a further material must lower the residual."""
    blended_gain: float = 0.12
    """As `gain`, for a material in whose place blends of two others could stand. Measured: 0.04 to 0.13 for materials that
    are nothing but a gradual change from one to another; 0.14 to 2 for others."""
    least_share: float = 0.01
    """Smallest share of the samples that a material must have; other materials are dropped."""
    merge_hue: float = 0.09
    """Two materials whose chromaticities differ by less than this are merged; 0 turns this prior off."""
    merge_roughness: float = 0.08
    """Two metals of one chromaticity are merged if they differ by less than this in roughness."""
    roughness_margin: float = 0.03
    """Dielectrics share one roughness if that raises the residual of none of them by more than this share."""
    spread_margin: float = 0.03
    """For a metal, roughness values are possible whose residual is up to this share above the least. Among these, the spread
    of the reflected light decides, except among lobes as sharp as a mirror (`materials.evidence.decision`)."""
    hue_residual_margin: float = 0.1
    """The same for colored dielectrics, whose third moments of reflected light decide (`evidence.third_moment`)."""
    blend_margin: float = 0.05
    """Share by which a mixture of two materials must be better than one material alone."""
    inner_blend_margin: float = 0.25
    """As `blend_margin`, for label pixels whose wider surroundings show one material: there a mixture is mostly noise."""
    varied_gain: float = 0.25
    """Materials may vary from place to place if that lowers the residual of held-out photos by this share. inf: never.
    Measured: 0.34 to 0.55 for a vase in forty paints; -0.20 to 0.16 for seven objects that a palette explains."""
    segment_metal_margin: float = 0.1
    """As `metal_margin`, for the segments of an object whose materials vary. Most things are not metal."""
    segment_prior: float = 0.2
    """Weight of the whole object's residuals beside those around a segment when its roughness is chosen. 0 turns it off."""
    rounds: int = 2
    """Rounds of learning the unseen light and choosing the palette anew; afterwards as many rounds without new materials."""
    most_texels: int = 1024
    """Largest side of the textures in texels, twice as large if the materials vary. Wide pixels on the surface lower it."""
    uniform_texels: int = 128
    """Largest side of the textures in texels if one material explains the photos."""

    def __post_init__(self) -> None:
        unknown = [name for name in self.without if name not in EVIDENCE]
        if unknown:
            raise ValueError(f"there is no evidence named {', '.join(unknown)}: choose among {', '.join(EVIDENCE)}")


@dataclass(frozen=True)
class Preset:
    """All settings of one job."""

    name: str = "balanced"
    max_pixels_per_photo: int = 250_000
    """Each photo is downscaled until it has at most this many pixels."""
    max_pixels: int = 256_000_000
    """Largest number of pixels of all photos together. If there are more, each photo is downscaled further. A pixel takes 8
    bytes on the disk or in GPU memory."""
    pixels_in_memory: int = 32_000_000
    """Up to this many pixels of all photos together are kept in memory. If there are more, all are kept in half precision in
    a nameless file in the asset's folder, and read from there."""
    fields_seconds: float = 210.0
    """Seconds that fields learning takes on two cores: a first guess, which is corrected as the job runs. It is the figure
    for one thread in docs/benchmarks.md (f97dfca) divided by 1.3.

    The sidebar shows the sum of the three before a first job. backend/engine/timings.py repeats it; a test compares both."""
    surface_seconds: float = 8.0
    """First guess of the seconds of the surface stage, as `fields_seconds`."""
    material_seconds: float = 70.0
    """First guess of the seconds of material learning, as `fields_seconds`."""
    even_exposure: bool = True
    """Whether differences between the photos in exposure and white balance are found and evened out (`photos.exposure`)."""
    brightness: float = 0.25
    """The photos are made so bright that the typical radiance of the pixels that see the object's sphere is this
    (`photos.brightness`). Here the tone mapping turns from linear to logarithmic. 0: they stay as they are, which is an
    ablation."""
    skip_needless: bool = True
    """Whether parts that the scene does not need are left out (`scene_analysis`). False: nothing is left out."""
    environment_height: int = 256
    """Rows of environment.exr; there are twice as many columns."""
    fields: FieldsPreset = field(default_factory=FieldsPreset)
    environment: EnvironmentPreset = field(default_factory=EnvironmentPreset)
    surface: SurfacePreset = field(default_factory=SurfacePreset)
    material: MaterialPreset = field(default_factory=MaterialPreset)


PRESETS = {
    "preview": Preset(
        name="preview",
        max_pixels_per_photo=40_000,
        fields_seconds=64,  # 92 with 950 steps, scaled to 550: a quarter of it does not depend on the steps
        surface_seconds=4,
        material_seconds=26,
        environment_height=128,
        fields=FieldsPreset(background_steps=120, steps=380, object_rays=4096, sphere_rays=384, outside_rays=512),
        environment=EnvironmentPreset(resolutions=((20, 32), (28, 64)), refine_at=(0.25,), detail_rows=256, steps=600),
        surface=SurfacePreset(
            grid=192, unwrapped_faces=8_000, faces=80_000, chord_error=2.5e-4, normal_texels=1024, atlas_texels=512
        ),
        material=MaterialPreset(
            samples=12_000, label_pixels=60_000, terminal_steps=150, unseen_samples=4000, unseen_steps=60, most_texels=512
        ),
    ),
    "balanced": Preset(),
    "quality": Preset(
        name="quality",
        max_pixels_per_photo=650_000,
        fields_seconds=680,
        surface_seconds=15,
        material_seconds=175,
        environment_height=512,
        fields=FieldsPreset(background_steps=400, steps=4000, object_rays=8192),
        environment=EnvironmentPreset(steps=4000),
        surface=SurfacePreset(grid=288, unwrapped_faces=20_000, faces=240_000, chord_error=1.2e-4, atlas_texels=2048),
        material=MaterialPreset(samples=80_000, label_pixels=600_000, unseen_samples=16_000, most_texels=2048),
    ),
}


def preset(name: str) -> Preset:
    """The preset of this name: preview, balanced or quality. Raises KeyError for another name."""
    return PRESETS[name]
