"""The process that runs pycolmap: features, matches, and the cameras. It is started as a program of its own.

    python -m blender_nep.cameras.matching_process FOLDER

FOLDER holds `settings.json` (see `structure_from_motion`) and `images/`. The result is written there: COLMAP models in
`sparse/0`, `sparse/1` and so on, and `result.json`. Standard output carries JSON lines with stage, step and steps. Standard
error carries pycolmap's log.

pycolmap brings a zlib of its own, with which Python's zlib can crash. So this process compresses nothing, reads no PNG by
Pillow, and imports nothing of the package. It brings an SQLite of its own, too: Python's SQLite must not open the database
here, because each of the two would release the other's locks.
"""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path
from typing import Any

import numpy as np

_SEED = 0
_COARSE_FEATURES = 400
"""Features of each photo that choose the pairs: the largest ones, which are seen from many places."""
_LEAST_MATCHES_OF_GIVEN = 8
"""Matches that a pair of photos must have where the cameras are given. These reject most wrong matches."""
_WIDE, _ROUNDS = 12.0, 4
"""Largest distance [pixels] between a feature and its scene point in the first round of improving given cameras, and the
number of rounds. The last round has pycolmap's own limit of 4 pixels."""
_INEXACT = 5.0
"""Errors of features count as so many times larger than they look, beside the given positions: features of one place err in
the same way in many photos."""
_CAUCHY, _LEAST_SCALE, _ADJUSTMENTS = 2.385, 0.1, 2
"""After the mapping, errors of features count by Cauchy's loss, which bends at so many standard deviations, and not below so
many pixels. Where all errors are normal, it is 95 % as exact as least squares (Zhang, "Parameter estimation techniques",
1997). The last number is that of adjustments."""
_AS_GOOD = 1.05
"""The lens stays as given if the features then agree as well, up to this factor."""
_ALIGNED = 20.0
"""The given positions count for the frame up to so many standard deviations."""
_MEDIAN_2D, _MEDIAN_3D = 1.177, 1.538
"""Median length of a vector of two or three normal numbers, in standard deviations; as in `improved_cameras`, which this
process must not import"""
_GUESSED_FOCAL = 1.2
"""Focal length in longest sides of a photo, as COLMAP guesses it"""
_RATIO = 0.85
"""A coarse feature matches if its second best match is this much worse (cosines of angles between descriptors)."""


def main(folder: Path) -> None:
    import pycolmap

    settings = json.loads((folder / "settings.json").read_text(encoding="utf-8"))
    # This connection stays open. Where the last one is closed, SQLite locks the whole database, and so does the next one to
    # open it. pycolmap fails if the process that counts the rows (structure_from_motion) reads at that moment.
    with pycolmap.Database.open(str(folder / "database.db")):
        _find(pycolmap, folder, settings)


def _find(pycolmap: Any, folder: Path, settings: dict) -> None:
    database, images = folder / "database.db", folder / "images"
    names = [name for lens in settings["lenses"] for name in lens["names"]]
    pycolmap.set_random_seed(_SEED)
    _say("features", 0, len(names))
    for lens in settings["lenses"]:
        _extract(pycolmap, database, images, lens, settings)
    _say("features", len(names), len(names))
    given = settings["given"]
    pairs = _near_pairs(given, settings["partners"]) if given else _pairs(pycolmap, database, settings["partners"])
    (folder / "pairs.txt").write_text("".join(f"{a} {b}\n" for a, b in pairs), encoding="utf-8")
    matching = pycolmap.FeatureMatchingOptions()
    matching.num_threads = settings["threads"]
    pairing = pycolmap.ImportedPairingOptions()
    pairing.match_list_path = str(folder / "pairs.txt")
    verification = pycolmap.TwoViewGeometryOptions()
    verification.ransac.random_seed = _SEED
    if given:
        verification.min_num_inliers = _LEAST_MATCHES_OF_GIVEN
    _say("matches", 0, len(pairs))
    pycolmap.match_image_pairs(database, matching, pairing, verification, pycolmap.Device.cpu)
    _say("matches", len(pairs), len(pairs))
    if given:
        _improve(pycolmap, folder, settings)
    else:
        found = _map(pycolmap, folder, len(names), settings["threads"])
        if _placed(found) < len(names) / 2 and any(lens["params"] for lens in settings["lenses"]):
            _forget_focal_lengths(pycolmap, folder, verification)
            again = _map(pycolmap, folder, len(names), settings["threads"])
            found = max(found, again, key=_placed)
        for model in found:
            _adjust_robustly(pycolmap, model, settings["threads"])
        _write(folder, [(model, {}) for model in found])


