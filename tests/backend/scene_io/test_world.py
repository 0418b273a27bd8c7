"""The recovered light as a World: its orientation."""

import json
import sys
from pathlib import Path

import numpy as np

from support.blender_checks import with_small_light_map
from support.captures import write_exr
from support.own_process import in_blender


def test_world_shines_from_where_the_environment_says(tmp_path):
    """A bright spot at direction d, placed in the image by the written formula, is seen by a camera that looks at d."""
    directions = np.array([[1, 0, 0], [-0.3, 0.9, 0.2], [0.2, -0.5, -0.8], [-0.7, -0.6, 0.5]])
    height = 128
    for index, (x, y, z) in enumerate(directions):
        u = 0.5 - np.arctan2(y, x) / (2 * np.pi)
        v = 0.5 + np.arctan2(z, np.hypot(x, y)) / np.pi
        light = np.full((height, 2 * height, 3), 0.01)
        row, column = int((1 - v) * height), int(u * 2 * height) % (2 * height)
        light[max(row - 1, 0) : row + 2, [(column + k) % (2 * height) for k in (-1, 0, 1)]] = 10
        write_exr(tmp_path / f"{index}.exr", light)
    in_blender(check_world, tmp_path, json.dumps(directions.tolist()))


def check_world(folder, directions):
    import bpy
    from mathutils import Vector

    from backend.rendering.relight import RelitScene
    from backend.scene_io.capture_files import Frame
    from backend.scene_io.world import build_world

    bpy.ops.wm.read_factory_settings(use_empty=True)
    relit = RelitScene(bpy.data.objects.new("nothing", None), 32, 32, samples=4)
    for index, direction in enumerate(json.loads(directions)):
        world = with_small_light_map(build_world(Path(folder) / f"{index}.exr", name=str(index)))
        # the camera looks 12 degrees left of and below the spot, which must then be right of and above the middle
        turned = Vector(direction).to_track_quat("-Z", "Y").to_matrix()
        aside = turned @ Vector((-np.tan(np.radians(12)), -np.tan(np.radians(12)), -1))
        matrix = np.eye(4)
        matrix[:3, :3] = np.array(aside.to_track_quat("-Z", "Y").to_matrix())
        frame = Frame(Path("none"), 32, 32, 32.0, 32.0, 16.0, 16.0, matrix, "linear")
        seen = relit.render(frame, world).mean(axis=-1)
        row, column = np.unravel_index(seen.argmax(), seen.shape)
        local = np.linalg.inv(matrix[:3, :3]) @ (np.array(direction) / np.linalg.norm(direction))
        expected = 16 + 32 * local[0] / -local[2], 16 - 32 * local[1] / -local[2]
        assert expected[0] > 19 and expected[1] < 13, expected
        assert abs(column + 0.5 - expected[0]) < 2 and abs(row + 0.5 - expected[1]) < 2, (index, row, column, expected)
        assert seen.max() > 1 and np.median(seen) < 0.05


if __name__ == "__main__":
    globals()[sys.argv[1]](*sys.argv[2:])
