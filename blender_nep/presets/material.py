"""The settings of material learning."""

from __future__ import annotations

from dataclasses import dataclass

EVIDENCE = ("residual", "spread", "hue", "third_moment", "regions")
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
    camera_response: bool = True
    """Whether the camera's response curve is found and undone. False is an ablation."""
    object_gains: bool = True
    """Whether it is found how much brighter the object is in some photos than in others. False is an ablation."""
    photographer: bool = True
    """Whether it is found how much light the photographer takes from the object. False is an ablation."""
    response_prior: float = 0.02
    """Cost of a response curve whose strength is off by 1 from the one that the photo files make likely, as a share of the
    error."""
    learn_unseen_light: bool = True
    """Whether the light that no photo shows is learned from the object's reflections of it. False is an ablation."""
    unseen_rows: int = 32
    """Rows of the map of the unseen light; there are twice as many columns."""
    unseen_samples: int = 8000
    """Number of photo pixels from which the unseen light is learned."""
    turning_unseen_samples: int = 24_000
    """The same, if the object turned: then reflections tell nearly all of the light, and with few samples, the map follows
    their noise."""
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
    """Cost of the deviation of the map's form from the expected one, so that it changes only if that explains the photos
    better."""
    unseen_scale: float = 0.001
    """Cost of a map that is brighter or darker as a whole than expected, for each unit of the logarithm. It is small,
    because what the object reflects tells more, and not 0, because photos of one metal may tell nothing."""
    unseen_color: float = 0.01
    """Cost of the share of the map's flux that is not gray. It is needed because colored light on a gray object looks like
    white light on a colored object."""
    label_pixels: int = 240_000
    """Number of label pixels: pixels that show which material lies where. Their light is that of the nearest samples. There
    are three times as many if the materials vary."""
    metallic: tuple[float, ...] = (0.0, 1.0)
    """Values of metallic that are tried."""
    without: tuple[str, ...] = ()
    """Names of the evidence that does not count. Each is an ablation."""
    metal_margin: float = -0.03
    """Share by which the residual of a metal must be lower than that of a dielectric; below 0: may be higher. This prior
    decides where the photos do not. On rendered objects, the residual of the wrong class is 18 to 48 % higher."""
    hue_margin: float = 0.15
    """Largest share by which the hue of what differs between photos changes a metal's residual (`evidence.hue`), and what
    regions say of its class (`evidence.regions`)."""
    metals_are_bright: float = 0.17
    """Share of the error that a metal costs for each unit of the logarithm by which it is darker than metals are, where the
    light that no photo shows decides (`materials.metal_brightness`). 0 turns this prior off."""
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
    smooth_classes: float = 30.0
    """Weight of the differences between neighbors of one color where it is decided which places are metal."""
    unclear_classes: float = 0.65
    """It is decided so if the mean residual is more than this share of the mean difference of the residuals of both classes.
    inf: each place decides alone. Measured: 0.37 for a box in metal and paint, 0.54 to 0.63 for a gradual patina, 0.79 to
    0.81 for a photographed brass."""
    blend_margin: float = 0.05
    """Share by which a mixture of two materials must be better than one material alone."""
    inner_blend_margin: float = 0.25
    """As `blend_margin`, for label pixels whose wider surroundings show one material: there a mixture is mostly noise."""
    varied_gain: float = 0.25
    """Materials may vary from place to place if that lowers the residual of held-out photos by this share. inf: never.
    Measured: 0.34 to 0.55 for a vase in forty paints; -0.20 to 0.16 for seven objects that a palette explains."""
    varied_gain_of_both: float = 0.06
    """The same below `varied_gain` where the palette has metals and dielectrics. Then the palette and edges of color decide
    which places are metal. In the comparison, a sample of a held-out photo has the material of its neighbors in other
    photos. Measured: 0.17 for a photographed tarnished brass, 0.14 for brass, plastic and wood; 0 for a box in metal and
    paint and for a gradual patina."""
    varied_gain_of_metal: float = 0.0
    """The same where all materials of the palette are metals, and so are the segments: with one class, all that explains
    held-out photos better counts. Measured: -0.03 for uniform gold, 0.03 for photographed gilt bronze, 0.16 for gold."""
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
