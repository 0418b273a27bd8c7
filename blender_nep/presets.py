"""Presets: every number that a user or an ablation may change, with its unit and its source.

`preview`, `balanced` and `quality` are points on one run-time-against-error curve, not different programs.
"""

from __future__ import annotations

from dataclasses import dataclass, field


@dataclass(frozen=True)
class FieldsPreset:
    """Stage 1, fields learning. Lengths are in radii of the object's sphere, learning rates are Adam's. A fraction is the
    part of the learning of both fields that is done, 0..1. What a value rests on is said with it; where nothing is said, it
    was found by trials on the rendered captures (docs/lab)."""

    background_steps: int = 300
    """Steps of F_e alone, before both fields are learned; then the SDF starts from its visual hull. 0: no such steps."""
    steps: int = 1500
    """Steps of both fields together."""
    least_outside: float = 0.05
    """Share of the photos' pixels that must miss the object's sphere for F_e to be learned first. With fewer there is
    nothing to learn F_e from."""
    least_contrast: float = 2.0
    """Mean silhouette value inside a visual hull over that outside it, at least. Below it the SDF starts from a sphere.
    inf: always from a sphere (an ablation). The poorest hull that helped had 2.1."""
    environment_gradient_scale: float = 0.1
    """Scale of F_e's gradients from pixels that see the object's sphere. Other pixels then decide what the surroundings are,
    before the object is known. 1: no scaling (an ablation)."""
    environment_gradient_scale_until: float = 0.5
    """Fraction until which `environment_gradient_scale` holds."""
    object_rays: int = 1536
    """Rays a step through pixels in which the object is seen; through its sphere until these are first found."""
    object_pixels_at: tuple[float, ...] = (0.25, 0.5, 0.75)
    """Fractions, rising, at which it is found out in which pixels the object is seen."""
    held_out_every: int = 101
    """Pixels whose index is a multiple of this are not learned from: the validation error is measured on them. Prime, so
    that they do not fall into the same columns of a photo."""
    validation_pixels: int = 4096
    """Held-out pixels, about, on which the validation error is measured."""
    validate_every: float = 0.05
    """Fraction from one measurement of the validation error to the next; the first is at object_pixels_at[0]."""
    patience: int = 3
    """Measurements after which the error should have fallen by `least_gain`; else it has reached a plateau."""
    least_gain: float = 0.005
    """Share by which the validation error should fall within `patience` measurements."""
    plateau_step_multiplier: int = 4
    """Steps that one step counts for while the validation error is on a plateau, so that learning ends early. 1: never."""
    sphere_rays: int = 1024
    """Rays a step through any pixels that see the object's sphere."""
    outside_rays: int = 1024
    """Rays a step through all other pixels."""
    coarsest_cells: int = 16
    """Cells an axis of the coarsest SDF grid; each further level halves the cell."""
    first_levels: int = 3
    """Levels of the SDF grid at the start."""
    last_levels: int = 4
    """Levels of the SDF grid from `refine_at` on: the finest has coarsest_cells * 2^(last_levels - 1) cells an axis."""
    refine_at: float = 0.45
    """Fraction at which the SDF grid gets its last levels."""
    initial_radius: float = 0.6
    """Radius of the sphere from which the SDF starts where there is no hull. At 0.9 the sphere's color learned to show the
    background, and the sphere stayed."""
    head_width: int = 64
    """Neurons in each hidden layer of the color heads."""
    first_sharpness: float = 12.0
    """NeuS sharpness at the start where the SDF is a sphere, 1 / object radius."""
    hull_sharpness: float = 40.0
    """NeuS sharpness at the start where the SDF is a visual hull, 1 / object radius."""
    last_sharpness: float = 300.0
    """NeuS sharpness at the end, 1 / object radius. With 500 a dent grew into a test object."""
    sharpness_until: float = 0.85
    """Fraction until which the sharpness rises."""
    first_samples: int = 32
    """Samples a ray in the object until `first_samples_until`, while the surface is soft and its band wide."""
    first_samples_until: float = 0.2
    """Fraction from which on `samples` are taken."""
    samples: int = 16
    """Samples a ray in the object."""
    transmittance_limit: float = 5e-3
    """F_e behind the object is not rendered where the object lets less light through than this share: it saves time."""
    sdf_rate: float = 0.003
    """Learning rate of the SDF, object radii: the typical step of a touched spline coefficient."""
    sdf_rate_sharpness_power: float = 0.5
    """The SDF's learning rate falls as the sharpness to minus this power: a sharper surface answers to smaller steps.
    0: it does not depend on the sharpness."""
    sdf_betas: tuple[float, float] = (0.9, 0.99)
    """Adam's decay rates of the SDF's mean gradient and of its mean square. With Adam's own 0.999 the mean square would
    remember most of all steps; gradients change faster, since the surface sharpens."""
    head_rate: float = 5e-3
    """Learning rate of the color heads."""
    head_betas: tuple[float, float] = (0.9, 0.99)
    """As `sdf_betas`, of the color heads."""
    warm_up_steps: int = 50
    """Steps of both fields over which both learning rates rise from 0: Adam's first mean squares rest on few gradients."""
    rate_decay_from: float = 0.3
    """Fraction from which on both learning rates fall geometrically."""
    last_rate: float = 0.03
    """Share of themselves that both learning rates have at the end."""
    eikonal: float = 0.02
    """Weight of the eikonal loss, the mean of (|gradient of the SDF| - 1)^2. 0.1, as in NeuS, holds the starting sphere
    together where there are no masks."""
    curvature: float = 5e-4
    """Weight of the curvature loss, the mean of sqrt(|Hessian of the SDF|^2 + 1) at surface points, in 1 / object radius.
    0: none (an ablation)."""
    curvature_decay_from: float = 0.5
    """Fraction from which on the weight of the curvature loss falls geometrically."""
    last_curvature: float = 1e-4
    """Weight of the curvature loss at the end."""
    mask: float = 0.5
    """Weight of the binary cross entropy between the object's opacity and the masks, where there are masks."""
    highlight_threshold: float = 3.0
    """Radiance above which a pixel of the object is a highlight, in geometric means of what the photos show around the
    object. Highlights count little: they move with the camera, say little of the shape, and would rule the error. inf: they
    count in full (an ablation)."""
    dynamic_weight: str = "none"
    """The weight w_s: none, paper (eq. 4 as printed) or scaled, see `fields.rendering.dynamic_weight`. docs/benchmarks.md
    compares the three."""
    dynamic_weight_cap: float = 1.5
    """u of eq. 4: the largest w_s. The paper's value."""
    decomposition: bool = True
    """False: one radiance head of position, normal and view direction, as in plain NeuS (an ablation)."""
    least_explanation_ratio: float = 1.4
    """How much better the object must explain its pixels than F_e alone; 0 turns the check off. Measured: 0.6 and
    1.1 for spheres of air, 1.9 to 8.6 for objects."""
    explanation_pixels: int = 16384
    """Pixels that see the object's sphere, of which the explanation ratio is measured."""
    explanation_opacity: float = 0.9
    """Opacity of the object above which it covers a pixel, for the explanation ratio."""
    explanation_least_share: float = 0.001
    """Share of `explanation_pixels` that the object must cover for a ratio other than 0."""


