"""The comparison picture: exposure of its tiles, and resizing."""

import os
import sys
from pathlib import Path

import numpy as np
import pytest

from support.blender_checks import with_small_light_map
from support.captures import write_exr
from support.own_process import in_blender
from support.traps import set_traps
from support.waiting import wait_until

GRAY = 0.25
GAINS = ((1.0, 1.0, 1.0), (2.0, 2.0, 1.5), (0.25, 0.3, 0.25))
CURVE = (2.0, 1.0, 2.0)
"""Strength, white and scale of a camera's response curve"""


@pytest.mark.parametrize("color_space", ["srgb", "linear"])
def test_the_re_rendering_is_exposed_as_its_photo_was(tmp_path, color_space):
    """Photo, object and world are gray. For every exposure and white balance of the photo, both tiles have the same color.

    The object's own brightness is a gain of its light: the camera's curve comes after it, and the world keeps its light. The
    object covers the left half.
    """
    write_exr(tmp_path / "gray.exr", np.full((4, 8, 3), GRAY))
    in_blender(check_exposure, tmp_path, color_space)


def check_exposure(folder, color_space):
    import bpy

    from backend.rendering import comparison
    from backend.rendering.contact_sheet import GAP, HEADER
    from backend.rendering.response_curve import seen_by_camera
    from backend.scene_io.capture_files import Frame
    from backend.scene_io.image_files import write_png
    from backend.scene_io.srgb import linear_to_srgb
    from backend.scene_io.world import build_world

    bpy.ops.wm.read_factory_settings(use_empty=True)
    card = glowing_card(bpy)
    world = with_small_light_map(build_world(Path(folder) / "gray.exr", name="gray"))
    side, comparison.TILE_RANGE = 64, (64, 64)  # a tile of 320 pixels takes 2 CPU seconds, nearly all for its noise
    photos = []
    told = {3: {"object_gain": 3.0, "response": CURVE}, 4: {"object_gain": 3.0, "curve_of_files": CURVE}}
    for number, gain in enumerate((*GAINS, GAINS[2], GAINS[2])):
        of_object = told.get(number, {})
        light = np.full((16, 16, 3), GRAY)
        light[:, :8] *= of_object.get("object_gain", 1)
        light = seen_by_camera(light, of_object.get("response"))
        color = seen_by_camera(light * gain, of_object.get("curve_of_files"))
        path = Path(folder) / f"{number}.{'png' if color_space == 'srgb' else 'exr'}"
        if color_space == "srgb":
            write_png(path, np.round(255 * linear_to_srgb(color)).astype(np.uint8))
        else:
            write_exr(path, color)
        frame = Frame(path, 16, 16, 16.0, 16.0, 8.0, 8.0, np.eye(4), color_space, gain, **of_object)
        sheet, _ = comparison.compare(card, [frame], world, [], samples=1)
        photo, rendered = (sheet[HEADER : HEADER + side, GAP + k * (side + GAP) :][:, :side] for k in (0, 1))
        photos.append(photo.mean())
        for half in (slice(0, side // 2 - 4), slice(side // 2 + 4, side)):  # the photo's pixels are wide
            shown, again = (tile[:, half].mean((0, 1)) for tile in (photo, rendered))
            np.testing.assert_allclose(shown, again, atol=2)  # of 255: rounding, here and there
    if color_space == "srgb":
        assert photos[1] > photos[0] + 20 > photos[2] + 40, "photos in sRGB are shown as they were taken"
    else:
        assert np.ptp(photos[:3]) < 20, "linear photos are exposed alike"


def glowing_card(bpy):
    """A card that shines gray and reflects nothing, on the left of a camera at the origin that looks along -Z."""
    bpy.ops.mesh.primitive_plane_add(size=8, location=(-4, 0, -3))
    material = bpy.data.materials.new("glowing")
    material.use_nodes = True
    nodes = material.node_tree.nodes
    nodes.clear()
    light, output = nodes.new("ShaderNodeEmission"), nodes.new("ShaderNodeOutputMaterial")
    light.inputs["Color"].default_value = (GRAY, GRAY, GRAY, 1)
    material.node_tree.links.new(light.outputs[0], output.inputs["Surface"])
    bpy.context.object.data.materials.append(material)
    return bpy.context.object


@pytest.mark.slow
def test_photos_of_two_shapes_and_one_that_blender_does_not_show(tmp_path):
    """A ball stays round in the renderings of a wide and a high photo. The raw photo's row has the renderings."""
    write_exr(tmp_path / "gray.exr", np.full((4, 8, 3), GRAY))
    in_blender(check_shapes, tmp_path)


def check_shapes(folder):
    import bpy

    from backend.rendering.comparison import TILE_RANGE, compare
    from backend.rendering.contact_sheet import BACKGROUND, GAP, HEADER
    from backend.scene_io.capture_files import Frame
    from backend.scene_io.image_files import write_png
    from backend.scene_io.world import build_world

    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.mesh.primitive_uv_sphere_add(radius=0.4, location=(0, 0, -3))
    ball = bpy.context.object
    ball.data.materials.append(bpy.data.materials.new("black"))
    ball.data.materials[0].use_nodes = True
    ball.data.materials[0].node_tree.nodes.clear()  # it shines and reflects nothing
    world = with_small_light_map(build_world(Path(folder) / "gray.exr", name="gray"))
    frames = []
    for number, (width, height) in enumerate(((448, 224), (224, 448), (224, 448))):
        path = Path(folder) / ("raw.dng" if number == 2 else f"{number}.png")
        write_png(path, np.full((height, width, 3), 137, np.uint8))
        frames.append(Frame(path, width, height, 400.0, 400.0, width / 2, height / 2, np.eye(4), "srgb"))
    sheet, gains = compare(ball, frames, world, [], samples=1)
    side = TILE_RANGE[1]
    assert len(gains) == 3 and len(sheet) == HEADER + 3 * (side + GAP)
    background = round(255 * BACKGROUND)
    for row in range(3):
        for column in range(2):
            cell = sheet[HEADER + row * (side + GAP) :, GAP + column * (side + GAP) :][:side, :side].astype(int)
            middle = cell[:, 112:336] if row else cell[112:336]
            outside = cell[:, [*range(111), *range(338, side)]] if row else cell[[*range(111), *range(338, side)]]
            assert (outside == background).all(), "the rest of the cell is empty"
            if column:
                dark = (cell.max(-1) < 15).nonzero()
                high, wide = (int(np.ptp(place)) for place in dark)
                assert abs(high - wide) <= 3 and abs(wide - 2 * 400 * 0.4 / 3) < 6
            elif row < 2:
                np.testing.assert_allclose(middle, 137, atol=1)
            else:
                assert (middle == background).mean() > 0.8 and middle.max() > 150, "its name stands there"


def test_resize_keeps_means_and_ramps():
    in_blender(check_resize)


def check_resize():
    from backend.rendering.comparison import resize

    image = np.random.default_rng(0).random((12, 18, 3))
    blocks = image.reshape(4, 3, 6, 3, 3).mean(axis=(1, 3))
    np.testing.assert_allclose(resize(image, 6, 4), blocks)
    np.testing.assert_allclose(resize(image, 7, 5).mean(axis=(0, 1)), image.mean(axis=(0, 1)))
    ramp = np.broadcast_to(np.arange(10.0)[None, :, None], (4, 10, 3))
    np.testing.assert_allclose(resize(ramp, 20, 8)[3, 1:-1, 0], np.arange(1, 19) / 2 - 0.25)


def test_the_second_blender_runs_nothing_of_a_stranger(tmp_path):
    """Neither the current folder nor PYTHONPATH say what its Python imports."""
    set_traps(tmp_path / "stranger")
    in_blender(check_second_blender, tmp_path)


def check_second_blender(folder):
    import psutil

    from backend.rendering.comparison_process import ComparisonProcess

    stranger = Path(folder) / "stranger"
    os.chdir(stranger)
    os.environ["PYTHONPATH"] = str(stranger)
    render = ComparisonProcess(["--asset", f"{folder}/nothing", "--capture", f"{folder}/nothing"])
    assert psutil.Process(render.process.pid).cwd() == os.path.abspath(os.sep)
    wait_until(render.poll)
    render.close()
    assert "nothing" in render.error, render.error
    assert not (stranger / "sprung.txt").exists()


if __name__ == "__main__":
    globals()[sys.argv[1]](*sys.argv[2:])
