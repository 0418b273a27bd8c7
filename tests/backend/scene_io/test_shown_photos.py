"""Cameras whose photos have other formats than PNG, JPEG and OpenEXR: what Blender shows of them, and what it cannot."""

import json
import sys
from pathlib import Path

import numpy as np
import pillow_heif
import tifffile
from PIL import Image

from support.captures import look_at, write_exr
from support.own_process import in_blender
from support.raw_photo import write_dng

SIZE = (48, 32)
NAMES = ("whole.tif", "float.tif", "a.webp", "b.jpg", "c.heic", "d.dng", "gone.tif")


def write_capture(folder: Path) -> None:
    """A capture without a color space, as Find Cameras writes it."""
    gray = np.full((*SIZE[::-1], 3), 128, np.uint8)
    image = Image.fromarray(gray)
    tifffile.imwrite(folder / "whole.tif", gray.astype(np.uint16) * 257, photometric="rgb")
    tifffile.imwrite(folder / "float.tif", np.full(gray.shape, 2.5, np.float32), photometric="rgb")
    image.save(folder / "a.webp", lossless=True)
    image.save(folder / "b.jpg")
    pillow_heif.from_pillow(image).save(folder / "c.heic")
    write_dng(folder / "d.dng", np.full(gray.shape, 5000.0))
    frames = []
    for number, name in enumerate(NAMES):
        turn = 2 * np.pi * number / len(NAMES)
        matrix = look_at(np.array([3 * np.cos(turn), 3 * np.sin(turn), 1.0]), np.zeros(3))
        frames.append({"file_path": name, "transform_matrix": matrix.tolist()})
    meta = {"w": SIZE[0], "h": SIZE[1], "fl_x": 50.0, "frames": frames}
    (folder / "transforms.json").write_text(json.dumps(meta))


def test_photos_of_all_formats(tmp_path):
    write_capture(tmp_path)
    in_blender(check_formats, tmp_path)


def check_formats(folder):
    import bpy

    from backend.scene_io.capture_files import read_frames
    from backend.scene_io.photo_cameras import load_cameras
    from backend.scene_io.scene_capture import write_scene_capture

    capture = Path(folder)
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    frames = {frame.path.name: frame for frame in read_frames(capture)}
    spaces = {name: frame.color_space for name, frame in frames.items()}
    assert spaces == dict.fromkeys(NAMES, "srgb") | {"float.tif": "linear", "d.dng": "linear"}
    for name, expected in (("whole.tif", 0.2159), ("float.tif", 2.5), ("a.webp", 0.2159), ("b.jpg", 0.2159)):
        np.testing.assert_allclose(frames[name].photo(), expected, atol=0.005)
    try:
        frames["d.dng"].photo()
    except OSError as error:
        assert "cannot develop the raw photo" in str(error)
    else:
        raise AssertionError("Blender would take the sensor's mosaic for a photo")

    cameras, missing, not_shown = load_cameras(scene, capture, list(frames.values()))
    shows_heif = len(not_shown) == 1  # it depends on how a Blender was built
    assert [path.name for path in not_shown] == (["d.dng"] if shows_heif else ["c.heic", "d.dng"])
    assert [path.name for path in missing] == ["gone.tif"] and len(cameras) == len(NAMES)
    images = {image.name: image.colorspace_settings.name for image in bpy.data.images}
    assert {images["float.tif"]} <= {"Non-Color", "Linear Rec.709"} and "d.dng" not in images
    assert images["whole.tif"] == images["a.webp"] == images["b.jpg"] == "sRGB"

    for camera in cameras:
        if camera.name == "c":  # some Blenders show HEIC
            camera.data.background_images.clear()
    assert write_scene_capture(scene, capture / "made") == 4
    made = {Path(frame["file_path"]).name: (frame["w"], frame["h"]) for frame in read(capture / "made")}
    assert made == dict.fromkeys(("whole.tif", "float.tif", "a.webp", "b.jpg"), SIZE)
    cameras[0].data.background_images[0].image.filepath = str(capture / "c.heic")
    try:
        write_scene_capture(scene, capture / "never")
    except ValueError as error:
        assert "is a raw or HEIC photo" in str(error) and "TIFF, PNG or JPEG" in str(error)
    else:
        raise AssertionError("a HEIC photo is not every Blender's")


