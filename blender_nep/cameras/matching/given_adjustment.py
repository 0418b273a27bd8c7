"""Improves cameras that are given, in pycolmap's process.

It runs in the process of `matching_process`, and imports no more of the package than that one.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from blender_nep.cameras.matching.adjustment import MEDIAN_3D, SEED, adjustment, agreement, support
from blender_nep.cameras.matching.matching_output import say, write

_WIDE, _ROUNDS = 12.0, 4
"""Largest distance [pixels] between a feature and its scene point in the first round of improving given cameras, and the
number of rounds. The last round has pycolmap's own limit of 4 pixels."""
_INEXACT = 5.0
"""Errors of features count as so many times larger than they look, beside the given positions: features of one place err in
the same way in many photos."""
_AS_GOOD = 1.05
"""The lens stays as given if the features then agree as well, up to this factor."""
_ALIGNED = 20.0
"""The given positions count for the frame up to so many standard deviations."""


def improve(pycolmap: Any, folder: Path, settings: dict) -> None:
    """Improve given cameras: find scene points with them, and adjust cameras and points to the features; several rounds.

    The lens is adjusted, too. It is as given in the end if the features agree as well then.
    """
    model = _given_model(pycolmap, folder, settings)
    options = pycolmap.IncrementalPipelineOptions()
    options.num_threads, options.random_seed, options.extract_colors = settings["threads"], SEED, False
    adjusting = adjustment(pycolmap, settings["threads"])
    adjusting.refine_extra_params = all(lens["refined"] for lens in settings["lenses"])
    adjusting.ceres.loss_function_type = pycolmap.LossFunctionType.SOFT_L1
    (folder / "round").mkdir()
    before, lenses = {}, {number: camera.params.copy() for number, camera in model.cameras.items()}
    for number in range(_ROUNDS):
        say("places", number, _ROUNDS)
        limit = _WIDE if number == 0 else 4.0
        options.mapper.filter_max_reproj_error = options.triangulation.complete_max_reproj_error = limit
        model = pycolmap.triangulate_points(
            model, folder / "database.db", Path(settings["images"]), folder / "round", clear_points=True, options=options
        )
        if number == 0:
            before = {model.images[i].name: support(model, model.images[i]) for i in model.reg_image_ids()}
        pycolmap.bundle_adjustment(model, adjusting)
    refined = _adjust_held(pycolmap, model, adjusting, settings["given"])
    for camera in model.cameras.values():
        camera.params = lenses[camera.camera_id]
    adjusting.refine_focal_length = adjusting.refine_extra_params = False
    as_given = _adjust_held(pycolmap, model, adjusting, settings["given"])
    model = as_given if agreement(as_given) < _AS_GOOD * agreement(refined) else refined
    say("places", _ROUNDS, _ROUNDS)
    write(folder, [(model, {"before": before})])


def _adjust_held(pycolmap: Any, model: Any, adjustment: Any, given: dict) -> Any:
    """The model after another adjustment to the features, with the given positions as a prior.

    Photos from below show few points, and mostly points that other such photos show. Without the prior, all of them leave
    their places together. How inexact the given positions are is told by how far the cameras have moved.
    """
    photos = [model.images[i] for i in model.reg_image_ids()]
    positions = np.array([given[image.name]["position"] for image in photos])
    found = np.array([image.projection_center() for image in photos])
    carry = pycolmap.estimate_sim3d(found, positions) if len(photos) >= 3 else None
    if carry is None:
        return model
    moved = np.linalg.norm(np.array([carry * place for place in found]) - positions, axis=1)
    spread = max(float(np.median(moved)) / MEDIAN_3D, 1e-9 * float(np.ptp(positions)))
    in_pixels = spread / max(_INEXACT * agreement(model), 1e-6)  # beside features whose places have a deviation of 1 pixel
    configuration, priors = pycolmap.BundleAdjustmentConfig(), []
    for image, position in zip(photos, positions, strict=True):
        configuration.add_image(image.image_id)
        prior = pycolmap.PosePrior(pose_prior_id=image.image_id, corr_data_id=image.data_id, position=position)
        prior.position_covariance = np.eye(3) * in_pixels**2
        prior.coordinate_system = pycolmap.PosePriorCoordinateSystem.CARTESIAN
        priors.append(prior)
    options = pycolmap.PosePriorBundleAdjustmentOptions()
    options.alignment_ransac.random_seed, options.alignment_ransac.max_error = SEED, _ALIGNED * spread
    options.ceres.prior_position_loss_function_type = pycolmap.LossFunctionType.CAUCHY
    adjusted = pycolmap.Reconstruction(model)
    pycolmap.create_pose_prior_bundle_adjuster(adjustment, options, configuration, priors, adjusted).solve()
    return adjusted


def _given_model(pycolmap: Any, folder: Path, settings: dict) -> Any:
    """The given cameras as a COLMAP model without scene points, under the database's numbers."""
    with pycolmap.Database.open(str(folder / "database.db")) as opened:
        images = {image.name: image for image in opened.read_all_images()}
    lens_of = {name: lens for lens in settings["lenses"] for name in lens["names"]}
    cameras, poses = {}, []
    for name, pose in settings["given"].items():
        lens, image = lens_of[name], images[name]
        size = f"{lens['width']} {lens['height']}"
        cameras[image.camera_id] = f"{lens['model']} {size} " + " ".join(map(repr, lens["params"]))
        numbers = " ".join(map(repr, (*pose["quaternion"], *pose["translation"])))
        poses.append(f"{image.image_id} {numbers} {image.camera_id} {name}\n\n")
    given = folder / "given"
    given.mkdir()
    texts = {"cameras": "".join(f"{n} {text}\n" for n, text in cameras.items()), "images": "".join(poses), "points3D": ""}
    for name, text in texts.items():
        (given / f"{name}.txt").write_text(text, encoding="utf-8")
    model = pycolmap.Reconstruction()
    model.read_text(str(given))
    return model
