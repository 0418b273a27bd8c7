"""Captures: cameras, image formats, bounds, and pixels as rays."""

from __future__ import annotations

import json
import struct
import zlib
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from blender_nep.capture import Camera, PixelRays, load_capture, loading
from blender_nep.capture.bounds import sphere_from_cameras
from blender_nep.capture.doctor.summary import describe, summarize
from blender_nep.capture.photos.photo_files import open_image
from blender_nep.capture.rays.pixel_width import pixel_footprint, pixel_width
from blender_nep.color import linear_to_srgb, srgb_to_linear
from blender_nep.errors import CaptureError
from blender_nep.fields.visual_hull import carve, mask_silhouettes, score_cells
from blender_nep.job.folders.run_folder import fingerprint
from blender_nep.messages import Message
from blender_nep.presets import preset
from support.captures import CENTER, RADIUS, look_at, write_exr
from support.recorded_rows import record_rows


def test_camera_directions_project_back():
    camera = Camera(40, 30, 50.0, 45.0, 21.0, 14.0, look_at(np.array([2.0, 1.0, 1.5]), CENTER))
    rng = np.random.default_rng(0)
    x, y = rng.uniform(0, 40, 50), rng.uniform(0, 30, 50)
    points = camera.position + rng.uniform(0.5, 5, (50, 1)) * camera.directions(x, y)
    px, py, depth = camera.project(points)
    np.testing.assert_allclose(np.stack([px, py]), np.stack([x, y]), atol=1e-9)
    assert (depth > 0).all()


def test_rays_equal_the_camera_model_after_downscaling(make_capture):
    """Directions, origins and cone angles against Camera and the exact solid angle of a pixel's pyramid."""
    capture = load_capture(make_capture(views=4, size=24).folder)
    rays = PixelRays.from_capture(capture, 12 * 12, use_masks=False)
    assert rays.size == [(12, 12)] * 4 and rays.offset == [0, 144, 288, 432, 576]
    for view in range(4):
        camera = capture.views[view].camera
        index = torch.arange(rays.offset[view], rays.offset[view + 1])
        origin, direction, half = rays.rays(index)
        y, x = np.mgrid[:12, :12] * 2 + 1.0
        np.testing.assert_allclose(direction, camera.directions(x.ravel(), y.ravel()), atol=1e-6)
        unit = capture.to_unit[:3, :3] @ camera.position + capture.to_unit[:3, 3]
        np.testing.assert_allclose(origin, np.tile(unit, (144, 1)), atol=1e-6)
        assert (rays.view_of(index) == view).all()
    # the pyramid over the whole frame: Omega = 4 asin(sin(a/2) sin(b/2)) for full angles a, b
    half_frame = np.arctan(12 / (1.2 * 24))
    whole = 4 * np.arcsin(np.sin(half_frame) ** 2)
    cones = (2 * np.pi * (1 - torch.cos(half.double()))).sum()
    assert abs(float(cones) / whole - 1) < 0.005


def test_the_footprint_is_the_pixels_width_at_the_object(make_capture):
    """A pixel 1 / fl of a radian wide, seen from a known distance; off the axis it is somewhat narrower."""
    capture = load_capture(make_capture(views=4, size=48).folder)
    rays = PixelRays.from_capture(capture, 10**6, use_masks=False)
    distance = [np.linalg.norm(v.camera.position - capture.object_center) / capture.object_radius for v in capture.views]
    assert pixel_footprint(rays) == pytest.approx(np.median(distance) / capture.views[0].camera.fl_x, rel=0.1)
    assert float(pixel_width(torch.tensor(0.5))) == pytest.approx(0.5 * np.sqrt(np.pi), rel=2e-3)


def test_sphere_and_outside_split_the_valid_pixels(make_capture):
    capture = load_capture(make_capture(views=5).folder)
    rays = PixelRays.from_capture(capture, 10**6, use_masks=False)
    origin, direction, _ = rays.rays(torch.arange(rays.count))
    closest = torch.linalg.cross(origin, direction).norm(dim=-1)
    np.testing.assert_array_equal(rays.sphere.tensor(), torch.nonzero(closest < 1).squeeze(-1))
    assert len(rays.sphere) + len(rays.outside) == rays.count