@dataclass(frozen=True)
class EnvironmentPreset:
    """The environment field F_e: a spherical volume of raw density and log radiance. Lengths are in radii of the object's
    sphere. Costs are added to the mean tone-mapped photometric error. A fraction is the part of F_e's learning that is done,
    0..1. Where no source is given, a value was found by trials on the rendered captures (docs/lab)."""

    resolutions: tuple[tuple[int, int], ...] = ((20, 32), (28, 64), (40, 96))
    """(shells, rows) of the grid, coarse to fine; there are twice as many columns as rows."""
    refine_at: tuple[float, ...] = (0.15, 0.4)
    """Fractions at which the next resolution starts."""
    model: str = "field"
    """field; infinite: a 2-D environment map at infinity, as NeRO and nvdiffrec assume (an ablation); none: the photos
    are cut-outs and show no surroundings (`scene_analysis` decides)."""
    outer_radius: float = 32.0
    """Radius of the sky shell."""
    density_gain: float = 16.0
    """Optical depth per unit of softplus(raw density) and of dt / |x|."""
    initial_raw_density: float = -4.0
    """Raw density at the start, before softplus: nearly clear. Starting at -7 was worse."""
    march_step: float = 1.0
    """Longest march step, in spacings of the shells."""
    camera_near: float = 0.6
    """Nothing is nearer to a camera than this, in both fields' rendering: else F_e paints each photo on a screen before its
    camera."""
    gradient_near: float = 2.0
    """Gradients of samples at a distance t < this from the camera are scaled by (t / this)^2 (Philip and Deschaintre 2023,
    "Floaters No More"); 0: no scaling."""
    transmittance_limit: float = 1e-3
    """A ray ends where less than this share of the light comes through: it saves time."""
    depth_limit: float = 1e-5
    """Samples of less optical depth are skipped: it saves time."""
    learning_rate: float = 0.05
    """Learning rate of Adam, units of raw density and of log radiance."""
    rate_decay_from: float = 0.5
    """Fraction from which on the learning rate falls geometrically."""
    last_rate: float = 0.1
    """Share of itself that the learning rate has at the end."""
    adam_betas: tuple[float, float] = (0.9, 0.99)
    """Adam's decay rates of the mean gradient and of the mean square. With Adam's own 0.999 the mean square would remember
    most of all steps."""
    adam_eps: float = 1e-8
    """Adam's epsilon, added to the root of the mean square. Adam's own."""
    density_variation: float = 1e-3
    """Cost of the total variation of the raw density, from node to node."""
    color_variation: float = 1e-3
    """Cost of the total variation of the log radiance, from node to node."""
    variation_softness: float = 0.05
    """Differences between nodes below this cost quadratically, above linearly: edges are allowed."""
    density_penalty: float = 1e-3
    """Cost of the mean of softplus(raw density): what the photos do not show to be opaque stays clear."""
    foreground_opacity: float = 0.05
    """Cost of opacity between a camera and the place where its ray is nearest to the object. Without it fog grows there,
    different for each photo, and lamps are learned 12 to 19 % too bright, so as to shine through it."""
    regularised_fraction: float = 0.25
    """Share of the shells whose priors each step computes, drawn anew: all of them took as long as the rendering."""
    coverage_weight: float = 0.3
    """Rays' worth of weight from which on a node counts as seen, of `coverage_rays` camera rays."""
    coverage_rays: int = 200_000
    """Camera rays by which the coverage is measured, once F_e is learned."""
    rays_per_step: int = 4096
    """Rays a step where F_e is learned alone on a given mesh."""
    steps: int = 2000
    """Steps where F_e is learned alone on a given mesh."""