def _extract(pycolmap: Any, database: Path, images: Path, lens: dict, settings: dict) -> None:
    reader = pycolmap.ImageReaderOptions()
    reader.camera_model = lens["model"]
    if lens["params"]:
        reader.camera_params = ",".join(map(repr, lens["params"]))
    if settings["masked"]:
        reader.mask_path = str(images.parent / "masks")
    features = pycolmap.FeatureExtractionOptions()
    features.num_threads = settings["threads"]
    features.sift.max_num_features = settings["features"]
    features.sift.first_octave = settings["first_octave"]
    mode = pycolmap.CameraMode.SINGLE
    pycolmap.extract_features(database, images, lens["names"], mode, reader, features, pycolmap.Device.cpu)


def _pairs(pycolmap: Any, database: Path, partners: int) -> list[tuple[str, str]]:
    """The pairs of photos to match: all, or for each photo the `partners` most similar ones and its two next neighbors.

    Few, large features say which photos are similar, as in preemptive matching (Wu, "Towards linear-time incremental
    structure from motion", 3DV 2013).
    """
    with pycolmap.Database.open(str(database)) as opened:
        photos = sorted(opened.read_all_images(), key=lambda image: image.name)
        names = [image.name for image in photos]
        count = len(names)
        if count <= partners + 1:
            return [(names[i], names[j]) for i in range(count) for j in range(i + 1, count)]
        coarse = [_coarse(opened, image.image_id) for image in photos]
    similar = np.zeros((count, count), np.int32)
    for i in range(count):
        for j in range(i + 1, count):
            similar[i, j] = similar[j, i] = _similarity(coarse[i], coarse[j])
    chosen = {(i, i + step) for step in (1, 2) for i in range(count - step)}
    for i in range(count):
        for j in np.argsort(-similar[i], kind="stable")[:partners]:
            if similar[i, j] > 0 and i != j:
                chosen.add((min(i, int(j)), max(i, int(j))))
    return [(names[i], names[j]) for i, j in sorted(chosen)]


def _near_pairs(given: dict, partners: int) -> list[tuple[str, str]]:
    """The pairs of photos to match where the cameras are given: for each photo, the nearest `partners` cameras."""
    names = sorted(given)
    places = np.array([given[name]["position"] for name in names])
    apart = np.linalg.norm(places[:, None] - places[None], axis=-1)
    near = np.argsort(apart, axis=1, kind="stable")[:, 1 : partners + 1]
    chosen = {(min(i, int(j)), max(i, int(j))) for i, row in enumerate(near) for j in row if int(j) != i}
    return [(names[i], names[j]) for i, j in sorted(chosen)]


def _coarse(opened: Any, image: int) -> np.ndarray:
    """Unit descriptors [n, 128] float32 of the photo's largest features."""
    places = np.asarray(opened.read_keypoints(image))
    descriptors = opened.read_descriptors(image)
    values = np.asarray(getattr(descriptors, "data", descriptors))
    if len(places) == 0:
        return np.zeros((0, 128), np.float32)
    size = np.abs(places[:, 2] * places[:, 5] - places[:, 3] * places[:, 4]) if places.shape[1] == 6 else places[:, 2]
    chosen = values[np.argsort(-size, kind="stable")[:_COARSE_FEATURES]].astype(np.float32)
    return chosen / np.linalg.norm(chosen, axis=1, keepdims=True).clip(1e-6)


