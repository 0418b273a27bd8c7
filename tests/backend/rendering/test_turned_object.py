"""A photo from a turntable is rendered again with the object turned in a light that stands still."""

import sys
from pathlib import Path

import numpy as np

from support.blender_checks import with_small_light_map
from support.captures import write_exr
from support.own_process import in_blender


def test_a_turned_object_is_rendered_as_it_stood(tmp_path):
    light = np.full((32, 64, 3), 0.1)
    light[8:16, 5:20] = 5.0
    write_exr(tmp_path / "light.exr", light)
    in_blender(check_turned, tmp_path)


def check_turned(folder):
    import bpy
    from mathutils import Matrix

    from backend.rendering.relight import RelitScene
    from backend.scene_io.capture_files import Frame
    from backend.scene_io.world import build_world

    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.mesh.primitive_cube_add(size=1.0, location=(0.3, 0.0, 0.1))
    item, world = bpy.context.object, with_small_light_map(build_world(Path(folder) / "light.exr", name="light"))
    still = np.eye(4)
    still[:3, :3] = np.array([[1.0, 0, 0], [0, 0, -1.0], [0, 1.0, 0]])  # looks along +y
    still[:3, 3] = [0.2, -4.0, 0.3]
    turn = np.array([[0.6, -0.8, 0, 0.1], [0.8, 0.6, 0, -0.2], [0, 0, 1.0, 0], [0, 0, 0, 1.0]])

    def frame(matrix, motion=None):
        return Frame(Path("none"), 24, 24, 48.0, 48.0, 12.0, 12.0, matrix, "linear", object_to_room=motion)

    at_rest = item.matrix_world.copy()
    with RelitScene(item, 24, 24, samples=16) as relit:
        relit.scene.cycles.use_denoising = False
        seen = relit.render(frame(np.linalg.inv(turn) @ still, turn), world)
        unturned = relit.render(frame(np.linalg.inv(turn) @ still), world)
        assert item.matrix_world == at_rest
        item.matrix_world = Matrix(turn.tolist()) @ at_rest
        expected = relit.render(frame(still), world)
    assert np.abs(seen - expected).mean() < 0.02 * expected.mean()
    assert np.abs(seen - unturned).mean() > 0.2 * expected.mean(), "the light does not turn with the object"


if __name__ == "__main__":
    globals()[sys.argv[1]](*sys.argv[2:])