def test_box_filter_is_a_mean_in_linear_space(make_capture):
    tiny = make_capture(views=3, size=8, suffix=".png")
    pixels = np.random.default_rng(1).integers(0, 256, (8, 8, 3)).astype(np.uint8)
    Image.fromarray(pixels).save(tiny.folder / "images/000.png")
    rays = PixelRays.from_capture(load_capture(tiny.folder), 16, use_masks=False)
    expected = srgb_to_linear(pixels / 255.0).reshape(4, 2, 4, 2, 3).mean((1, 3)).reshape(16, 3)
    np.testing.assert_allclose(rays.radiance[:16], expected, atol=1e-6)


def test_srgb_is_inverted():
    x = np.linspace(0, 1, 1001)
    np.testing.assert_allclose(srgb_to_linear(linear_to_srgb(x)), x, atol=1e-6)
    # the standard's own numbers: the linear part, and half the encoded range
    np.testing.assert_allclose(srgb_to_linear(np.array([0.0, 0.04045, 0.5, 1.0])), [0, 0.0031308, 0.2140411, 1], atol=1e-7)
    np.testing.assert_array_equal(linear_to_srgb(np.array([-1.0, 2.0])), [0, 1])


def write_png16(path, pixels, filters):
    """An independent 16-bit PNG writer: each row with one of the five filters, byte by byte as the standard says."""
    height, width, channels = pixels.shape
    step, previous, packed = 2 * channels, bytes(2 * channels * width), b""
    for y in range(height):
        row = pixels[y].astype(">u2").tobytes()
        kind, out = filters[y % len(filters)], bytearray()
        for i in range(len(row)):
            a, b = row[i - step] if i >= step else 0, previous[i]
            c = previous[i - step] if i >= step else 0
            paeth = min((a, b, c), key=lambda v, p=a + b - c: abs(p - v))
            out.append((row[i] - (0, a, b, (a + b) // 2, paeth)[kind]) % 256)
        packed, previous = packed + bytes([kind]) + bytes(out), row

    def chunk(name, data):
        return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))

    head = struct.pack(">IIBBBBB", width, height, 16, {1: 0, 2: 4, 3: 2, 4: 6}[channels], 0, 0, 0)
    data = zlib.compress(packed)
    body = chunk(b"IHDR", head) + chunk(b"IDAT", data[:9]) + chunk(b"IDAT", data[9:]) + chunk(b"IEND", b"")
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + body)


@pytest.mark.parametrize("channels", [1, 2, 3, 4])
def test_png_of_16_bits_keeps_all_of_them(tmp_path, channels):
    pixels = np.random.default_rng(channels).integers(0, 65536, (11, 7, channels))
    write_png16(tmp_path / "a.png", pixels, filters=(0, 1, 2, 3, 4))
    color, alpha = open_image(tmp_path / "a.png", "linear").rows()
    expected = pixels[..., :3] if channels >= 3 else np.repeat(pixels[..., :1], 3, -1)
    np.testing.assert_array_equal(np.round(color * 65535), expected)
    assert (alpha is None) == (channels in (1, 3))
    if alpha is not None:
        np.testing.assert_array_equal(np.round(alpha * 65535), pixels[..., -1])


@pytest.mark.parametrize("prefix", ["", "View Layer.Combined.", "rgba."])
def test_exr_channels_are_found_by_name(tmp_path, prefix):
    rng = np.random.default_rng(0)
    planes = {c: rng.uniform(0, 30, (5, 6)).astype(np.float32) for c in "RGB"}
    channels = {prefix + c: p for c, p in planes.items()} | {"AAA.Depth.V": np.ones((5, 6), np.float32)}
    write_exr(tmp_path / "a.exr", channels)
    color, alpha = open_image(tmp_path / "a.exr", "linear").rows()
    np.testing.assert_array_equal(color, np.stack(list(planes.values()), -1))
    assert alpha is None


