"""Cameras with other axes, directions, rows or scales are found out and read; a right capture stays as it is."""

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from blender_nep.capture import load_capture
from blender_nep.capture.cameras.camera import Camera
from blender_nep.capture.cameras.conventions import MITSUBA, OPENCV, read_poses
from blender_nep.capture.cameras.lens import Lens
from blender_nep.capture.cameras.photo_agreement import PhotoAgreement
from blender_nep.capture.formats import transforms
from blender_nep.errors import BoundsError, CaptureError
from support.captures import look_at

SIZE, FOCAL = (240, 180), 230.0


def poses_around(count: int = 8, arc: float = 2 * np.pi, away: float = 3.0) -> np.ndarray:
    """Cameras [n, 4, 4] on an arc around a place beside the origin, which look at it, at several heights."""
    place = np.array([0.5, -0.3, 0.2])
    turns = arc * np.arange(count) / count
    offsets = [away * np.array([np.cos(t), np.sin(t), 0.3 + 0.1 * np.sin(2.1 * i)]) for i, t in enumerate(turns)]
    return np.stack([look_at(place + offset, place) for offset in offsets])


def poses_before(count: int = 5) -> np.ndarray:
    """Cameras that hardly turn, before a wall: read from the world to the camera, they look at a common place too."""
    places = [np.array([0.2 + (0.3 + 0.03 * i) * np.cos(2.4 * i), -3.0, 0.5 * np.sin(2.4 * i)]) for i in range(count)]
    return np.stack([look_at(place, place * [0.5, 0.0, 0.5]) for place in places])


def no_photos(cameras):
    return None


def capture_with(folder: Path, matrices, **more) -> Path:
    """A capture with black photos and these matrices."""
    (folder / "images").mkdir(parents=True)
    frames = []
    for i, matrix in enumerate(matrices):
        Image.new("RGB", SIZE).save(folder / f"images/{i}.png")
        frames.append({"file_path": f"images/{i}.png", "transform_matrix": np.asarray(matrix).tolist()})
    (folder / "transforms.json").write_text(json.dumps({"fl_x": FOCAL, "frames": frames, **more}))
    return folder


def scaled(poses: np.ndarray, scale: float) -> np.ndarray:
    out = poses.copy()
    out[:, :3, :3] *= scale
    return out


def with_axes(poses: np.ndarray, axes: np.ndarray) -> np.ndarray:
    out = poses.copy()
    out[:, :3, :3] *= axes
    return out


def turned(poses: np.ndarray) -> np.ndarray:
    out = poses.copy()
    out[:, :3, :3] = poses[:, :3, :3].transpose(0, 2, 1)
    return out


def transposed(poses: np.ndarray) -> np.ndarray:
    return poses.transpose(0, 2, 1)


CASES = {
    "as it should be": (lambda p: p, []),
    "OpenCV's axes": (lambda p: with_axes(p, OPENCV), ["opencv_axes"]),
    "world to camera": (np.linalg.inv, ["world_to_camera"]),
    "COLMAP's": (lambda p: np.linalg.inv(with_axes(p, OPENCV)), ["world_to_camera", "opencv_axes"]),
    "transposed": (transposed, ["cameras_transposed"]),
    "transposed, OpenCV's axes": (lambda p: transposed(with_axes(p, OPENCV)), ["cameras_transposed", "opencv_axes"]),
    "transposed, world to camera": (lambda p: transposed(np.linalg.inv(p)), ["cameras_transposed", "world_to_camera"]),
    "scaled": (lambda p: scaled(p, 2.0), ["cameras_scaled"]),
    "made smaller": (lambda p: scaled(p, 0.01), ["cameras_scaled"]),
    "scaled, OpenCV's axes": (lambda p: scaled(with_axes(p, OPENCV), 0.3), ["cameras_scaled", "opencv_axes"]),
    "scaled, world to camera": (lambda p: np.linalg.inv(scaled(p, 3.0)), ["cameras_scaled", "world_to_camera"]),
    "rotations turned": (turned, ["rotations_turned"]),
    "divided by the last number": (lambda p: 4 * p, []),
    "flat": (lambda p: p.reshape(-1, 16), []),
    "without the last row": (lambda p: p[:, :3], []),
}


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("poses", [poses_around(), poses_around(arc=2.0)], ids=["all around", "an arc"])
def test_the_same_cameras_come_back(tmp_path, monkeypatch, case, poses):
    written, codes = CASES[case]
    folder = capture_with(tmp_path / "capture", written(poses))
    if not codes or codes == ["cameras_scaled"]:  # a right capture costs no look at its photos
        monkeypatch.setattr(PhotoAgreement, "__call__", None)
    said = transforms.read(folder)
    np.testing.assert_allclose([view.camera.camera_to_world for view in said.views], poses, atol=1e-9)
    assert [message.code for message in said.warnings] == [f"capture.{code}" for code in codes]


