"""Renders the captures that the suite makes itself, in Cycles.

    python -m benchmarks.suite.render NAME FOLDER VIEWS SIZE SAMPLES THREADS

suzanne and box are shapes of Blender in the room of `backend/synthetic.py`. gold_0.05 ... gold_0.8 show suzanne in the same
room, with the same cameras and the same gold, but each has another roughness. `scene.blend` is written for relighting.
random_1, random_2 ... are scenes that `backend/synthetic.py --random` draws from that seed, with as many photos as the scene
says, whatever VIEWS is. suzanne_turned and box_turned are on a turntable, with three heights of the camera; suzanne_walked
and box_walked have the same cameras around an object that stands still. These and the random scenes have no `scene.blend`.
OBJECT+EFFECT is a capture of photographs (`--photograph EFFECT`) of suzanne, box, a mesh file or random_1, random_2 ...;
OBJECT+clean has no effect. This file needs the extra `bpy`.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

ROUGHNESSES = (0.05, 0.1, 0.2, 0.35, 0.55, 0.8)
RANDOM = "random_"
RANDOM_TEST_VIEWS = 4
CLEAN = "clean"
"""Takes the place of an effect in the name of a capture without effects"""
TURNED, WALKED = "_turned", "_walked"
"""Endings of the names of a turntable and of its control"""
ROWS = 3
"""Heights of the camera of a turntable"""
SETS = {
    "shapes": ("suzanne", "box"),
    "roughness": tuple(f"gold_{roughness:g}" for roughness in ROUGHNESSES),
    "turntables": tuple(f"{shape}{ending}" for shape in ("suzanne", "box") for ending in (TURNED, WALKED)),
}


def photograph_name(thing: str, effect: str) -> str:
    """The name of the capture of an object with an effect, or CLEAN. A mesh file is named without its folder and ending."""
    return f"{Path(thing).stem}+{effect}"


def random_options(name: str, folder: Path, size: int, samples: int, threads: int) -> list[str]:
    """The options of `synthetic.py` for a random scene."""
    options = ["--random", name.removeprefix(RANDOM), "--out", str(folder), "--test-views", str(RANDOM_TEST_VIEWS)]
    return [*options, "--size", str(size), "--samples", str(samples), "--threads", str(threads)]


def photograph_options(
    thing: str, effect: str, folder: Path, views: int, size: int, samples: int, threads: int
) -> list[str]:
    """The options of `synthetic.py` for photographs of an object with an effect, or CLEAN.

    What a camera's development alone changes is made from the clean capture beside `folder`, where that holds radiance.
    """
    from backend.synthetic_capture.photograph.effects import SCENE, chosen

    clean = folder.parent / photograph_name(thing, CLEAN) / "transforms.json"
    photograph = [] if effect == CLEAN else ["--photograph", effect]
    if photograph and not chosen([effect]).intersection(SCENE) and clean.is_file():
        if json.loads(clean.read_text(encoding="utf-8"))["color_space"] == "linear":
            return ["--develop", str(clean.parent), "--out", str(folder), *photograph]
    if thing.startswith(RANDOM):
        return [*random_options(thing, folder, size, samples, threads), *photograph]
    options = ["--scene", thing, "--out", str(folder), "--views", str(views), "--size", str(size)]
    return [*options, "--samples", str(samples), "--threads", str(threads), "--fast", *photograph]


def turntable_options(name: str, folder: Path, views: int, size: int, samples: int, threads: int) -> list[str]:
    """The options of `synthetic.py` for a turntable, or for its control."""
    shape, _, how = name.rpartition("_")
    options = ["--scene", shape, "--out", str(folder), "--views", str(views), "--size", str(size), "--samples", str(samples)]
    options += ["--threads", str(threads), "--fast", "--turntable", str(ROWS)]
    return [*options, "--walk"] if f"_{how}" == WALKED else options


def render(name: str, folder: Path, views: int, size: int, samples: int, threads: int) -> int:
    """Render a capture. transforms.json is written last. Returns an exit code."""
    import bpy

    from backend import synthetic
    from backend.synthetic_capture import scenes
    from benchmarks.scoring.relighting import OBJECT

    thing, _, effect = name.rpartition("+")
    if thing:
        return synthetic.main(photograph_options(thing, effect, folder, views, size, samples, threads))
    if name.startswith(RANDOM):
        return synthetic.main(random_options(name, folder, size, samples, threads))
    if name in SETS["turntables"]:
        return synthetic.main(turntable_options(name, folder, views, size, samples, threads))
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
