"""The settings of a whole job, and the three presets that users choose from."""

from __future__ import annotations

from dataclasses import dataclass, field

from blender_nep.presets.environment import EnvironmentPreset
from blender_nep.presets.fields import FieldsPreset
from blender_nep.presets.material import MaterialPreset
from blender_nep.presets.surface import SurfacePreset


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
    """Whether differences between the photos in exposure and white balance are found and evened out (`capture.exposure`)."""
    brightness: float = 0.25
    """The photos are made so bright that the typical radiance of the pixels that see the object's sphere is this
    (`capture.brightness`). Here the tone mapping turns from linear to logarithmic. 0: they stay as they are, which is an
    ablation."""
    turntable: bool = True
    """Whether the light stands still where the object turned (`PixelRays.turntable`). False: the light turns with it,
    as if the camera had moved around it, which is an ablation."""
    skip_needless: bool = True
    """Whether parts that the scene does not need are left out (the package `scene`). False: nothing is left out."""
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
            samples=12_000,
            label_pixels=60_000,
            terminal_steps=150,
            unseen_samples=4000,
            turning_unseen_samples=12_000,
            unseen_steps=60,
            most_texels=512,
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