def test_instant_ngps_key_of_mitsuba_counts(tmp_path):
    poses = poses_around()
    said = transforms.read(capture_with(tmp_path / "a", with_axes(poses, MITSUBA), from_mitsuba=True))
    np.testing.assert_allclose([view.camera.camera_to_world for view in said.views], poses, atol=1e-12)
    assert not said.warnings
    said = transforms.read(capture_with(tmp_path / "b", poses, from_mitsuba=True))
    np.testing.assert_allclose([view.camera.camera_to_world for view in said.views], poses, atol=1e-12)
    assert [message.code for message in said.warnings] == ["capture.opengl_axes"]


def test_a_right_capture_keeps_its_bits(tmp_path):
    """Also if its cameras are turned to the outside, and the file says where the object is."""
    inward, outward = poses_around(), with_axes(poses_around(), OPENCV)
    for name, poses, more in (
        ("inward", inward, {}),
        ("outward", outward, {"object_center": (outward[0] @ [0, 0, -2, 1])[:3].tolist(), "object_radius": 0.1}),
    ):
        cameras = [view.camera for view in transforms.read(capture_with(tmp_path / name, poses, **more)).views]
        for camera, pose in zip(cameras, poses, strict=True):
            u, _, v = np.linalg.svd(pose[:3, :3])
            assert (camera.camera_to_world[:3, :3] == u @ v).all() and (camera.position == pose[:3, 3]).all()


def test_cameras_that_fit_nothing_are_left_as_they_are(tmp_path):
    rng = np.random.default_rng(3)
    poses = poses_around()
    for pose in poses:
        pose[:3, :3] = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        pose[:3, :3] *= np.linalg.det(pose[:3, :3])
    folder = capture_with(tmp_path / "capture", poses)
    assert not transforms.read(folder).warnings
    with pytest.raises(BoundsError):
        load_capture(folder)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (np.diag([1.0, 2.0, 1.0, 1.0]), "not rigid"),
        (np.diag([-1.0, 1.0, 1.0, 1.0]), "mirrors"),
        (np.diag([0.0, 0.0, 0.0, 1.0]), "not rigid"),
    ],
)
def test_matrices_that_are_no_cameras_are_refused(tmp_path, change, said):
    with pytest.raises(CaptureError, match=said):
        transforms.read(capture_with(tmp_path / "capture", poses_around() @ change))


@pytest.fixture(scope="module")
def wall(tmp_path_factory):
    """Photos of a painted wall (y = 0) by the cameras `poses_before`, and the cameras themselves."""
    rng = np.random.default_rng(1)
    texture = np.full((600, 600), 128.0)
    for _ in range(900):
        row, column, height, width = rng.integers([0, 0, 6, 6], [600, 600, 40, 40])
        texture[row : row + height, column : column + width] = rng.integers(20, 235)
    folder = tmp_path_factory.mktemp("wall")
    poses = poses_before()
    capture = capture_with(folder / "capture", poses)
    cameras = [view.camera for view in transforms.read(capture).views]
    x, y = np.meshgrid(np.arange(SIZE[0]) + 0.5, np.arange(SIZE[1]) + 0.5)
    for i, camera in enumerate(cameras):
        ray = camera.directions(x.ravel(), y.ravel())
        at = camera.position - ray * (camera.position[1] / ray[:, 1])[:, None]
        column, row = ((at[:, [0, 2]] + 3) * 100).astype(int).clip(0, 599).T
        Image.fromarray(texture[row, column].reshape(SIZE[::-1]).astype(np.uint8)).convert("RGB").save(
            capture / f"images/{i}.png"
        )
    return capture, poses


