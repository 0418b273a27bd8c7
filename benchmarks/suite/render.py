"""Renders the captures that the suite makes itself, in Cycles.

    python -m benchmarks.suite.render NAME FOLDER VIEWS SIZE SAMPLES THREADS

suzanne and box are shapes of Blender in the room of `backend/synthetic.py`. gold_0.05 ... gold_0.8 show suzanne in the same
room, with the same cameras and the same gold, but each has another roughness. `scene.blend` is written for relighting.
random_1, random_2 ... are scenes that `backend/synthetic.py --random` draws from that seed, with as many photos as the scene
says, whatever VIEWS is. They have no `scene.blend`. This file needs the extra `bpy`.
"""

from __future__ import annotations

import sys
from pathlib import Path

ROUGHNESSES = (0.05, 0.1, 0.2, 0.35, 0.55, 0.8)
RANDOM = "random_"
RANDOM_TEST_VIEWS = 4
SETS = {"shapes": ("suzanne", "box"), "roughness": tuple(f"gold_{roughness:g}" for roughness in ROUGHNESSES)}


def render(name: str, folder: Path, views: int, size: int, samples: int, threads: int) -> int:
    """Render a capture. transforms.json is written last. Returns an exit code."""
    import bpy

    from backend import synthetic
    from backend.synthetic_capture import scenes
    from benchmarks.scoring.relighting import OBJECT

    if name.startswith(RANDOM):
        chosen = {"random": name.removeprefix(RANDOM), "out": folder, "test-views": RANDOM_TEST_VIEWS}
        chosen |= {"size": size, "samples": samples, "threads": threads}
        return synthetic.main([part for key, value in chosen.items() for part in (f"--{key}", str(value))])
    scene, material = name, scenes.DEFAULT_MATERIAL.get(name)
    if name.startswith("gold_"):
        scene, material = "suzanne", name
        pattern, (gold,) = scenes.MATERIALS["gold"]
        scenes.MATERIALS[name] = pattern, (scenes.Substance(gold.color, float(name[5:]), gold.metallic),)
    build = scenes.build_scene

    def build_and_keep(*arguments, **named):
        bpy.context.scene.render.threads_mode, bpy.context.scene.render.threads = "FIXED", threads
        target, obstacles = build(*arguments, **named)
        target.name = OBJECT
        folder.mkdir(parents=True, exist_ok=True)
        bpy.ops.wm.save_as_mainfile(filepath=str(folder.resolve() / "scene.blend"))
        return target, obstacles

    scenes.build_scene = build_and_keep
    return synthetic.main(
        [
            "--scene",
            scene,
            "--material",
            material,
            "--out",
            str(folder),
            "--views",
            str(views),
            "--size",
            str(size),
            "--samples",
            str(samples),
        ]
    )


if __name__ == "__main__":
    sys.exit(render(sys.argv[1], Path(sys.argv[2]), *map(int, sys.argv[3:])))