@dataclass(frozen=True)
class SurfacePreset:
    """From the object field to a mesh."""

    grid: int = 224
    """Marching-cubes samples along each side of [-1, 1]^3."""
    faces: int = 24_000
    """Face budget after decimation; xatlas takes about 3 s for 20,000 faces and 14 s for 60,000."""
    atlas_texels: int = 1024
    """Side of the UV atlas while packing, texels: the unit of `padding_texels`."""
    padding_texels: int = 3
    """Free texels between charts, so that dilated seams do not meet."""


@dataclass(frozen=True)
class MaterialPreset:
    """Stage 2, material learning. Residuals and costs are in tone-mapped radiance, 0..1 up to white. Where no source is
    given, a value was found by trials on the rendered captures (docs/lab)."""

    samples: int = 30_000
    """Photo pixels that the materials are learned from."""
    least_cosine: float = 0.25
    """Cosine between normal and view direction below which a pixel is grazing, and is left out."""
    roughness_levels: tuple[float, ...] = (0.04, 0.07, 0.1, 0.13, 0.17, 0.22, 0.28, 0.36, 0.46, 0.6, 0.78, 1.0)
    """Roughnesses (Principled's) at which the specular light is prefiltered."""
    diffuse_cones: int = 8
    """Cones of the diffuse lobe (paper, section 3.3), where what a ray hits is shaded."""
    specular_cones: int = 4
    """Cones of the specular lobe (paper, section 3.3): where what a ray hits is shaded, and for each roughness level of what
    the photos show."""
    irradiance_cones: int = 32
    """Cones of the diffuse lobe of what the photos show; these are traced once."""
    use_cones: bool = True
    """False: as many infinitely thin rays (the paper's ablation without cones)."""
    levels: int = 2
    """N, surface interactions by the rendering equation before the terminal MLP; 0: no indirect light (an ablation)."""
    terminal_steps: int = 300
    """Steps of Adam for the terminal MLP."""
    residual: bool = True
    """Whether the light that no photo shows is learned from the object's reflections of it; False is an ablation."""
    unseen_rows: int = 32
    """Rows of the map of the light that no photo shows; there are twice as many columns."""
    unseen_samples: int = 8000
    """Photo pixels that this light is learned from."""
    unseen_steps: int = 80
    """Steps of Adam each time that this light is learned; another roughness is tried for half as many."""
    unseen_smoothness: float = 0.02
    """Cost of the map's total variation, from texel to texel."""
    unseen_prior: float = 1e-2
    """Cost of the map's mean: light that is made up must explain more than it costs."""
    unseen_color: float = 0.01
    """Cost of the share of the map's flux that is not grey: colored light on a grey object looks like white light on a
    colored object."""
    label_pixels: int = 240_000
    """Pixels that say which material lies where, by the light of the samples beside them."""
    metallic: tuple[float, ...] = (0.0, 1.0)
    """Values of metallic whose residuals are compared."""
    metal_margin: float = -0.03
    """Share of the residual by which a metal must be better than a dielectric; less than 0: it may be worse. This is a prior
    for what photos cannot tell; 0 turns it off. Measured on rendered objects: the wrong one was 18 to 48 % worse at the end,
    and 1 to 6 % worse in the first round, before the light was found."""
    sure_margin: float = 0.15
    """Once every material's residual was worse by this share with metallic swapped, that is not tried again; inf: it is
    tried every time."""
    least_roughness: float = 0.04
    """Smallest roughness (Principled's) that a material may have."""
    clip: float = 0.25
    """Residuals above this count no more: they come from wrong geometry and not from the material."""
    region: float = 0.12
    """Width of the regions of the surface from which candidate materials come, object radii."""
    candidates: int = 120
    """Candidate materials, at most: those of the regions with the most samples."""
    most_materials: int = 6
    """Materials in the palette, at most."""
    gain: float = 0.05
    """Share by which a further material must lower the residual."""
    least_share: float = 0.01
    """Share of the samples that a material must have; others are dropped."""
    merge_hue: float = 0.09
    """Distance in chromaticity below which two materials are one; 0 turns this prior off."""
    merge_roughness: float = 0.08
    """Difference in roughness below which two metals of one chromaticity are one."""
    blend_margin: float = 0.05
    """Share by which a mixture of two materials must be better than each of them alone."""
    rounds: int = 2
    """Rounds of fitting the palette, assigning it to the samples and updating the indirect light."""
    most_texels: int = 1024
    """Largest side of a texture, texels; below it the photos' own sampling density decides."""
    uniform_texels: int = 128
    """Largest side of a texture where one material explains the photos, texels."""


