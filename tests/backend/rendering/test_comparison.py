"""The comparison picture: exposure of its tiles, and resizing."""

import sys
from pathlib import Path

import numpy as np
import pytest

from support.captures import write_exr
from support.own_process import in_blender

GREY = 0.25
GAINS = ((1.0, 1.0, 1.0), (2.0, 2.0, 1.5), (0.25, 0.3, 0.25))


@pytest.mark.parametrize("color_space", ["srgb", "linear"])
def test_the_re_rendering_is_exposed_as_its_photo_was(tmp_path, color_space):
    """Photo and world are grey. For every exposure and white balance of the photo, both tiles have the same color."""
    write_exr(tmp_path / "grey.exr", np.full((4, 8, 3), GREY))
    in_blender(check_exposure, tmp_path, color_space)


def check_exposure(folder, color_space):
    import bpy

    from backend.rendering.comparison import TILE_RANGE, compare
    from backend.rendering.contact_sheet import GAP, HEADER
    from backend.scene_io.capture_files import Frame
    from backend.scene_io.image_files import write_png
    from backend.scene_io.srgb import linear_to_srgb
    from backend.scene_io.world import build_world

    bpy.ops.wm.read_factory_settings(use_empty=True)
    world, side = build_world(Path(folder) / "grey.exr", name="grey"), TILE_RANGE[0]
    photos = []
    for number, gain in enumerate(GAINS):
        color = np.full((16, 16, 3), GREY) * gain
        path = Path(folder) / f"{number}.{'png' if color_space == 'srgb' else 'exr'}"
        if color_space == "srgb":
            write_png(path, np.round(255 * linear_to_srgb(color)).astype(np.uint8))
        else:
            write_exr(path, color)
        frame = Frame(path, 16, 16, 16.0, 16.0, 8.0, 8.0, np.eye(4), color_space, gain)
        sheet, _ = compare(bpy.data.objects.new("nothing", None), [frame], world, [], samples=1)
        photo, rendered = (sheet[HEADER : HEADER + side, GAP + k * (side + GAP) :][:, :side] for k in (0, 1))
        photos.append(photo.mean())
        np.testing.assert_allclose(photo.mean((0, 1)), rendered.mean((0, 1)), atol=2)  # of 255: rounding, here and there
    if color_space == "srgb":
        assert photos[1] > photos[0] + 20 > photos[2] + 40, "photos in sRGB are shown as they were taken"
    else:
        assert np.ptp(photos) < 20, "linear photos are exposed alike"


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


if __name__ == "__main__":
    globals()[sys.argv[1]](*sys.argv[2:])
