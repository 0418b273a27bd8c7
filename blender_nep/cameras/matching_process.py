"""The process that runs pycolmap: features, matches, and the cameras. It is started as a program of its own.

    python -m blender_nep.cameras.matching_process FOLDER

FOLDER holds `settings.json` (see `structure_from_motion.start`) and `images/`. The result is written there: COLMAP models in
`sparse/0`, `sparse/1` and so on, and `result.json`. Standard output carries JSON lines with stage, step and steps. Standard
error carries pycolmap's log.

pycolmap brings a zlib of its own, with which Python's zlib can crash. So this process compresses nothing, reads no PNG by
Pillow, and imports nothing of the package.
"""

from __future__ import annotations

import json
import os
import sqlite3
import sys
import threading
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

import numpy as np

_SEED = 0
_COARSE_FEATURES = 400
"""Features of each photo that choose the pairs: the largest ones, which are seen from many places."""
_RATIO = 0.85
"""A coarse feature matches if its second best match is this much worse (cosines of angles between descriptors)."""


def main(folder: Path) -> None:
    import pycolmap

    settings = json.loads((folder / "settings.json").read_text(encoding="utf-8"))
    database, images = folder / "database.db", folder / "images"
    names = [name for lens in settings["lenses"] for name in lens["names"]]
    pycolmap.set_random_seed(_SEED)
    with _reported("features", database, "descriptors", len(names)):
        for lens in settings["lenses"]:
            _extract(pycolmap, database, images, lens, settings)
    pairs = _pairs(pycolmap, database, settings["partners"])
    (folder / "pairs.txt").write_text("".join(f"{a} {b}\n" for a, b in pairs), encoding="utf-8")
    matching = pycolmap.FeatureMatchingOptions()
    matching.num_threads = settings["threads"]
    pairing = pycolmap.ImportedPairingOptions()
    pairing.match_list_path = str(folder / "pairs.txt")
    verification = pycolmap.TwoViewGeometryOptions()
    verification.ransac.random_seed = _SEED
    with _reported("matches", database, "two_view_geometries", len(pairs)):
        pycolmap.match_image_pairs(database, matching, pairing, verification, pycolmap.Device.cpu)
    _map(pycolmap, folder, len(names), settings["threads"])


def _extract(pycolmap: Any, database: Path, images: Path, lens: dict, settings: dict) -> None:
    reader = pycolmap.ImageReaderOptions()
    reader.camera_model = "RADIAL"
    if lens["focal_length"]:
        focal = lens["focal_length"]
        reader.camera_params = f"{focal},{lens['width'] / 2},{lens['height'] / 2},0,0"
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


def _map(pycolmap: Any, folder: Path, count: int, threads: int) -> None:
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
    models = []
    for number, model in sorted(found.items()):
        target = folder / "sparse" / str(number)
        target.mkdir(exist_ok=True)
        model.write_binary(str(target))
        photos = {model.images[i].name: _support(model, model.images[i]) for i in model.reg_image_ids()}
        models.append({"folder": str(number), "photos": photos})
        points = [point.xyz for point in model.points3D.values() if point.track.length() >= 3]
        np.save(folder / f"points_{number}.npy", np.array(points).reshape(-1, 3))
    (folder / "result.json").write_text(json.dumps(models), encoding="utf-8")


def _support(model: Any, image: Any) -> dict[str, float]:
    """How many scene points a photo shows, and its median error [pixels]."""
    points = [point for point in image.points2D if point.has_point3D()]
    errors = [_error(model, image, point) for point in points]
    return {"points": len(points), "error": float(np.median(errors)) if errors else float("nan")}


def _error(model: Any, image: Any, point: Any) -> float:
    """Distance [pixels] between a feature and the projection of its 3-D point."""
    place = image.project_point(model.points3D[point.point3D_id].xyz)
    return float("inf") if place is None else float(np.linalg.norm(place - point.xy))


@contextmanager
def _reported(stage: str, database: Path, table: str, steps: int) -> Iterator[None]:
    """Within this context, the number of rows of the database's table is reported every second."""
    ended = threading.Event()

    def watch() -> None:
        while not ended.wait(1.0):
            try:
                with closing(sqlite3.connect(f"file:{database}?mode=ro", uri=True, timeout=1)) as opened:
                    rows = opened.execute(f"SELECT COUNT(*) FROM {table}").fetchone()[0]
                _say(stage, min(rows, steps), steps)
            except sqlite3.Error:
                pass  # the table is not there yet, or is locked: the next second tells

    _say(stage, 0, steps)
    watcher = threading.Thread(target=watch, daemon=True)
    watcher.start()
    try:
        yield
    finally:
        ended.set()
        watcher.join()
    _say(stage, steps, steps)


def _say(stage: str, step: int, steps: int) -> None:
    print(json.dumps({"stage": stage, "step": step, "steps": steps}), flush=True)


if __name__ == "__main__":
    os.environ.setdefault("GLOG_minloglevel", "1")
    main(Path(sys.argv[1]))