def test_exr_alpha_is_associated(tmp_path):
    pixels = np.zeros((4, 4, 4), np.float32)
    pixels[1:3, 1:3] = (0.25, 0.125, 0.5, 0.5)
    write_exr(tmp_path / "a.exr", pixels)
    color, alpha = open_image(tmp_path / "a.exr", "linear").rows()
    np.testing.assert_allclose(color[1, 1], (0.5, 0.25, 1.0))
    assert alpha[1, 1] == 0.5 and alpha[0, 0] == 0 and color[0, 0, 0] == 0


def test_camera_angle_and_missing_extension(make_capture):
    """The form of Blender's NeRF datasets: camera_angle_x, no intrinsics, no file extension."""
    tiny = make_capture(suffix=".png")
    expected = load_capture(tiny.folder).views[0].camera
    for key in ("w", "h", "fl_x", "fl_y", "cx", "cy"):
        del tiny.meta[key]
    tiny.meta["camera_angle_x"] = 2 * np.arctan(0.5 * 24 / (1.2 * 24))
    for frame in tiny.meta["frames"]:
        frame["file_path"] = "./" + frame["file_path"].removesuffix(".png")
    found = load_capture(tiny.save())
    camera = found.views[0].camera
    assert (camera.width, camera.height, camera.cx, camera.cy) == (24, 24, 12, 12)
    assert camera.fl_x == pytest.approx(expected.fl_x) and camera.fl_y == pytest.approx(expected.fl_y)
    assert found.color_space == "srgb" and found.warnings == []


def test_intrinsics_of_a_frame_win_and_rescale_with_the_photo(make_capture):
    tiny = make_capture(size=24)
    tiny.meta["frames"][1] |= {"w": 48, "h": 48, "fl_x": 60.0, "fl_y": 62.0, "cx": 25.0, "cy": 23.0}
    capture = load_capture(tiny.save())
    camera = capture.views[1].camera
    assert (camera.width, camera.fl_x, camera.fl_y, camera.cx, camera.cy) == (24, 30.0, 31.0, 12.5, 11.5)
    assert [warning.code for warning in capture.warnings] == ["capture.photos_rescaled"]


def test_sphere_from_cameras_finds_where_they_look():
    rng = np.random.default_rng(3)
    target, cameras = np.array([1.0, -2.0, 0.5]), []
    for _ in range(20):
        away = rng.normal(size=3)
        position = target + 4 * away / np.linalg.norm(away)
        cameras.append(Camera(100, 80, 120.0, 120.0, 50.0, 40.0, look_at(position, target)))
    center, radius = sphere_from_cameras(cameras)
    np.testing.assert_allclose(center, target, atol=1e-6)
    # the largest ball in a frustum of half height 40 at focal length 120
    assert radius == pytest.approx(4 * np.sin(np.arctan(40 / 120)), rel=1e-6)


def test_sphere_from_masks_holds_the_object(make_capture):
    tiny = make_capture(views=20, size=64, masks=True, bounds=False, ball=0.5)
    capture = load_capture(tiny.folder)
    assert capture.bounds_source == "masks"
    np.testing.assert_allclose(capture.object_center, CENTER, atol=0.06)
    slack = capture.object_radius - np.linalg.norm(capture.object_center - CENTER) - 0.5
    assert 0 <= slack < 0.2
    ignored = load_capture(tiny.folder, use_masks=False)
    assert ignored.bounds_source == "cameras" and ignored.object_radius > 0.6


