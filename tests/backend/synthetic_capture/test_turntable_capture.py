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


def test_the_true_light_lies_as_blender_reads_a_world():
    in_blender(check_light)


def check_light():
    import bpy

    from backend.synthetic_capture.ground_truth import ViewRenderer

    bpy.ops.wm.read_factory_settings(use_empty=True)
    lamps = {"X": (4, 0, 0), "Y": (0, 4, 0), "Z": (0, 0, 4), "object": (0, 0, 0)}
    colors = {"X": (1, 0, 0), "Y": (0, 1, 0), "Z": (0, 0, 1), "object": (9, 9, 9)}
    for name, place in lamps.items():
        bpy.ops.mesh.primitive_ico_sphere_add(subdivisions=3, radius=1.5, location=place)
        item = bpy.context.object
        item.name, material = name, bpy.data.materials.new(name)
        material.use_nodes = True
        nodes = material.node_tree.nodes
        light = nodes.new("ShaderNodeEmission")
        light.inputs["Color"].default_value = (*colors[name], 1)
        output = next(node for node in nodes if node.type == "OUTPUT_MATERIAL")
        material.node_tree.links.new(light.outputs["Emission"], output.inputs["Surface"])
        item.data.materials.append(material)
    renderer = ViewRenderer(bpy.context.scene, 20, 1, 0.7, 0)
    bpy.context.scene.cycles.use_denoising = False  # it makes so small a map several times too bright
    light = renderer.render_light([bpy.data.objects["object"]], 16, 8)
    assert light.shape == (16, 32, 3) and light.max() < 2, "the object itself is hidden"
    # Blender's World: the middle column is +X, a quarter of the width to the left of it is +Y; the first row is +Z
    for row, column, channel in ((8, 16, 0), (8, 8, 1), (0, 3, 2)):
        assert light[row, column, channel] > 0.9 and light[row, column].sum() < 1.1, (row, column, light[row, column])
    assert light[8, 24].max() < 0.1 and light[8, 0].max() < 0.1
    assert not bpy.data.objects["object"].hide_render
    assert renderer.render(renderer.camera.matrix_world)[0].shape == (20, 20, 3), "photos are as before"


@pytest.mark.slow
@pytest.mark.parametrize("walk", [False, True], ids=["turntable", "walk"])
def test_a_rendered_turntable_is_what_its_files_say(tmp_path, walk):
    from benchmarks.scoring.light_map import coarse, read_map
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
    light = coarse(read_map(tmp_path / "light.exr"))
    assert np.isfinite(light).all() and light.min() >= 0 and light[0].mean() > 0, "the ceiling is lit"
    true = np.array(json.loads((tmp_path / "turns.json").read_text())["turns"])
    found = np.stack([view.in_room for view in on_turntable(capture).capture.views])
    assert np.allclose(found, true, atol=1e-4)


if __name__ == "__main__":
    globals()[sys.argv[1]](*sys.argv[2:])
