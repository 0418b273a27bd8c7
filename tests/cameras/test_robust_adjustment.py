"""The last adjustment of cameras that were found: features on reflections must not pull the cameras."""

from __future__ import annotations

import json
import sys

import numpy as np

from support.own_process import run_file


def in_pycolmap() -> None:
    """Print the mean errors of camera positions after a plain adjustment, and after the robust one.

    Twelve cameras around 200 points, whose features are 0.2 pixels off. Every eighth point is a reflection in a bent
    mirror: its features move by up to 8 pixels with the camera, as those of no point that stands still.
    """
    import pycolmap

    from blender_nep.cameras.matching.adjustment import adjust_robustly, adjustment

    pycolmap.set_random_seed(0)
    random = np.random.default_rng(0)
    options = pycolmap.SyntheticDatasetOptions()
    options.num_rigs, options.num_cameras_per_rig, options.num_frames_per_rig = 1, 1, 12
    options.num_points3D, options.num_points2D_without_point3D = 200, 0
    model = pycolmap.synthesize_dataset(options)
    truth = positions(model)
    bends = random.normal(size=(3, 2))
    for place, number in zip(truth, model.reg_image_ids(), strict=True):
        for point in model.images[number].points2D:
            reflected = point.has_point3D() and point.point3D_id % 8 == 0
            point.xy = point.xy + random.normal(size=2) * 0.2 + (8 * np.sin(place @ bends) if reflected else 0)
    robust = pycolmap.Reconstruction(model)
    pycolmap.bundle_adjustment(model, adjustment(pycolmap, 1))
    adjust_robustly(pycolmap, robust, 1)
    print(json.dumps([error(pycolmap, positions(adjusted), truth) for adjusted in (model, robust)]))


def positions(model) -> np.ndarray:
    return np.array([model.images[i].projection_center() for i in model.reg_image_ids()])


def error(pycolmap, found: np.ndarray, truth: np.ndarray) -> float:
    """Mean distance to the truth after the best similarity, in distances of the cameras from their middle."""
    carry = pycolmap.estimate_sim3d(found, truth)
    moved = np.array([carry * place for place in found])
    return float(np.linalg.norm(moved - truth, axis=1).mean() / np.linalg.norm(truth - truth.mean(0), axis=1).mean())


def test_some_reflections_do_not_pull_the_cameras():
    done = run_file(__file__, "in_pycolmap", timeout=120)
    assert done.returncode == 0, done.stderr[-2000:]
    plain, robust = json.loads(done.stdout.splitlines()[-1])
    assert robust < 0.3 * plain, f"{plain:.5f} -> {robust:.5f}"


if __name__ == "__main__":
    globals()[sys.argv[1]]()