@pytest.mark.parametrize("bounds", [True, False])
def test_photos_whose_masks_show_nothing_are_left_out(make_capture, bounds):
    """A program that makes masks sometimes finds no object. One in six would make the hull empty, and the sphere, too."""
    tiny = make_capture(views=18, size=48, masks=True, bounds=bounds)
    failed = [2, 7, 11]
    for number in failed:
        Image.new("L", (48, 48)).save(tiny.folder / f"masks/{number:03d}.png")
    capture = load_capture(tiny.folder)
    assert bounds or capture.bounds_source == "masks"
    np.testing.assert_allclose(capture.object_center, CENTER, atol=0.06)
    rays = PixelRays.from_capture(capture, 10**6, use_masks=True)
    (warning,) = (message for message in rays.warnings if message.code == "capture.masks_empty")
    assert warning.values == {"count": 3, "names": [capture.views[number].name for number in failed]}
    assert "3 photos are left out: their masks show nothing" in str(warning)
    valid = [bool(rays.valid[rays.offset[i] : rays.offset[i + 1]].any()) for i in range(18)]
    assert [number for number in range(18) if not valid[number]] == failed
    assert not set(failed) & set(rays.view_of(rays.sphere[:]).tolist())
    hull = carve(score_cells(rays, mask_silhouettes(rays), 24))
    assert hull is not None and hull.volume == pytest.approx(0.5**3 / capture.object_radius**3, rel=0.3)
    assert len(PixelRays.from_capture(capture, 10**6, use_masks=False).sphere) > len(rays.sphere)


@pytest.mark.parametrize("how", [{"alpha": True}, {"masks": True}], ids=["alpha", "masks"])
@pytest.mark.parametrize("suffix", [".png", ".exr"])
def test_coarse_masks_read_little_and_keep_no_whole_ones(make_capture, monkeypatch, how, suffix):
    """The sphere needs masks of 200 to 400 pixels, and what they mean masks of half of that.

    No photo is made linear for them, and few rows of mask files.
    """
    tiny = make_capture(views=4, size=820, bounds=False, suffix=suffix, **how)
    lengths = record_rows(monkeypatch)
    capture = load_capture(tiny.folder)
    assert capture.bounds_source == "masks"
    assert sum(lengths) == (4 * (205 + 102) if "masks" in how else 0)
    coarse = loading._coarse_mask(capture, 1)
    assert coarse.shape == (205, 205) and coarse.dtype == np.float32
    assert (coarse if coarse.base is None else coarse.base).size == 205 * 205
    np.testing.assert_array_equal(coarse, capture.load_mask(1)[2::4, 2::4])
    assert "masks" in how or np.array_equal(capture.load_mask(1), capture.load_photo(1)[1])


def test_alpha_is_the_mask_and_knows_no_background(make_capture):
    tiny = make_capture(views=4, alpha=True)
    capture = load_capture(tiny.folder)
    rays = PixelRays.from_capture(capture, 10**6, use_masks=True)
    assert rays.background is False and len(rays.outside) == 0
    inside = rays.mask > 127
    assert inside.any() and not inside.all()
    np.testing.assert_allclose(rays.radiance[inside], 0.4, atol=1e-3)
    assert (rays.radiance[~inside] == 0).all()


@pytest.mark.parametrize(("scale", "offset"), [(1e-4, 1e6), (1e4, 1e6), (1e-4, 0.0)])
def test_a_scene_of_any_size_anywhere_has_the_same_rays(make_capture, scale, offset):
    tiny = make_capture()
    before = PixelRays.from_capture(load_capture(tiny.folder), 10**6, use_masks=True)
    for frame in tiny.meta["frames"]:
        matrix = np.array(frame["transform_matrix"])
        matrix[:3, 3] = scale * matrix[:3, 3] + offset
        frame["transform_matrix"] = matrix.tolist()
    tiny.meta["object_center"] = (scale * CENTER + offset).tolist()
    tiny.meta["object_radius"] *= scale
    after = PixelRays.from_capture(load_capture(tiny.save()), 10**6, use_masks=True)
    index = torch.arange(before.count)
    # float64 holds a position at 1e6 to 1.2e-10, which is 1.5e-6 of the smallest scene's radius
    for one, other in zip(before.rays(index), after.rays(index), strict=True):
        assert (one - other).abs().max() < 3e-6


