"""The keys of transforms.json for lenses are read as the programs mean them that write them, or refused by name."""

import json
import math

import numpy as np
import pytest
from PIL import Image

from backend.scene_io.capture_files import read_frames
from blender_nep.asset.cameras_file import CAMERAS, cameras_content
from blender_nep.capture import load_capture
from blender_nep.capture.cameras.camera import Camera
from blender_nep.capture.cameras.lens import Lens
from blender_nep.capture.cameras.plausible_lens import lens_warnings
from blender_nep.capture.formats import cameras_sphere, metashape, transforms
from blender_nep.errors import CaptureError
from support.camera_exports import known_cameras, write_cameras_sphere, write_metashape

FOCAL_KEYS = ("fl_x", "fl_y", "camera_angle_x", "camera_angle_y", "x_fov", "y_fov")
SIZE = {"w": 24, "h": 18}
FOCAL = 30.0
ANGLE_X, ANGLE_Y = 2 * math.atan(12 / FOCAL), 2 * math.atan(9 / FOCAL)


@pytest.fixture
def read(make_capture):
    """read(keys, of_frame) -> the first camera of a capture with these keys, at the top of its file or in its frames."""

    def read(keys, of_frame=None):
        tiny = make_capture(views=4, size=24)
        for photo in tiny.folder.glob("images/*.exr"):
            photo.unlink()
        for number, frame in enumerate(tiny.meta["frames"]):
            frame["file_path"] = f"images/{number}.png"
            Image.new("RGB", (24, 18)).save(tiny.folder / frame["file_path"])
            frame.update(of_frame or {})
        for key in (*FOCAL_KEYS, "cx", "cy"):
            tiny.meta.pop(key, None)
        tiny.meta |= SIZE | keys
        tiny.save()
        read.folder = tiny.folder
        read.said = transforms.read(tiny.folder)
        return read.said.views[0].camera

    return read


@pytest.mark.parametrize(
    "keys",
    [
        {"fl_x": FOCAL},
        {"fl_y": FOCAL},
        {"camera_angle_x": ANGLE_X},
        {"camera_angle_y": ANGLE_Y},
        {"camera_angle_x": ANGLE_X, "camera_angle_y": ANGLE_Y},
        {"x_fov": math.degrees(ANGLE_X)},
        {"y_fov": math.degrees(ANGLE_Y)},
        {"fl_x": FOCAL, "camera_angle_x": 1.0},
    ],
)
def test_each_key_gives_the_focal_length(read, keys):
    camera = read(keys)
    assert (camera.fl_x, camera.fl_y) == pytest.approx((FOCAL, FOCAL)) and not read.said.warnings
    assert (camera.cx, camera.cy) == (12, 9)
    frame = read_frames(read.folder)[0]
    assert (frame.fl_x, frame.fl_y) == pytest.approx((FOCAL, FOCAL)), "Blender's side"


def test_the_angles_of_both_axes_count(read):
    camera = read({"camera_angle_x": ANGLE_X, "camera_angle_y": 2 * math.atan(9 / 30.6)})
    assert (camera.fl_x, camera.fl_y) == pytest.approx((30, 30.6)) and not read.said.warnings


def test_an_angle_that_would_make_oblong_pixels_is_a_warning(read):
    """Some programs write the horizontal angle twice."""
    camera = read({"camera_angle_x": ANGLE_X, "camera_angle_y": ANGLE_X})
    assert (camera.fl_x, camera.fl_y) == pytest.approx((FOCAL, FOCAL))
    assert [(said.code, said.values["count"]) for said in read.said.warnings] == [("capture.angles_disagree", 4)]


TERMS = [-0.2, 0.05, 0.01, -0.002, 0.001, -0.002]


@pytest.mark.parametrize("where", ["top", "frame"])
def test_nerfstudios_list_of_terms_is_read(read, where):
    keys = {"distortion_params": TERMS}
    camera = read({"fl_x": FOCAL, **(keys if where == "top" else {})}, keys if where == "frame" else {})
    assert camera.lens == Lens(*TERMS)


def test_a_list_with_equal_keys_or_keys_of_the_frame(read):
    keys = {"fl_x": FOCAL, "distortion_params": TERMS, "k1": -0.2, "k2": 0.05, "p1": 0.001}
    assert read(keys).lens == Lens(*TERMS)


def test_the_list_of_a_fisheye_is_read(read):
    keys = {"fl_x": FOCAL, "distortion_params": [0.1, 0.02, 0, 0, 0, 0], "camera_model": "OPENCV_FISHEYE"}
    assert read(keys).lens == Lens(0.1, 0.02, fisheye=True)


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        ({"distortion_params": [-0.2, 0.05, 0.001, -0.002]}, "distortion_params is not a list of 6 numbers"),
        ({"distortion_params": "k1"}, "distortion_params is not a list"),
        ({"distortion_params": [0, 0, 0, 0, 0, "p2"]}, "distortion_params is not a number"),
        ({"distortion_params": TERMS, "k1": 0.3}, "distortion_params and k1 contradict each other"),
        ({"k1": 0.1, "k5": 0.01}, "the distortion k5 is not supported"),
        ({"k4": 0.1, "k5": 0.0, "k6": 0.02}, "the distortion k6, k4 is not supported"),
        ({"k4": 0.1, "camera_model": "FULL_OPENCV"}, "the distortion k4 is not supported"),
        ({"equirectangular": True}, "equirectangular photos are not supported"),
        ({"latlong": True}, "latlong photos are not supported"),
        ({"ftheta_p0": 0.1}, "ftheta_p0 photos are not supported"),
        ({"camera_model": "EQUIRECTANGULAR"}, "camera model EQUIRECTANGULAR is not supported"),
        ({"fl_x": None}, "has no focal length"),
        ({"fl_x": None, "x_fov": 190}, "x_fov 190 is not an angle between 0 and 180 degrees"),
        ({"fl_x": None, "camera_angle_y": 40}, "camera_angle_y 40 is not an angle between 0 and pi"),
    ],
)
def test_other_lenses_are_refused_by_the_name_of_their_key(read, keys, said):
    with pytest.raises(CaptureError, match=said):
        read({"fl_x": FOCAL} | keys)


