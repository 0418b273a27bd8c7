"""Features of photos, and the pairs of photos whose features are compared, in pycolmap's process.

It runs in the process of `matching_process`, and imports no more of the package than that one.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

_COARSE_FEATURES = 400
"""Features of each photo that choose the pairs: the largest ones, which are seen from many places."""
_RATIO = 0.85
"""A coarse feature matches if its second best match is this much worse (cosines of angles between descriptors)."""


def extract(pycolmap: Any, database: Path, lens: dict, settings: dict) -> None:
    """Seek the features of the photos of one lens, and write them into the database."""
    images = Path(settings["images"])
    reader = pycolmap.ImageReaderOptions()
    reader.camera_model = lens["model"]
    if lens["params"]:
        reader.camera_params = ",".join(map(repr, lens["params"]))
    if settings["masks"]:
        reader.mask_path = settings["masks"]
    features = pycolmap.FeatureExtractionOptions()
    features.num_threads = settings["threads"]
    features.sift.max_num_features = settings["features"]
    features.sift.first_octave = settings["first_octave"]
    features.sift.estimate_affine_shape = features.sift.domain_size_pooling = settings["affine"]
    mode = pycolmap.CameraMode.SINGLE
    pycolmap.extract_features(database, images, lens["names"], mode, reader, features, pycolmap.Device.cpu)


def similar_pairs(pycolmap: Any, database: Path, settings: dict) -> list[tuple[str, str]]:
    """The pairs of photos to match: all, or for each photo the most similar ones and its two next neighbors.

    Few, large features say which photos are similar, as in preemptive matching (Wu, "Towards linear-time incremental
    structure from motion", 3DV 2013).
    """
    with pycolmap.Database.open(str(database)) as opened:
        photos = sorted(opened.read_all_images(), key=lambda image: image.name)
        names = [image.name for image in photos]
        count = len(names)
        if count <= settings["all_pairs_up_to"]:
            return [(names[i], names[j]) for i in range(count) for j in range(i + 1, count)]
        coarse = [_coarse(opened, image.image_id) for image in photos]
    similar = np.zeros((count, count), np.int32)
    for i in range(count):
        for j in range(i + 1, count):
            similar[i, j] = similar[j, i] = _similarity(coarse[i], coarse[j])
    chosen = {(i, i + step) for step in (1, 2) for i in range(count - step)}
    for i in range(count):
        for j in np.argsort(-similar[i], kind="stable")[: settings["partners"]]:
            if similar[i, j] > 0 and i != j:
                chosen.add((min(i, int(j)), max(i, int(j))))
    return [(names[i], names[j]) for i, j in sorted(chosen)]


def near_pairs(given: dict, partners: int) -> list[tuple[str, str]]:
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