def test_exr_photos_are_linear_also_in_a_capture_that_is_srgb(tmp_path):
    """So takes the engine them: see `color_space` in docs/conventions.md."""
    write_exr(tmp_path / "linear.exr", np.full((*SIZE[::-1], 3), 0.5))
    Image.fromarray(np.full((*SIZE[::-1], 3), 188, np.uint8)).save(tmp_path / "encoded.png")
    frames = [{"file_path": name, "transform_matrix": np.eye(4).tolist()} for name in ("linear.exr", "encoded.png")]
    meta = {"w": SIZE[0], "h": SIZE[1], "fl_x": 50.0, "color_space": "srgb", "frames": frames}
    (tmp_path / "transforms.json").write_text(json.dumps(meta))
    in_blender(check_exr, tmp_path)


def check_exr(folder):
    from backend.scene_io.capture_files import read_frames

    linear, encoded = read_frames(Path(folder))
    assert (linear.color_space, encoded.color_space) == ("linear", "srgb")
    np.testing.assert_allclose(linear.photo(), 0.5, atol=1e-3)
    np.testing.assert_allclose(encoded.photo(), 0.5, atol=0.005)


def read(folder: Path) -> list[dict]:
    return json.loads((folder / "transforms.json").read_text())["frames"]


def test_a_cut_out_is_shown_over_gray_in_both_forms_of_alpha(tmp_path):
    """OpenEXR files hold colors that are multiplied by alpha, PNG files do not."""
    color, alpha = np.full((*SIZE[::-1], 3), 0.5), np.full((*SIZE[::-1], 1), 0.25)
    write_exr(tmp_path / "cut.exr", np.concatenate([color * alpha, alpha], -1))
    encoded = np.concatenate([np.full_like(color, 188), 255 * alpha], -1).round().astype(np.uint8)
    Image.fromarray(encoded).save(tmp_path / "cut.png")
    frames = [{"file_path": name, "transform_matrix": np.eye(4).tolist()} for name in ("cut.exr", "cut.png")]
    meta = {"w": SIZE[0], "h": SIZE[1], "fl_x": 50.0, "frames": frames}
    (tmp_path / "transforms.json").write_text(json.dumps(meta))
    in_blender(check_cut_outs, tmp_path)


def check_cut_outs(folder):
    from backend.scene_io.capture_files import GRAY, read_frames

    for frame in read_frames(Path(folder)):
        np.testing.assert_allclose(frame.photo(), 0.25 * 0.5 + 0.75 * GRAY, atol=0.005)


def test_photos_whose_alpha_is_no_cut_out_are_shown_whole(tmp_path):
    """Transparent where the object is, in the middle. One photo without alpha shows that a capture has none."""
    middle = np.zeros(SIZE[::-1], bool)
    middle[8:-8, 12:-12] = True
    for kind, opaque in (("inverted", ~middle), ("cut", middle)):
        for number in range(3):
            pixels = np.dstack([np.full((*SIZE[::-1], 3), 188, np.uint8), np.uint8(255) * opaque])
            Image.fromarray(pixels).save(tmp_path / f"{kind}{number}.png")
    Image.fromarray(np.full((*SIZE[::-1], 3), 188, np.uint8)).save(tmp_path / "opaque.png")
    in_blender(check_whole, tmp_path)


def check_whole(folder):
    import bpy

    from backend.scene_io.capture_files import GRAY, Frame
    from backend.scene_io.photo_alpha import shown_whole
    from backend.scene_io.photo_cameras import load_cameras

    def frames(*names):
        return [Frame(Path(folder) / f"{name}.png", *SIZE, 50, 50, 24, 16, np.eye(4), "srgb") for name in names]

    bpy.ops.wm.read_factory_settings(use_empty=True)
    for kind, whole, inside in (("inverted", True, 0.5), ("cut", False, 0.5)):
        given = frames(*(f"{kind}{number}" for number in range(3)))
        shown = shown_whole(given)
        assert all(frame.ignores_alpha == whole for frame in shown) and not any(frame.ignores_alpha for frame in given)
        photo = shown[0].photo()
        np.testing.assert_allclose(photo[16, 24], inside, atol=0.005)
        np.testing.assert_allclose(photo[0, 0], 0.5 if whole else GRAY, atol=0.005)
        cameras, *_ = load_cameras(bpy.context.scene, Path(folder), given)
        images = [camera.data.background_images[0].image for camera in cameras]
        pixels = np.array(images[0].pixels).reshape(*SIZE[::-1], 4)
        assert (pixels[16, 24, 3], pixels[0, 0, 3]) == (1, 1 if whole else 0), "what the viewport shows"
    assert not any(frame.ignores_alpha for frame in shown_whole(frames("opaque", "inverted0", "inverted1")))
    assert shown_whole([]) == [] and not shown_whole(frames("gone"))[0].ignores_alpha


if __name__ == "__main__":
    globals()[sys.argv[1]](*sys.argv[2:])
