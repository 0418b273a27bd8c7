"""Presets: every number that a user or an ablation may change, with its unit and its source.

`preview`, `balanced` and `quality` are points on one run-time-against-error curve, not different programs.
"""

from __future__ import annotations

from dataclasses import dataclass, field


@dataclass(frozen=True)
class FieldsPreset:
    """Stage 1, fields learning. Lengths in object radii."""

    background_steps: int = 300
    """Steps of F_e alone before; then the object starts from its visual hull."""
    steps: int = 1500
    """Steps of both fields together; fractions below are of these."""
    least_outside: float = 0.05
    """Share of the pixels that must miss the sphere for F_e to be learned first."""
    least_contrast: float = 2.0
    """A hull's silhouette values inside over outside; under it the SDF starts from a sphere."""
    environment_gradient_scale: float = 0.1
    """Scale of F_e's gradients from pixels that see the object's sphere, until `environment_gradient_scale_until`."""
    environment_gradient_scale_until: float = 0.5
    object_rays: int = 1536
    """Rays a step through pixels in which the object is seen; before the first look, in which its sphere is."""
    object_pixels_at: tuple[float, ...] = (0.25, 0.5, 0.75)
    """When to look in which pixels the object is seen."""
    validate_every: float = 0.05
    """How often the error on held-out pixels is measured, from the first look on."""
    patience: int = 3
    least_gain: float = 0.005
    """While the last so many checks have not lowered the error by this share, learning runs four times as fast towards
    its end."""
    sphere_rays: int = 1024
    """Rays a step through any pixels that see the object's sphere."""
    outside_rays: int = 1024
    """Rays a step through all other pixels."""
    near: float = 0.6
    """Nothing is nearer to a camera than this: else F_e paints each photo on a screen before its camera."""
    coarsest_cells: int = 16
    first_levels: int = 3
    last_levels: int = 4
    """The finest SDF grid has coarsest_cells * 2^(last_levels - 1) cells an axis."""
    fine_from: float = 0.45
    initial_radius: float = 0.6
    head_width: int = 64
    first_sharpness: float = 12.0
    """NeuS sharpness at the start where the SDF is a sphere, 1 / object radius; `hull_sharpness` from a hull."""
    hull_sharpness: float = 40.0
    last_sharpness: float = 300.0
    sharpness_until: float = 0.85
    coarse_until: float = 0.2
    first_samples: int = 32
    """Samples a ray in the object until `coarse_until`, while the band is wide; then `samples`."""
    samples: int = 16
    opaque: float = 5e-3
    """F_e behind the object is not rendered where less than this shows through."""
    sdf_rate: float = 0.003
    """Typical step of a touched spline coefficient, object radii."""
    head_rate: float = 5e-3
    slow_from: float = 0.3
    last_rate: float = 0.03
    """From `slow_from` on both rates fall, to this share of themselves at the end."""
    eikonal: float = 0.02
    curvature: float = 5e-4
    """Weight of the mean of sqrt(|Hessian of the SDF|^2 + 1) at surface points, in 1 / object radius, until half time;
    it then falls to `last_curvature`."""
    last_curvature: float = 1e-4
    mask: float = 0.5
    highlight_threshold: float = 3.0
    """What is brighter than so many geometric means of what the photos show around the object counts little where the object
    is seen: highlights move with the camera, say little of the shape, and would rule the error. inf: they count in full."""
    dynamic_weight: str = "none"
    """none, paper (eq. 5 as printed) or scaled: see fields_learning.dynamic_weight."""
    decomposition: bool = True
    """False: one radiance head of position, normal and view direction, as in plain NeuS (an ablation)."""
    least_explanation_ratio: float = 1.4
    """How much better the object must explain its pixels than F_e alone; 0 turns the check off. Measured: 0.6 and
    1.1 for spheres of air, 1.9 to 8.6 for objects."""


@dataclass(frozen=True)
class EnvironmentPreset:
    """The environment field F_e: a spherical volume of raw density and log radiance."""

    resolutions: tuple[tuple[int, int], ...] = ((20, 32), (28, 64), (40, 96))
    """(shells, rows) of the grid, coarse to fine; there are twice as many columns as rows."""
    refine_at: tuple[float, ...] = (0.15, 0.4)
    """Fractions of the training at which the next resolution starts."""
    model: str = "field"
    """field; infinite: a 2-D environment map at infinity, as NeRO and nvdiffrec assume (an ablation); none: the photos
    are cut-outs and show no surroundings (`scene_analysis` decides)."""
    outer_radius: float = 32.0
    """Radius of the sky shell, in radii of the object's sphere."""
    density_gain: float = 16.0
    """Optical depth per unit of softplus and of dt / |x|."""
    initial_raw_density: float = -4.0
    steps_per_shell_inverse: float = 1.0
    """March step over shell spacing."""
    camera_near: float = 0.6
    """No density nearer to a camera than this (unit radii): each camera would paint its own floaters."""
    gradient_near: float = 2.0
    """Gradients of samples nearer to the camera are scaled by (t / this)^2; 0 for none."""
    transmittance_limit: float = 1e-3
    depth_limit: float = 1e-5
    """Samples of less optical depth are skipped."""
    learning_rate: float = 0.05
    adam_eps: float = 1e-8
    density_variation: float = 1e-3
    color_variation: float = 1e-3
    variation_softness: float = 0.05
    """Raw differences below this cost quadratically, above linearly."""
    density_penalty: float = 1e-3
    foreground_opacity: float = 0.05
    """Cost of opacity between a camera and the place where its ray is nearest to the object, in tone-mapped error. Without
    it fog grows there, different for each photo, and lamps grow too bright to shine through it."""
    regularised_fraction: float = 0.25
    """Part of the shells that each step regularises."""
    coverage_weight: float = 0.3
    """Rays' worth of weight from which on a node counts as seen, of `coverage_rays` camera rays."""
    coverage_rays: int = 200_000
    rays_per_step: int = 4096
    """Background rays a step where F_e is learned alone."""
    steps: int = 2000
    """Steps where F_e is learned alone."""


