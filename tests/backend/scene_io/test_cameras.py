"""Blender's cameras are the pinhole cameras of the photos, in both directions."""

import sys
from pathlib import Path

import numpy as np

from support.blender_checks import told_in
from support.own_process import in_blender


def test_cameras_in_both_directions():
    in_blender(check_cameras)


def check_cameras():
    for check in (check_camera, check_intrinsics, check_what_is_given_back):
        with told_in(check.__name__):
            check()


def check_camera():
    """The camera of a photo has the capture's pinhole."""
    import bpy
    from bpy_extras.object_utils import world_to_camera_view
    from mathutils import Vector

    from backend.rendering.relight import add_camera
    from backend.scene_io.capture_files import Frame

    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene, rng = bpy.context.scene, np.random.default_rng(0)
    matrix = np.array(Vector((1, -2, 0.5)).to_track_quat("-Z", "Y").to_matrix().to_4x4())
    matrix[:3, 3] = 0.4, -1.0, 2.0
    for fl_y in (130.0, 110.0, 150.0):
        frame = Frame(Path("none"), 120, 90, 130.0, fl_y, 66.0, 40.0, matrix, "linear")
        camera = add_camera(frame, scene)
        scene.render.resolution_x, scene.render.resolution_y = frame.width, frame.height
        bpy.context.view_layer.update()
        for local in np.c_[rng.uniform(-1, 1, (20, 2)), rng.uniform(-6, -2, 20)]:
            point = matrix[:3, :3] @ local + matrix[:3, 3]
            x, y, _ = world_to_camera_view(scene, camera, Vector(point))
            expected = 66 + 130 * local[0] / -local[2], 40 - fl_y * local[1] / -local[2]
            np.testing.assert_allclose((x * 120, (1 - y) * 90), expected, atol=2e-3)


def check_intrinsics():
    """Every sensor fit, wide and tall frames, shifts and pixels that are no squares, against Blender's projection."""
    import bpy
    from bpy_extras.object_utils import world_to_camera_view
    from mathutils import Vector

    from backend.scene_io.cameras import intrinsics

    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene, rng = bpy.context.scene, np.random.default_rng(0)
    data = bpy.data.cameras.new("camera")
    camera = bpy.data.objects.new("camera", data)
    scene.collection.objects.link(camera)
    data.sensor_width, data.sensor_height, data.lens = 31.0, 23.0, 40.0
    data.shift_x, data.shift_y = 0.07, -0.11
    for fit in ("AUTO", "HORIZONTAL", "VERTICAL"):
        for size in ((160, 90), (90, 160), (100, 100)):
            for aspect in ((1.0, 1.0), (1.0, 1.3), (2.0, 1.0)):
                data.sensor_fit = fit
                scene.render.resolution_x, scene.render.resolution_y = size
                scene.render.pixel_aspect_x, scene.render.pixel_aspect_y = aspect
                bpy.context.view_layer.update()
                lens = intrinsics(data, *size, aspect)
                for point in np.c_[rng.uniform(-1, 1, (4, 2)), rng.uniform(-6, -2, 4)]:
                    x, y, _ = world_to_camera_view(scene, camera, Vector(point))
                    expected = lens.cx + lens.fl_x * point[0] / -point[2], lens.cy - lens.fl_y * point[1] / -point[2]
                    np.testing.assert_allclose((x * size[0], (1 - y) * size[1]), expected, atol=1e-3)


def check_what_is_given_back():
    """The scene's own camera and render size come back, but for what the artist has changed since."""
    import bpy

    from backend.scene_io.capture_files import Frame
    from backend.scene_io.photo_cameras import RENDER_SETTINGS, has_loaded_cameras, load_cameras, remove_cameras

    frames = [Frame(Path(f"none/{n}.png"), 120, 90, 130.0, 100.0, 66.0, 40.0, np.eye(4), "linear") for n in range(3)]

    def settings() -> tuple[float, ...]:
        return tuple(getattr(scene.render, name) for name in RENDER_SETTINGS)

    for own_camera, times, changed in ((True, 1, False), (False, 2, False), (True, 2, True)):
        bpy.ops.wm.read_factory_settings(use_empty=True)
        scene = bpy.context.scene
        before = None
        if own_camera:
            before = scene.camera = bpy.data.objects.new("own", bpy.data.cameras.new("own"))
            scene.collection.objects.link(before)
        scene.render.resolution_x, scene.render.resolution_y, scene.render.pixel_aspect_x = 1000, 500, 1.5
        own = settings()
        for _ in range(times):
            cameras, *_ = load_cameras(scene, Path("none"), frames)
        assert settings()[:2] == (120, 90) and settings() != own
        assert scene.camera == (before or cameras[0])
        scene.camera = cameras[1]  # the artist looks through a photo
        if changed:
            scene.render.resolution_x = 640
        assert remove_cameras(scene) == 3 and not has_loaded_cameras(scene)
        assert scene.camera == before
        assert settings() == ((640, *own[1:]) if changed else own)
        assert not [key for key in scene.keys() if key.startswith("nep_")]
    load_cameras(scene, Path("none"), frames, match_render=False)
    assert settings() == (640, *own[1:])
    bpy.data.collections.remove(scene.collection.children[0])  # by the artist, in the Outliner
    load_cameras(scene, Path("none"), frames)
    bpy.data.collections.remove(scene.collection.children[0])
    assert has_loaded_cameras(scene)
    remove_cameras(scene)
    assert settings() == (640, *own[1:]) and not has_loaded_cameras(scene)


if __name__ == "__main__":
    globals()[sys.argv[1]](*sys.argv[2:])
