"""Bundle adjustment of COLMAP models in pycolmap's process, and how well a model agrees with its features.

It runs in the process of `matching_process`, and imports no more of the package than that one.
"""

from __future__ import annotations

from typing import Any

import numpy as np

SEED = 0
"""Of every random number of pycolmap"""
MEDIAN_2D, MEDIAN_3D = 1.177, 1.538
"""Median length of a vector of two or three normal numbers, in standard deviations; as in `improved_cameras`, which this
process must not import"""
_CAUCHY, _LEAST_SCALE, _ADJUSTMENTS = 2.385, 0.1, 2
"""After the mapping, errors of features count by Cauchy's loss, which bends at so many standard deviations, and not below so
many pixels. Where all errors are normal, it is 95 % as exact as least squares (Zhang, "Parameter estimation techniques",
1997). The last number is that of adjustments."""


def adjustment(pycolmap: Any, threads: int) -> Any:
    """Options of a bundle adjustment of poses, lenses and points."""
    options = pycolmap.BundleAdjustmentOptions()
    options.print_summary = False
    options.ceres.solver_options.num_threads = threads
    return options


def adjust_robustly(pycolmap: Any, model: Any, threads: int) -> None:
    """Adjust the model to its features once more, so that features which do not fit count little.

    The mapping sums squares of errors. Some features are reflections, which move over the object with the camera. There are
    few of them, and they are far enough off to pull all cameras. A lens that was mapped with one number for its distortion
    gets a second one here. While few photos are placed, two numbers can take any values, and further photos do not fit then.
    """
    for camera in model.cameras.values():
        if camera.model == pycolmap.CameraModelId.SIMPLE_RADIAL:
            one = list(camera.params)
            camera.model = pycolmap.CameraModelId.RADIAL
            camera.params = [*one, 0.0]
    options = adjustment(pycolmap, threads)
    options.ceres.loss_function_type = pycolmap.LossFunctionType.CAUCHY
    for _ in range(_ADJUSTMENTS):
        options.ceres.loss_function_scale = float(np.fmax(_CAUCHY * agreement(model), _LEAST_SCALE))
        pycolmap.bundle_adjustment(model, options)


def agreement(model: Any) -> float:
    """Standard deviation [pixels] of the places of features, in the median over the photos."""
    return float(np.nanmedian([support(model, model.images[i])["error"] for i in model.reg_image_ids()])) / MEDIAN_2D


def support(model: Any, image: Any) -> dict[str, float]:
    """How many scene points a photo shows, and its median error [pixels]."""
    points = [point for point in image.points2D if point.has_point3D()]
    errors = [_error(model, image, point) for point in points]
    return {"points": len(points), "error": float(np.median(errors)) if errors else float("nan")}


def _error(model: Any, image: Any, point: Any) -> float:
    """Distance [pixels] between a feature and the projection of its 3-D point."""
    place = image.project_point(model.points3D[point.point3D_id].xyz)
    return float("inf") if place is None else float(np.linalg.norm(place - point.xy))
