"""Places photos by their matches, in pycolmap's process.

It runs in the process of `matching_process`, and imports no more of the package than that one.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from blender_nep.cameras.adjustment import SEED
from blender_nep.cameras.matching_output import say

_GUESSED_FOCAL = 1.2
"""Focal length in longest sides of a photo, as COLMAP guesses it"""


def mapped(pycolmap: Any, folder: Path, settings: dict) -> list[Any]:
    """The models that COLMAP's incremental mapping finds."""
    (folder / "sparse").mkdir(exist_ok=True)
    threads, count = settings["threads"], sum(len(lens["names"]) for lens in settings["lenses"])
    options = pycolmap.IncrementalPipelineOptions()
    options.num_threads, options.random_seed, options.extract_colors = threads, SEED, False
    options.mapper.random_seed = options.triangulation.random_seed = SEED
    options.min_model_size = min(10, max(3, count // 3))
    done = 0

    def report() -> None:
        nonlocal done
        done += 1
        say("places", min(done, count), count)

    found = pycolmap.incremental_mapping(
        folder / "database.db", settings["images"], folder / "sparse", options, next_image_callback=report
    )
    return [model for _, model in sorted(found.items())]


def placed(models: list[Any]) -> int:
    """Photos in the largest model"""
    return max((model.num_reg_images() for model in models), default=0)


def forget_focal_lengths(pycolmap: Any, folder: Path, verification: Any) -> None:
    """Let all cameras begin with COLMAP's guess of the focal length, and judge the matches again.

    EXIF may tell a focal length that is wrong by a factor, for example in cropped photos. Too few matches agree then.
    """
    with pycolmap.Database.open(str(folder / "database.db")) as opened:
        for camera in opened.read_all_cameras():
            size = camera.width, camera.height
            camera.params = [_GUESSED_FOCAL * max(size), size[0] / 2, size[1] / 2, 0.0, 0.0]
            camera.has_prior_focal_length = False
            opened.update_camera(camera)
        opened.clear_two_view_geometries()
    pycolmap.verify_matches(folder / "database.db", folder / "pairs.txt", verification)
