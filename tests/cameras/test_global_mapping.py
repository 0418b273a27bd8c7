"""Global mapping: photos that too few scene points hold are taken out of a model."""

from __future__ import annotations

import json
import sys

from support.own_process import run_file


def in_pycolmap() -> None:
    """Print the names of all photos, of those taken out, and of those that are left.

    Of twelve cameras around 200 points, two keep 5 and 8 of the points that they show.
    """
    import pycolmap

    from blender_nep.cameras.matching.mapping import take_out_unsupported

    pycolmap.set_random_seed(0)
    options = pycolmap.SyntheticDatasetOptions()
    options.num_rigs, options.num_cameras_per_rig, options.num_frames_per_rig = 1, 1, 12
    options.num_points3D, options.num_points2D_without_point3D = 200, 0
    model = pycolmap.synthesize_dataset(options)
    numbers = list(model.reg_image_ids())
    names = [model.images[number].name for number in numbers]
    for number, kept in zip(numbers[:2], (5, 8), strict=True):
        shown = [i for i, point in enumerate(model.images[number].points2D) if point.has_point3D()]
        for i in shown[kept:]:
            model.delete_observation(number, i)
    taken = take_out_unsupported(pycolmap, model)
    print(json.dumps([names, taken, [model.images[number].name for number in model.reg_image_ids()]]))


def test_photos_that_few_points_hold_are_taken_out():
    done = run_file(__file__, "in_pycolmap", timeout=120)
    assert done.returncode == 0, done.stderr[-2000:]
    names, taken, left = json.loads(done.stdout.splitlines()[-1])
    assert taken == names[:1] and sorted(left) == sorted(names[1:])


if __name__ == "__main__":
    globals()[sys.argv[1]]()