def _similarity(first: np.ndarray, second: np.ndarray) -> int:
    """Number of features that are each other's best match, and clearly better than the second best."""
    if min(len(first), len(second)) < 2:
        return 0
    cosine = first @ second.T
    best = cosine.argmax(1)
    mutual = cosine.argmax(0)[best] == np.arange(len(first))
    top = np.partition(cosine, -2, axis=1)[:, -2:]
    angle = np.arccos(top.clip(-1, 1))
    return int((mutual & (angle[:, 1] < _RATIO * angle[:, 0])).sum())


def _map(pycolmap: Any, folder: Path, count: int, threads: int) -> list[Any]:
    """The models that COLMAP's incremental mapping finds."""
    (folder / "sparse").mkdir(exist_ok=True)
    options = pycolmap.IncrementalPipelineOptions()
    options.num_threads, options.random_seed, options.extract_colors = threads, _SEED, False
    options.mapper.random_seed = options.triangulation.random_seed = _SEED
    options.min_model_size = min(10, max(3, count // 3))
    placed = 0

    def report() -> None:
        nonlocal placed
        placed += 1
        _say("places", min(placed, count), count)

    found = pycolmap.incremental_mapping(
        folder / "database.db", folder / "images", folder / "sparse", options, next_image_callback=report
    )
    return [model for _, model in sorted(found.items())]


def _placed(models: list[Any]) -> int:
    """Photos in the largest model"""
    return max((model.num_reg_images() for model in models), default=0)


def _forget_focal_lengths(pycolmap: Any, folder: Path, verification: Any) -> None:
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


def _adjust_robustly(pycolmap: Any, model: Any, threads: int) -> None:
    """Adjust the model to its features once more, so that features which do not fit count little.

    The mapping sums squares of errors. Some features are reflections, which move over the object with the camera. There are
    few of them, and they are far enough off to pull all cameras.
    """
    adjustment = _adjustment(pycolmap, threads)
    adjustment.ceres.loss_function_type = pycolmap.LossFunctionType.CAUCHY
    for _ in range(_ADJUSTMENTS):
        adjustment.ceres.loss_function_scale = float(np.fmax(_CAUCHY * _agreement(model), _LEAST_SCALE))
        pycolmap.bundle_adjustment(model, adjustment)


def _adjustment(pycolmap: Any, threads: int) -> Any:
    """Options of a bundle adjustment of poses, lenses and points."""
    options = pycolmap.BundleAdjustmentOptions()
    options.print_summary = False
    options.ceres.solver_options.num_threads = threads
    return options


def _write(folder: Path, models: list[tuple[Any, dict]]) -> None:
    """Write models in COLMAP's form, and `result.json`. Each model comes with what else is to be said of its photos."""
    told = []
    for number, (model, more) in enumerate(models):
        target = folder / "sparse" / str(number)
        target.mkdir(parents=True, exist_ok=True)
        model.write_binary(str(target))
        images = [model.images[i] for i in model.reg_image_ids()]
        photos = {image.name: _support(model, image) for image in images}
        for image in images:
            seen = [(*p.xy, *model.points3D[p.point3D_id].xyz) for p in image.points2D if p.has_point3D()]
            np.save(target / f"{image.name}.npy", np.array(seen).reshape(-1, 5))
        told.append({"folder": str(number), "photos": photos} | more)
        points = [point.xyz for point in model.points3D.values() if point.track.length() >= 3]
        np.save(folder / f"points_{number}.npy", np.array(points).reshape(-1, 3))
    (folder / "result.json").write_text(json.dumps(told), encoding="utf-8")


def _improve(pycolmap: Any, folder: Path, settings: dict) -> None:
    """Improve given cameras: find scene points with them, and adjust cameras and points to the features; several rounds.

    The lens is adjusted, too. It is as given in the end if the features agree as well then.
    """
    model = _given_model(pycolmap, folder, settings)
    options = pycolmap.IncrementalPipelineOptions()
    options.num_threads, options.random_seed, options.extract_colors = settings["threads"], _SEED, False
    adjustment = _adjustment(pycolmap, settings["threads"])
    adjustment.refine_extra_params = all(lens["refined"] for lens in settings["lenses"])
    adjustment.ceres.loss_function_type = pycolmap.LossFunctionType.SOFT_L1
    (folder / "round").mkdir()
    before, lenses = {}, {number: camera.params.copy() for number, camera in model.cameras.items()}
    for number in range(_ROUNDS):
        _say("places", number, _ROUNDS)
        limit = _WIDE if number == 0 else 4.0
        options.mapper.filter_max_reproj_error = options.triangulation.complete_max_reproj_error = limit
        model = pycolmap.triangulate_points(
            model, folder / "database.db", folder / "images", folder / "round", clear_points=True, options=options
        )
        if number == 0:
            before = {model.images[i].name: _support(model, model.images[i]) for i in model.reg_image_ids()}
        pycolmap.bundle_adjustment(model, adjustment)
    refined = _adjust_held(pycolmap, model, adjustment, settings["given"])
    for camera in model.cameras.values():
        camera.params = lenses[camera.camera_id]
    adjustment.refine_focal_length = adjustment.refine_extra_params = False
    as_given = _adjust_held(pycolmap, model, adjustment, settings["given"])
    model = as_given if _agreement(as_given) < _AS_GOOD * _agreement(refined) else refined
    _say("places", _ROUNDS, _ROUNDS)
    _write(folder, [(model, {"before": before})])


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
    spread = max(float(np.median(moved)) / _MEDIAN_3D, 1e-9 * float(np.ptp(positions)))
    in_pixels = spread / max(_INEXACT * _agreement(model), 1e-6)  # beside features whose places have a deviation of 1 pixel
    configuration, priors = pycolmap.BundleAdjustmentConfig(), []
    for image, position in zip(photos, positions, strict=True):
        configuration.add_image(image.image_id)
        prior = pycolmap.PosePrior(pose_prior_id=image.image_id, corr_data_id=image.data_id, position=position)
        prior.position_covariance = np.eye(3) * in_pixels**2
        prior.coordinate_system = pycolmap.PosePriorCoordinateSystem.CARTESIAN
        priors.append(prior)
    options = pycolmap.PosePriorBundleAdjustmentOptions()
    options.alignment_ransac.random_seed, options.alignment_ransac.max_error = _SEED, _ALIGNED * spread
    options.ceres.prior_position_loss_function_type = pycolmap.LossFunctionType.CAUCHY
    adjusted = pycolmap.Reconstruction(model)
    pycolmap.create_pose_prior_bundle_adjuster(adjustment, options, configuration, priors, adjusted).solve()
    return adjusted


def _agreement(model: Any) -> float:
    """Standard deviation [pixels] of the places of features, in the median over the photos."""
    return float(np.nanmedian([_support(model, model.images[i])["error"] for i in model.reg_image_ids()])) / _MEDIAN_2D


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


def _support(model: Any, image: Any) -> dict[str, float]:
    """How many scene points a photo shows, and its median error [pixels]."""
    points = [point for point in image.points2D if point.has_point3D()]
    errors = [_error(model, image, point) for point in points]
    return {"points": len(points), "error": float(np.median(errors)) if errors else float("nan")}


def _error(model: Any, image: Any, point: Any) -> float:
    """Distance [pixels] between a feature and the projection of its 3-D point."""
    place = image.project_point(model.points3D[point.point3D_id].xyz)
    return float("inf") if place is None else float(np.linalg.norm(place - point.xy))


def _say(stage: str, step: int, steps: int) -> None:
    print(json.dumps({"stage": stage, "step": step, "steps": steps}), flush=True)


if __name__ == "__main__":
    os.environ.setdefault("GLOG_minloglevel", "1")
    main(Path(sys.argv[1]))
