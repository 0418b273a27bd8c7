"""Places photos by their matches, in pycolmap's process.

It runs in the process of `matching_process`, and imports no more of the package than that one.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from blender_nep.cameras.matching.adjustment import SEED
from blender_nep.cameras.matching.matching_output import say

_GUESSED_FOCAL = 1.2
"""Focal length in longest sides of a photo, as COLMAP guesses it"""
_LEAST_POINTS = 8
"""Scene points that a photo must show after global mapping. Photos with fewer were up to 35 degrees off, and others at most
2.3 (docs/lab/cameras.md)."""

_LEAST_SHARED = 12
"""Two photos hold each other after global mapping if they show so many scene points in common. A group of eight photos that
held each other, and shared fewer points with the others, was 9 to 32 degrees off together."""


def mapped(pycolmap: Any, folder: Path, settings: dict) -> list[Any]:
    """The models that COLMAP's incremental mapping finds."""
    (folder / "sparse").mkdir(exist_ok=True)
    count = sum(len(lens["names"]) for lens in settings["lenses"])
    options = _incremental(pycolmap, settings)
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


def globally_mapped(pycolmap: Any, folder: Path, settings: dict) -> list[Any]:
    """The models of COLMAP's global mapping, the largest one first, without photos that show too few points.

    Global mapping finds all rotations together, so it needs no chain of photos that each share many points with those
    before. It also places photos that hardly anything connects, and these are wrong. The photos that are left out of the
    largest model are placed again from its points, if they can be. So are photos that hardly share points with the others.
    """
    for name in ("global", "start", "continued"):
        (folder / name).mkdir()
    options = pycolmap.GlobalPipelineOptions()
    options.num_threads, options.random_seed = settings["threads"], SEED
    for part in ("rotation_averaging", "global_positioning", "retriangulation"):
        getattr(options.mapper, part).random_seed = SEED
    options.mapper.random_seed = SEED
    options.mapper.global_positioning.use_gpu = options.mapper.bundle_adjustment.ceres.use_gpu = False
    found = pycolmap.global_mapping(folder / "database.db", settings["images"], folder / "global", options)
    for model in found.values():
        take_out_unsupported(pycolmap, model)
        take_out_loose(pycolmap, model)
    models = sorted((model for model in found.values() if model.num_reg_images()), key=lambda m: -m.num_reg_images())
    if not models:
        return []
    models[0].write_binary(str(folder / "start"))
    more = _incremental(pycolmap, settings)
    more.multiple_models = False
    continued = pycolmap.incremental_mapping(
        folder / "database.db", settings["images"], folder / "continued", more, input_path=folder / "start"
    )
    for model in continued.values():
        take_out_loose(pycolmap, model)
    return [max([models[0], *continued.values()], key=lambda model: model.num_reg_images()), *models[1:]]


def take_out_unsupported(pycolmap: Any, model: Any) -> list[str]:
    """Take the photos that show too few scene points out of the model, the worst one first. Returns their names."""
    taken = []
    while model.num_reg_images():
        points, name, frame = min(
            (image.num_points3D, image.name, image.frame_id) for image in map(model.image, model.reg_image_ids())
        )
        if points >= _LEAST_POINTS:
            break
        _take_out(pycolmap, model, [frame])
        taken.append(name)
    return taken


def take_out_loose(pycolmap: Any, model: Any) -> list[str]:
    """Take the photos out of the model that hardly share points with its largest group. Returns their names.

    The photos of a small group may hold each other well and be wrong together, which no photo of it tells.
    """
    numbers = list(model.reg_image_ids())
    if not numbers:
        return []
    row = {number: k for k, number in enumerate(numbers)}
    shared = np.zeros((len(numbers), len(numbers)), int)
    for point in model.points3D.values():
        seen = sorted({row[element.image_id] for element in point.track.elements})
        shared[np.ix_(seen, seen)] += 1
    loose = [model.image(numbers[k]) for k in np.flatnonzero(~_largest_group(shared >= _LEAST_SHARED))]
    names = [image.name for image in loose]
    if names:
        _take_out(pycolmap, model, [image.frame_id for image in loose])
    return names


def _largest_group(linked: np.ndarray) -> np.ndarray:
    """Which of n things belong to the largest group of linked ones, [n] bool. linked [n, n] bool is symmetric."""
    largest, left = np.zeros(len(linked), bool), np.ones(len(linked), bool)
    while left.any():
        group, before = np.zeros_like(left), 0
        group[left.argmax()] = True
        while group.sum() > before:
            before = group.sum()
            group |= linked[group].any(0)
        left &= ~group
        if group.sum() > largest.sum():
            largest = group
    return largest


def _take_out(pycolmap: Any, model: Any, frames: list[int]) -> None:
    """Take frames out of the model, and the points that are not sure without them."""
    for frame in frames:
        model.deregister_frame(frame)
    pycolmap.ObservationManager(model).filter_all_points3D(4.0, 1.5)  # pycolmap's own limits [pixels, degrees]


def _incremental(pycolmap: Any, settings: dict) -> Any:
    """Options of the incremental mapping."""
    options = pycolmap.IncrementalPipelineOptions()
    options.num_threads, options.random_seed, options.extract_colors = settings["threads"], SEED, False
    options.mapper.random_seed = options.triangulation.random_seed = SEED
    return options


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
            camera.params = [_GUESSED_FOCAL * max(size), size[0] / 2, size[1] / 2, 0.0]
            camera.has_prior_focal_length = False
            opened.update_camera(camera)
        opened.clear_two_view_geometries()
    pycolmap.verify_matches(folder / "database.db", folder / "pairs.txt", verification)