@dataclass(frozen=True)
class SurfacePreset:
    """From the object field to a mesh."""

    grid: int = 224
    """Marching-cubes samples along each side of [-1,1]^3."""
    faces: int = 24_000
    """Face budget after decimation; xatlas takes about 3 s for 20,000 faces and 14 s for 60,000."""
    atlas_texels: int = 1024
    """Side of the UV atlas while packing, texels: the unit of `padding_texels`."""
    padding_texels: int = 3
    """Free texels between charts, so that dilated seams do not meet."""


@dataclass(frozen=True)
class MaterialPreset:
    """Stage 2, material learning."""

    samples: int = 30_000
    """Photo pixels that the materials are learned from."""
    least_cosine: float = 0.25
    """Pixels seen at a smaller cosine are grazing and left out."""
    roughness_levels: tuple[float, ...] = (0.04, 0.07, 0.1, 0.13, 0.17, 0.22, 0.28, 0.36, 0.46, 0.6, 0.78, 1.0)
    """Roughnesses at which the specular light is prefiltered."""
    diffuse_cones: int = 8
    specular_cones: int = 4
    """Cones a lobe (paper, section 3.3), where what a ray hits is shaded."""
    irradiance_cones: int = 32
    """Cones of the diffuse lobe of what the photos show; these are traced once. The specular lobe has specular_cones for
    each roughness level."""
    use_cones: bool = True
    """False: as many infinitely thin rays (the paper's ablation without cones)."""
    levels: int = 2
    """N, surface interactions by the rendering equation before the terminal MLP; 0: no indirect light."""
    terminal_steps: int = 300
    """Of Adam, for the terminal MLP."""
    residual: bool = True
    """Learn the light that no photo shows from the object's reflections of it."""
    unseen_rows: int = 32
    """Rows of the map of that light."""
    unseen_samples: int = 8000
    """Photo pixels that it is learned from."""
    unseen_steps: int = 80
    """Of Adam, each time that it is learned; another roughness is tried for half as many."""
    unseen_smoothness: float = 0.02
    """Cost of its total variation, tone-mapped from texel to texel, in tone-mapped error."""
    unseen_prior: float = 1e-2
    """Cost of its mean, tone-mapped, in tone-mapped error: light made up must explain more than it costs."""
    unseen_color: float = 0.01
    """Cost of the share of its flux that is not grey: colored light on a grey thing looks like the reverse."""
    label_pixels: int = 240_000
    """Pixels that say where which material lies, by the light of the samples beside them."""
    metallic: tuple[float, ...] = (0.0, 1.0)
    """Hypotheses compared by their residual."""
    metal_margin: float = -0.03
    """Share of the residual by which a metal must be better than a dielectric (less than 0: may be worse): a prior for what
    photos cannot tell, 0 turns it off. Of rendered objects the wrong one was 18 to 48 % worse at the end, 1 to 6 % in a
    first round, before the light was found."""
    sure_margin: float = 0.15
    """Once every material was worse by this share the other way round, it is not tried again; inf: always."""
    least_roughness: float = 0.04
    clip: float = 0.25
    """Residuals (tone-mapped, 0..1) above it count no more: they are wrong geometry, not material."""
    region: float = 0.12
    """Width of the regions that candidate materials come from, unit frame."""
    candidates: int = 120
    most_materials: int = 6
    gain: float = 0.05
    """A further material must lower the residual by this share."""
    least_share: float = 0.01
    """Materials on a smaller share of the samples are dropped."""
    merge_hue: float = 0.09
    merge_roughness: float = 0.08
    """Materials nearer than this in chromaticity (and metals in roughness) are one; 0 turns the prior off."""
    blend_margin: float = 0.05
    """A mixture of two materials must be better than each alone by this share."""
    rounds: int = 2
    """Of fitting the palette, assigning it and updating the indirect light."""
    most_texels: int = 1024
    """Largest side of a texture; the photos' own sampling density decides below it."""
    uniform_texels: int = 128
    """Largest side where one material explains the photos."""


@dataclass(frozen=True)
class Preset:
    """All settings of one job."""

    name: str = "balanced"
    max_pixels_per_photo: int = 250_000
    """Photos are box-filtered down until they have at most this many pixels."""
    max_pixels: int = 256_000_000
    """Of all photos together: with more, each is filtered down further. 8 bytes a pixel of disk or GPU memory."""
    pixels_in_memory: int = 32_000_000
    """With more, they lie in a nameless file in the asset's folder, in half precision, and are read from there."""
    fields_seconds: float = 95.0
    surface_seconds: float = 5.0
    material_seconds: float = 70.0
    """What the three long stages take on two cores: first guess of the time left, corrected as the job runs."""
    even_exposure: bool = True
    """Find the exposure and white balance of each photo, where they differ, and even them out (`capture.exposure`)."""
    skip_needless: bool = True
    """Leave out what the scene does not need (`scene_analysis`); False: do everything."""
    environment_height: int = 256
    """Rows of environment.exr."""
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