@pytest.mark.parametrize(
    ("written", "codes"),
    [
        (lambda p: p, []),
        (lambda p: with_axes(p, OPENCV), ["opencv_axes"]),
        (lambda p: with_axes(p, MITSUBA), ["mitsuba_axes"]),
        (np.linalg.inv, ["world_to_camera"]),
    ],
    ids=["as it should be", "OpenCV's axes", "Mitsuba's axes", "world to camera"],
)
def test_photos_decide_where_the_cameras_do_not(wall, written, codes):
    capture, poses = wall
    meta = json.loads((capture / "transforms.json").read_text())
    for frame, matrix in zip(meta["frames"], written(poses), strict=True):
        frame["transform_matrix"] = matrix.tolist()
    (capture / "transforms_changed.json").write_text(json.dumps(meta))
    said = transforms.read(capture, "transforms_changed.json")
    assert [message.code for message in said.warnings] == [f"capture.{code}" for code in codes]
    np.testing.assert_allclose([view.camera.camera_to_world for view in said.views], poses, atol=1e-9)


def test_the_given_reading_wins_where_photos_say_nothing():
    poses = poses_before()
    cameras = [Camera(*SIZE, FOCAL, FOCAL, 120, 90, np.eye(4))] * len(poses)
    read, warnings = read_poses(poses, cameras, [str(i) for i in range(len(poses))], no_photos)
    np.testing.assert_allclose(read, poses, atol=1e-12)
    assert not warnings


def test_photos_agree_with_their_cameras_alone(wall):
    capture, _ = wall
    cameras = [view.camera for view in transforms.read(capture).views]
    agreement = PhotoAgreement([capture / f"images/{i}.png" for i in range(5)])
    assert agreement(cameras) > 0.6
    assert agreement([cameras[i] for i in (3, 0, 2, 4, 1)]) < 0.3
    assert PhotoAgreement([capture / "images/0.png", capture / "nothing.png"])(cameras[:2]) is None


@pytest.mark.parametrize(("orientation", "turns"), [(6, 1), (8, 3), (5, 1), (7, 3)])
def test_the_upright_photos_camera_is_turned_to_the_stored_one(tmp_path, orientation, turns):
    """x', y' in the upright photo of 180 x 240 pixels; x, y in the stored one of 240 x 180."""
    keys = {"w": 180, "h": 240, "fl_x": 230.0, "fl_y": 231.0, "cx": 85.0, "cy": 125.0}
    keys |= {"k1": -0.2, "k2": 0.05, "p1": 0.003, "p2": -0.005}
    folder = capture_with(tmp_path / "capture", poses_around(), **keys)
    exif = Image.Exif()
    exif[274] = orientation
    for photo in folder.glob("images/*.png"):
        Image.new("RGB", SIZE).save(photo, exif=exif)
    (warning,) = transforms.read(folder).warnings
    assert warning.code == "capture.cameras_of_upright" and len(warning.values["names"]) == 8
    lens = Lens(-0.2, 0.05, p1=0.003, p2=-0.005)
    points = np.array([0.5, -0.3, 0.2]) + np.random.default_rng(4).uniform(-0.4, 0.4, (50, 3))
    for view, pose in zip(transforms.read(folder).views, poses_around(), strict=True):
        assert (view.camera.width, view.camera.height) == SIZE
        x_, y_, depth_ = Camera(180, 240, 230.0, 231.0, 85.0, 125.0, pose, lens).project(points)
        x, y, depth = view.camera.project(points)
        np.testing.assert_allclose([x, y], [y_, 180 - x_] if turns == 1 else [240 - y_, x_], atol=1e-9)
        np.testing.assert_allclose(depth, depth_)


def test_other_aspects_without_exif_are_refused(tmp_path):
    folder = capture_with(tmp_path / "capture", poses_around(), w=180, h=240)
    with pytest.raises(CaptureError, match=r"is 240 x 180 pixels, but transforms\.json says 180 x 240"):
        transforms.read(folder)