def test_flags_that_are_off_refuse_nothing(read):
    assert read({"fl_x": FOCAL, "equirectangular": False, "k5": 0, "k6": 0.0, "is_fisheye": False}).lens == Lens()


@pytest.mark.parametrize(("write", "reader"), [(write_metashape, metashape), (write_cameras_sphere, cameras_sphere)])
def test_skew_comes_back_from_other_programs(tmp_path, write, reader):
    """Metashape's b1 and b2; 0.4 % of the focal length were 8 pixels of a photo of 24 megapixels."""
    lens = Lens(-0.1, 0.02, skew=0.004) if reader is metashape else Lens(skew=0.004)
    truth = known_cameras(lens, square=False)
    points = np.array([0.4, -0.3, 0.2]) + np.random.default_rng(2).uniform(-0.6, 0.6, (100, 3))
    formulas = write(tmp_path, truth)
    for view, camera, formula in zip(reader.read(tmp_path).views, truth, formulas, strict=True):
        u, v, _ = view.camera.project(points)
        np.testing.assert_allclose([u, v], formula(points), atol=1e-5)
        np.testing.assert_allclose([u, v], camera.project(points)[:2], atol=1e-5)
        assert view.camera.lens.skew == pytest.approx(0.004, abs=1e-6)
        x, y = np.array([5.0, 60.0]), np.array([40.0, 3.0])
        back = view.camera.position + 3 * view.camera.directions(x, y)
        np.testing.assert_allclose(view.camera.project(back)[:2], [x, y], atol=1e-3)


@pytest.mark.parametrize("lens", [Lens(skew=0.01), Lens(0.1, skew=-0.02), Lens(0.05, fisheye=True, skew=0.01)])
def test_skew_is_kept_in_the_cameras_of_an_asset(make_capture, tmp_path, lens):
    tiny = make_capture(views=4)
    capture = load_capture(tiny.folder)
    camera = capture.views[0].camera
    capture.views[0] = type(capture.views[0])(
        "000",
        capture.views[0].image_path,
        None,
        Camera(24, 24, camera.fl_x, camera.fl_y, 12, 12, camera.camera_to_world, lens),
    )
    (tmp_path / CAMERAS).write_text(json.dumps(cameras_content(capture, tmp_path)))
    again = transforms.read(tmp_path, CAMERAS).views[0].camera
    assert again.lens.skew == pytest.approx(lens.skew) and again.lens.fisheye == lens.fisheye
    assert again.scaled(12, 12).lens == again.lens


PLAIN = {"width": 3000, "height": 2000, "fl_x": 2800.0, "fl_y": 2800.0, "cx": 1500.0, "cy": 1000.0, "lens": Lens()}


@pytest.mark.parametrize(
    ("changed", "code"),
    [
        ({"fl_y": 2548.0}, "focal_lengths_differ"),
        ({"cx": 1110.0}, "principal_point_off"),
        ({"cy": 600.0}, "principal_point_off"),
        ({"lens": Lens(k2=1000.0)}, "distortion_large"),
        ({"lens": Lens(k1=-3.0)}, "distortion_large"),
        ({"lens": Lens(p1=0.03)}, "distortion_large"),
        ({"lens": Lens(k1=0.3, k2=-60.0, k3=200.0)}, "distortion_large"),
        ({"fl_x": 300.0, "fl_y": 300.0}, "view_angle_odd"),
        ({"fl_x": 99000.0, "fl_y": 99000.0}, "view_angle_odd"),
        ({"lens": Lens(skew=-0.05)}, "skew_large"),
    ],
)
def test_an_implausible_lens_is_a_warning(changed, code):
    cameras = [Camera(camera_to_world=np.eye(4), **part) for part in (PLAIN, PLAIN | changed, PLAIN | changed)]
    (warning,) = lens_warnings(["a", "b", "c"], cameras)
    assert (warning.code, warning.values["names"]) == (f"capture.{code}", ["b", "c"]) and str(warning) != warning.code


@pytest.mark.parametrize(
    "changed",
    [
        {"fl_y": 2850.0, "cx": 1600.0},
        {"lens": Lens(-0.28, 0.08, 0.0, 0.0, 0.001, -0.001), "fl_x": 1800.0, "fl_y": 1800.0},
        {"lens": Lens(0.04, -0.012, 0.003, fisheye=True), "fl_x": 900.0, "fl_y": 900.0},
        {"lens": Lens(0.1, -1.2, 2.5), "fl_x": 9000.0, "fl_y": 9000.0},
        {"lens": Lens(skew=0.004)},
    ],
)
def test_usual_lenses_are_no_warning(changed):
    assert not lens_warnings(["a"], [Camera(camera_to_world=np.eye(4), **(PLAIN | changed))])
