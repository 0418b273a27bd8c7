"""A rendered turntable: the camera stands still in the room, and its poses are written in the frame of the object."""

import json
import sys

import numpy as np
import pytest

from support.own_process import in_blender, run_file


def test_the_camera_of_a_row_stands_still_in_the_room():
    in_blender(check_viewpoints)


def check_viewpoints():
    import bpy

    from backend.synthetic_capture.scene_building import build_fixed_scene
    from backend.synthetic_capture.turntable import Turntable, turn_to

    bpy.ops.wm.read_factory_settings(use_empty=True)
    built = build_fixed_scene("box", None, 3, (9, 2), False, frozenset(), Turntable(2))
    assert [view.row for view in built.train] == [0] * 5 + [1] * 4
    assert {item.name for item in built.turning} == {"object", "plate"}
    rows = [[view for view in built.train if view.row == row] for row in (0, 1)]
    for row in rows:
        assert all(view.matrix == row[0].matrix for view in row)
        places = [tuple(round(x, 4) for x in view.in_object.translation) for view in row]
        assert len(set(places)) == len(row), "relative to the object, the camera moves"
    assert np.allclose(built.train[0].turn, np.eye(4)) and not np.allclose(rows[1][0].turn, np.eye(4))
    turn_to(built.turning, built.train[2])
    bpy.context.view_layer.update()
    assert np.allclose(built.target.matrix_world, built.train[2].turn, atol=1e-6)
    assert all(view.row is None and np.allclose(view.turn, np.eye(4)) for view in built.test)


def test_a_print_lies_on_the_plate_alone_and_turns_with_it():
    in_blender(check_print)


def check_print():
    import bpy

    from backend.synthetic_capture.scene_building import build_fixed_scene
    from backend.synthetic_capture.turntable import Turntable

    prints = {}
    for printed in (False, True):
        bpy.ops.wm.read_factory_settings(use_empty=True)
        built = build_fixed_scene("box", None, 3, (9, 2), False, frozenset(), Turntable(2, printed=printed))
        plates = [item for item in built.turning if item is not built.target]
        prints[printed] = [item.name for item in bpy.data.objects if any("print" in m.name for m in item.data.materials)]
        assert [item.name for item in plates] == ["plate"]
    assert prints == {False: [], True: ["plate"]}


@pytest.mark.slow
@pytest.mark.parametrize("walk", [False, True], ids=["turntable", "walk"])
def test_a_rendered_turntable_is_what_its_files_say(tmp_path, walk):
    from blender_nep.capture import PixelRays, load_capture
    from blender_nep.capture.doctor.turntable import MOST_STILL, still_share
    from blender_nep.capture.turntable.motions import on_turntable

    options = ["--scene", "box", "--turntable", "1", "--views", "12", "--test-views", "1", "--size", "64", "--samples", "4"]
    done = run_file("backend/synthetic.py", *options, *(["--walk"] if walk else []), "--out", tmp_path, timeout=300)
    assert done.returncode == 0, done.stderr
    capture = load_capture(tmp_path)
    share = still_share(PixelRays.from_capture(capture, 10**6, use_masks=True))
    if walk:
        assert capture.turntable is None and not (tmp_path / "turns.json").exists() and not share
        return
    assert capture.turntable is True and share > MOST_STILL
    true = np.array(json.loads((tmp_path / "turns.json").read_text())["turns"])
    found = np.stack([view.in_room for view in on_turntable(capture).capture.views])
    assert np.allclose(found, true, atol=1e-4)


if __name__ == "__main__":
    globals()[sys.argv[1]](*sys.argv[2:])
