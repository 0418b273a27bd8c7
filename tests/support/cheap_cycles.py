"""Runs what renders, as Python does, but with cheaper pictures: `python cheap_cycles.py SCRIPT.py ...`, or `-m MODULE ...`.

The pictures have their sizes, and few samples. They are not denoised, as in a Blender without OpenImageDenoise: that takes
0.5 CPU seconds for 160 x 160 pixels, and 2 for 320 x 320.
"""

import runpy
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


def make_cheap() -> None:
    """Let the functions that render be cheap in this process."""
    from backend.rendering import cycles_settings
    from backend.scene_io import world
    from support.blender_checks import with_small_light_map

    build_world = world.build_world
    world.build_world = lambda *given, **named: with_small_light_map(build_world(*given, **named))
    cycles_settings.has_denoiser = lambda: False
    from backend.rendering import turntable  # afterwards, because it takes the functions above by their names

    turntable.SAMPLES = 1


if __name__ == "__main__":
    sys.path[:1] = [str(ROOT), str(ROOT / "tests")]
    make_cheap()
    del sys.argv[0], sys.path[:2]
    if sys.argv[0] == "-m":
        del sys.argv[0]
        sys.path.insert(0, str(Path.cwd()))
        runpy.run_module(sys.argv[0], run_name="__main__", alter_sys=True)
    else:
        sys.path.insert(0, str(Path(sys.argv[0]).parent))
        runpy.run_path(sys.argv[0], run_name="__main__")