@dataclass(frozen=True)
class Preset:
    """All settings of one job."""

    name: str = "balanced"
    max_pixels_per_photo: int = 250_000
    """Photos are box-filtered down until they have at most this many pixels."""
    max_pixels: int = 256_000_000
    """Pixels of all photos together, at most: with more, each photo is filtered down further. A pixel takes 8 bytes of disk
    or GPU memory."""
    pixels_in_memory: int = 32_000_000
    """Pixels of all photos together that are kept in memory. More of them lie in a nameless file in the asset's folder, in
    half precision, and are read from there."""
    fields_seconds: float = 140.0
    """Seconds that fields learning takes on two cores: a first guess of the time left, corrected as the job runs.

    The sidebar shows the sum of the three before a first job. backend/engine/timings.py repeats it, because Blender's Python
    does not import this package; a test compares the two."""
    surface_seconds: float = 9.0
    """As `fields_seconds`, of the surface."""
    material_seconds: float = 85.0
    """As `fields_seconds`, of material learning."""
    even_exposure: bool = True
    """Whether the exposure and white balance of each photo are found, where they differ, and evened out
    (`capture.exposure`)."""
    skip_needless: bool = True
    """Whether parts that the scene does not need are left out (`scene_analysis`); False: do everything."""
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
        fields_seconds=45,
        surface_seconds=3,
        material_seconds=45,
        environment_height=128,
        fields=FieldsPreset(background_steps=200, steps=700, object_rays=1280, sphere_rays=768, outside_rays=768),
        environment=EnvironmentPreset(resolutions=((20, 32), (28, 64)), refine_at=(0.25,), steps=600),
        surface=SurfacePreset(grid=144, faces=10_000, atlas_texels=512),
        material=MaterialPreset(
            samples=12_000, label_pixels=60_000, terminal_steps=150, unseen_samples=4000, unseen_steps=60, most_texels=512
        ),
    ),
    "balanced": Preset(),
    "quality": Preset(
        name="quality",
        max_pixels_per_photo=650_000,
        fields_seconds=400,
        surface_seconds=20,
        material_seconds=200,
        environment_height=512,
        fields=FieldsPreset(background_steps=400, steps=4500, object_rays=2048, last_sharpness=400),
        environment=EnvironmentPreset(steps=4000),
        surface=SurfacePreset(grid=288, faces=60_000, atlas_texels=2048),
        material=MaterialPreset(samples=80_000, label_pixels=600_000, unseen_samples=16_000, most_texels=2048),
    ),
}


def preset(name: str) -> Preset:
    """The named preset: preview, balanced or quality. Raises KeyError for another name."""
    return PRESETS[name]
