"""Global mapping: photos that too few scene points hold, or that hold each other only, are taken out of a model."""

from __future__ import annotations

import json
import sys
from typing import Any

from support.own_process import run_file


def model_of_twelve() -> Any:
    """A model of twelve cameras around 200 points, all of which each of them shows."""
    import pycolmap

    pycolmap.set_random_seed(0)
    options = pycolmap.SyntheticDatasetOptions()
    options.num_rigs, options.num_cameras_per_rig, options.num_frames_per_rig = 1, 1, 12
    options.num_points3D, options.num_points2D_without_point3D = 200, 0
    return pycolmap.synthesize_dataset(options)


def tell(model: Any, names: list[str], taken: list[str]) -> None:
    """Print the names of all photos, of those taken out, and of those that are left."""
    print(json.dumps([names, taken, [model.images[number].name for number in model.reg_image_ids()]]))


def few_points() -> None:
    """Two of twelve cameras keep 5 and 8 of the points that they show."""
    import pycolmap

    from blender_nep.cameras.matching.mapping import take_out_unsupported

    model = model_of_twelve()
    numbers = list(model.reg_image_ids())
    names = [model.images[number].name for number in numbers]
    for number, kept in zip(numbers[:2], (5, 8), strict=True):
        shown = [i for i, point in enumerate(model.images[number].points2D) if point.has_point3D()]
        for i in shown[kept:]:
            model.delete_observation(number, i)
    tell(model, names, take_out_unsupported(pycolmap, model))


def loose_group() -> None:
    """Three of twelve cameras show 60 points that no other shows, and 8 of the others' points."""
    import pycolmap

    from blender_nep.cameras.matching.mapping import take_out_loose

    model = model_of_twelve()
    numbers = list(model.reg_image_ids())
    names = [model.images[number].name for number in numbers]
    own, common = set(sorted(model.points3D)[:60]), set(sorted(model.points3D)[60:68])
    for k, number in enumerate(numbers):
        for i, point in enumerate(model.images[number].points2D):
            kept = (point.point3D_id in own | common) if k < 3 else (point.point3D_id not in own)
            if point.has_point3D() and not kept:
                model.delete_observation(number, i)
    tell(model, names, take_out_loose(pycolmap, model))


def told(what: str) -> tuple[list[str], list[str], list[str]]:
    done = run_file(__file__, what, timeout=120)
    assert done.returncode == 0, done.stderr[-2000:]
    return json.loads(done.stdout.splitlines()[-1])


def test_photos_that_few_points_hold_are_taken_out():
    names, taken, left = told("few_points")
    assert taken == names[:1] and sorted(left) == sorted(names[1:])


def test_photos_that_hold_each_other_only_are_taken_out():
    names, taken, left = told("loose_group")
    assert sorted(taken) == sorted(names[:3]) and sorted(left) == sorted(names[3:])


if __name__ == "__main__":
    globals()[sys.argv[1]]()