def test_photos_from_one_place_warn_and_two_places_are_refused(make_capture):
    tiny = make_capture()
    frames = tiny.meta["frames"]
    frames[4]["transform_matrix"] = frames[1]["transform_matrix"]
    tiny.save()
    assert load_capture(tiny.folder).warnings == [Message("capture.same_place", {"count": 1, "names": ["004"]})]
    for i, frame in enumerate(frames):
        frame["transform_matrix"] = frames[i % 2]["transform_matrix"]
    with pytest.raises(CaptureError, match="only 2 different places"):
        load_capture(tiny.save())


def test_some_bad_pixels_are_left_out_with_a_warning(make_capture):
    tiny = make_capture(views=3)
    pixels = np.full((24, 24, 3), 0.5, np.float32)
    pixels[2, 3] = np.nan
    pixels[5, 6, 1] = np.inf
    pixels[7, 8] = -4
    pixels[9, 9] = 65504
    write_exr(tiny.folder / "images/001.exr", pixels)
    rays = PixelRays.from_capture(load_capture(tiny.folder), 10**6, use_masks=False)
    first = rays.offset[1]
    bad = {first + 2 * 24 + 3, first + 5 * 24 + 6}
    assert set(torch.nonzero(~rays.valid).squeeze(-1).tolist()) == bad
    assert not bad & set(torch.cat([rays.sphere.tensor(), rays.outside.tensor()]).tolist())
    assert torch.isfinite(rays.radiance).all() and rays.radiance.min() == 0
    assert rays.radiance.max() == 6e4
    left_out, negative, blinding = rays.warnings
    assert str(left_out) == "2 pixels in 1 photo are NaN or Inf and are left out: 001.exr"
    assert str(negative) == "1 pixel in 1 photo is negative and is taken as 0: 001.exr"
    assert str(blinding) == "1 pixel in 1 photo is brighter than 60000 and is set to that value: 001.exr"


def test_a_black_photo_is_left_out(make_capture):
    tiny = make_capture(views=4)
    write_exr(tiny.folder / "images/002.exr", np.zeros((24, 24, 3), np.float32))
    rays = PixelRays.from_capture(load_capture(tiny.folder), 10**6, use_masks=False)
    assert not rays.valid[rays.offset[2] : rays.offset[3]].any()
    assert rays.warnings == [Message("capture.photos_black", {"count": 1, "names": ["002.exr"]})]


def test_unit_frame_and_back(make_capture):
    capture = load_capture(make_capture().folder)
    np.testing.assert_allclose(capture.to_unit @ capture.from_unit, np.eye(4), atol=1e-12)
    np.testing.assert_allclose(capture.from_unit @ [0, 0, 1, 1], [CENTER[0], CENTER[1], CENTER[2] + RADIUS, 1])


def test_the_summary_describes_the_capture(make_capture):
    found = summarize(make_capture(masks=True, suffix=".png").folder)
    assert json.loads(json.dumps(found))["photos"] == 6
    assert found["masks"] and 0 < found["mask_coverage"] < 1 and found["bounds_source"] == "transforms.json"
    text = describe(found)
    assert "6 photos" in text and "8-bit" in text and "only 6 photos" in text


def test_photos_may_lie_outside_the_folder(make_capture, tmp_path):
    """A run's fingerprint names photos by their place relative to the folder, wherever they are."""
    tiny = make_capture()
    elsewhere = tmp_path / "elsewhere"
    (tiny.folder / "images").rename(elsewhere)
    for frame in tiny.meta["frames"]:
        frame["file_path"] = str(elsewhere / Path(frame["file_path"]).name)
    capture = load_capture(tiny.save())
    assert capture.files == (tiny.folder / "transforms.json",)
    before = fingerprint(capture, preset("preview"), 0, True, None)
    (tiny.folder / "transforms.json").write_text(json.dumps(tiny.meta | {"object_radius": 0.7}))
    after = fingerprint(load_capture(tiny.folder), preset("preview"), 0, True, None)
    assert {key for key in before if before[key] != after[key]} == {"capture"}
