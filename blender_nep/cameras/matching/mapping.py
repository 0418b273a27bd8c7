"""Places photos by their matches, in pycolmap's process.

It runs in the process of `matching_process`, and imports no more of the package than that one.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from blender_nep.cameras.matching.adjustment import SEED
from blender_nep.cameras.matching.matching_output import say

_GUESSED_FOCAL = 1.2
"""Focal length in longest sides of a photo, as COLMAP guesses it"""
_LEAST_POINTS = 8
"""Scene points that a photo must show after global mapping. Photos with fewer were up to 35 degrees off, and others at most
2.3 (docs/lab/cameras.md)."""


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
    largest model are placed again from its points, if they can be.
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
    models = sorted((model for model in found.values() if model.num_reg_images()), key=lambda m: -m.num_reg_images())
    if not models:
        return []
    models[0].write_binary(str(folder / "start"))
    more = _incremental(pycolmap, settings)
    more.multiple_models = False
    continued = pycolmap.incremental_mapping(
        folder / "database.db", settings["images"], folder / "continued", more, input_path=folder / "start"
    )
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
        model.deregister_frame(frame)
        pycolmap.ObservationManager(model).filter_all_points3D(4.0, 1.5)  # pycolmap's own limits [pixels, degrees]
        taken.append(name)
    return taken


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
