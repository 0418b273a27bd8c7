"""Features of an earlier way are put behind those of this one, and the matches of both point to the right ones."""

from __future__ import annotations

import json
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from support.own_process import run_file

NAMES = ("a.png", "b.png", "c.png")
POINTS = 60


def projections() -> dict[str, np.ndarray]:
    """Places [POINTS, 2] of 60 points in photos of 640 x 480 that were taken from three places."""
    points = np.random.default_rng(0).uniform([-1, -1, 5], [1, 1, 7], (POINTS, 3))
    seen = {name: points + np.array([shift, 0.3 * shift, 0]) for name, shift in zip(NAMES, (-1.0, 0.0, 1.0), strict=True)}
    return {name: 600 * at[:, :2] / at[:, 2:] + [320, 240] for name, at in seen.items()}


def write(pycolmap: Any, path: Path, names: tuple[str, ...], shown: np.ndarray, without: str | None) -> None:
    """A database of the photos in this order, with features of the points `shown`, in each photo in another order."""
    with pycolmap.Database.open(str(path)) as database:
        camera = pycolmap.Camera(model="SIMPLE_RADIAL", width=640, height=480, params=[600, 320, 240, 0])
        rig = pycolmap.Rig()
        camera.camera_id = database.write_camera(camera)
        rig.add_ref_sensor(camera.sensor_id)
        rig.rig_id = database.write_rig(rig)
        rows = {}
        for name in names:
            image = pycolmap.Image(name=name, camera_id=camera.camera_id)
            image.image_id = database.write_image(image)
            frame = pycolmap.Frame(rig_id=rig.rig_id)
            frame.add_data_id(image.data_id)
            database.write_frame(frame)
            order = np.random.default_rng(image.image_id).permutation(shown)
            places = np.column_stack([projections()[name][order], np.tile([1, 0, 0, 1], (len(order), 1))])
            database.write_keypoints(image.image_id, np.float32(places))
            rows[name] = image.image_id, np.argsort(order)  # the feature of each point, as the points are sorted
        for k, first in enumerate(names):
            for second in names[k + 1 :]:
                if without not in (first, second):
                    (one, left), (two, right) = rows[first], rows[second]
                    database.write_matches(one, two, np.uint32(np.column_stack([left, right])))


def added() -> None:
    """Print, for each pair of photos, how many matches agree on a geometry, and how many of them show one point."""
    import pycolmap

    from blender_nep.cameras.matching.added_features import add_features

    with tempfile.TemporaryDirectory() as made:
        folder = Path(made)
        write(pycolmap, folder / "database.db", NAMES, np.arange(25), "c.png")
        write(pycolmap, folder / "earlier.db", NAMES[::-1], np.arange(25, POINTS), None)
        pairs = [(one, two) for k, one in enumerate(NAMES) for two in NAMES[k + 1 :]]
        (folder / "pairs.txt").write_text("".join(f"{one} {two}\n" for one, two in pairs), encoding="utf-8")
        verification = pycolmap.TwoViewGeometryOptions()
        verification.ransac.random_seed = 0
        add_features(pycolmap, folder, folder / "earlier.db", verification)
        true, told = projections(), []
        with pycolmap.Database.open(str(folder / "database.db")) as database:
            numbers = {image.name: image.image_id for image in database.read_all_images()}
            places = {name: database.read_keypoints(number)[:, :2] for name, number in numbers.items()}
            for pair in pairs:
                found = database.read_two_view_geometry(*(numbers[name] for name in pair)).inlier_matches
                points = [
                    np.linalg.norm(places[name][found[:, k]][:, None] - true[name], axis=-1).argmin(1)
                    for k, name in enumerate(pair)
                ]
                told.append([len(found), int((points[0] == points[1]).sum())])
        print(json.dumps(told))


def test_matches_of_both_kinds_of_features_count_together():
    done = run_file(__file__, "added", timeout=120)
    assert done.returncode == 0, done.stderr[-2000:]
    counts = json.loads(done.stdout.splitlines()[-1])
    assert counts == [[POINTS, POINTS], [35, 35], [35, 35]]


if __name__ == "__main__":
    globals()[sys.argv[1]]()
