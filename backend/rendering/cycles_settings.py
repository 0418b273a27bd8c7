"""The Cycles settings that all renders of this package share."""

import bpy


def use_cycles(scene: bpy.types.Scene, samples: int, seed: int = 0) -> None:
    """Let `scene` render with Cycles on the CPU, with a fixed number of samples a pixel.

    The render is denoised where this Blender was built with OpenImageDenoise.
    """
    scene.render.engine = "CYCLES"
    scene.cycles.device = "CPU"
    scene.cycles.samples = samples
    scene.cycles.use_adaptive_sampling = False
    scene.cycles.seed = seed
    scene.cycles.use_denoising = has_denoiser()
    if scene.cycles.use_denoising:
        scene.cycles.denoiser = "OPENIMAGEDENOISE"


def has_denoiser() -> bool:
    """Whether this Blender has OpenImageDenoise.

    Debian's Blender does not have it. Denoising then raises an error (4.3) or is ignored (5.2).
    """
    import _cycles

    return bool(_cycles.with_openimagedenoise)
