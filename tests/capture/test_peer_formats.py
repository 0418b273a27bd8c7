"""Cameras of programs that others use: known cameras come back, and files that are not read say whose they are."""

import json
import os
import pickle
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from blender_nep.capture import load_capture
from blender_nep.capture.cameras.camera import Camera
from blender_nep.capture.cameras.lens import Lens
from blender_nep.capture.foreign_cameras import foreign_cameras
from blender_nep.errors import CaptureError
from support.camera_exports import HEIGHT, NAMES, TARGET, WIDTH, known_cameras, write_photos
from support.data_set_exports import (
    write_gaussians,
    write_mvsnet,
    write_nero,
    write_openmvg,
    write_realityscan_xmp,
    write_record3d,
    write_sdfstudio,
)
from support.peer_exports import (
    NEWER_REALITYSCAN,
    write_meshroom,
    write_opensfm,
    write_polycam,
    write_realityscan,
    write_visualsfm,
)

BROWN = Lens(k1=-0.2, k2=0.07, k3=0.01, p1=0.004, p2=-0.006)
BROWN_4 = Lens(k1=-0.2, k2=0.07, k3=0.01, k4=-0.002, p1=0.004, p2=-0.006)
RADIAL = Lens(k1=-0.12, k2=0.03)
RADIAL_3 = Lens(k1=-0.12, k2=0.03, k3=0.01)
FISHEYE = Lens(k1=0.04, k2=-0.012, k3=0.003, k4=-0.0004, fisheye=True)
FISHEYE_2 = Lens(k1=0.04, k2=-0.012, fisheye=True)
CASES = {
    "realityscan": (write_realityscan, known_cameras(BROWN_4), []),
    "realityscan, newer": (partial(write_realityscan, header=NEWER_REALITYSCAN), known_cameras(BROWN_4), []),
    "meshroom, brown": (write_meshroom, known_cameras(BROWN, square=False), ["capture.photos_without_pose"]),
    "meshroom, fisheye": (partial(write_meshroom, kind="fisheye"), known_cameras(FISHEYE), ["capture.photos_without_pose"]),
    **{
        f"meshroom {version}": (
            partial(write_meshroom, kind="radial3", version=version),
            known_cameras(RADIAL_3, square=version < (1, 2, 0)),
            ["capture.photos_without_pose"],
        )
        for version in ((1, 0, 0), (1, 2, 0), (1, 2, 1), (1, 2, 4), (1, 2, 5))
    },
    "opensfm, perspective": (
        partial(write_opensfm, kind="perspective"),
        known_cameras(RADIAL, centered=True),
        ["capture.photos_without_pose"],
    ),
    "opensfm, brown": (write_opensfm, known_cameras(BROWN, square=False), ["capture.photos_without_pose"]),
    "opensfm, fisheye": (
        partial(write_opensfm, kind="fisheye"),
        known_cameras(FISHEYE_2, centered=True),
        ["capture.photos_without_pose"],
    ),
    "odm": (
        partial(write_opensfm, kind="fisheye_opencv", place="opensfm"),
        known_cameras(FISHEYE, square=False),
        ["capture.photos_without_pose"],
    ),
    "visualsfm": (write_visualsfm, known_cameras(centered=True), ["capture.photos_without_pose"]),
    "polycam": (write_polycam, known_cameras(square=False), []),
    "realityscan, xmp": (write_realityscan_xmp, known_cameras(BROWN_4), ["capture.photos_without_pose"]),
    "realityscan, xmp in images": (
        partial(write_realityscan_xmp, place="images"),
        known_cameras(BROWN_4),
        ["capture.photos_without_pose"],
    ),
    "openmvg, brown": (write_openmvg, known_cameras(BROWN), ["capture.photos_without_pose"]),
    "openmvg, newer": (
        partial(write_openmvg, kind="disto_k3", newer=True),
        known_cameras(RADIAL_3),
        ["capture.photos_without_pose"],
    ),
    "openmvg, fisheye": (partial(write_openmvg, kind="fisheye"), known_cameras(FISHEYE), ["capture.photos_without_pose"]),
    "openmvg, pinhole": (partial(write_openmvg, kind=""), known_cameras(), ["capture.photos_without_pose"]),
    "record3d": (write_record3d, known_cameras(square=False), []),
    "sdfstudio": (write_sdfstudio, known_cameras(Lens(skew=0.01), square=False), []),
    "mvsnet": (write_mvsnet, known_cameras(Lens(skew=0.01), square=False), []),
    **{
        f"nero, protocol {n}": (partial(write_nero, protocol=n), known_cameras(Lens(skew=0.01), square=False), [])
        for n in (0, 2, 4, 5)
    },
    "gaussians": (write_gaussians, known_cameras(centered=True, square=False), []),
    "polycam, not improved": (partial(write_polycam, corrected=False), known_cameras(square=False), []),
}

FOREIGN = {
    "scan.psx": ("Metashape", "<document/>"),
    "scan.rcproj": ("RealityScan", ""),
    "job.mg": ("Meshroom", '{"header": {"pipelineVersion": "2.2"}}'),
    "sfm_data.bin": ("OpenMVG", ""),
    "scene.mvs": ("OpenMVS", "MVSI"),
    "a_calibrated_camera_parameters.txt": ("Pix4D", ""),
    "blocks.xml": ("iTwin Capture", '<?xml version="1.0"?><BlocksExchange version="3.2"/>'),
    "Barn.log": ("Tanks and Temples", "0 0 0\n1 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1\n"),
    "frame_00000.json": ("3D Scanner App", '{"cameraPoseARFrame": []}'),
    "odometry.csv": ("Stray Scanner", ""),
}


def refused(folder: Path) -> CaptureError:
    with pytest.raises(CaptureError) as caught:
        load_capture(folder)
    return caught.value


def check(folder: Path, truth: list, formulas: list, *, pixels: float = 1e-6):
    """The capture's poses are those of `truth`, and it shows points where the other program's formulas put them."""
    capture = load_capture(folder)
    numbered = [view.name for view in capture.views] == ["0", "1", "2", "3"]
    assert numbered or [view.name for view in capture.views] == [Path(name).stem for name in NAMES]
    points = TARGET + np.random.default_rng(1).uniform(-0.6, 0.6, (200, 3))
    for view, expected, formula in zip(capture.views, truth, formulas, strict=True):
        np.testing.assert_allclose(view.camera.camera_to_world, expected.camera_to_world, atol=1e-6)
        u, v, depth = view.camera.project(points)
        assert (depth > 0).all()
        np.testing.assert_allclose([u, v], formula(points), atol=pixels)
    return capture


@pytest.mark.parametrize("case", CASES)
def test_known_cameras_come_back_and_follow_the_formula(tmp_path, case):
    write, truth, codes = CASES[case]
    capture = check(tmp_path, truth, write(tmp_path, truth))
    assert [warning.code for warning in capture.warnings] == codes
    for view, expected in zip(capture.views, truth, strict=True):
        assert view.camera.lens == expected.lens
        for name in ("width", "height", "fl_x", "fl_y", "cx", "cy"):
            assert getattr(view.camera, name) == pytest.approx(getattr(expected, name), abs=1e-6)


@pytest.mark.parametrize("radial", [-0.15, 0.3])
def test_the_inverse_distortion_of_visualsfm_is_fitted(tmp_path, radial):
    truth = known_cameras(centered=True)
    capture = check(tmp_path, truth, write_visualsfm(tmp_path, truth, radial), pixels=1e-3)
    assert capture.views[0].camera.lens.k1 == pytest.approx(-radial, abs=0.01)


def test_fixed_intrinsics_of_visualsfm_count(tmp_path):
    truth = [Camera(WIDTH, HEIGHT, 71.5, 70.0, 33.7, 21.7, camera.camera_to_world) for camera in known_cameras()]
    check(tmp_path, truth, write_visualsfm(tmp_path, truth, fixed=True))


def test_map_coordinates_of_realityscan_are_moved_to_the_origin(tmp_path):
    write_realityscan(tmp_path, known_cameras(), shift=4e6)
    far = np.stack([view.camera.position for view in load_capture(tmp_path).views])
    near = np.stack([camera.position for camera in known_cameras()])
    assert np.abs(far).max() < 10
    np.testing.assert_allclose(far - far[0], near - near[0], atol=1e-6)


def test_one_matrix_of_record3d_counts_for_all_photos(tmp_path):
    truth = known_cameras()
    capture = check(tmp_path, truth, write_record3d(tmp_path, truth, each=False))
    assert {view.camera.fl_x for view in capture.views} == {truth[0].fl_x}


def write_ring(folder, heading, pitch=-78.7):
    """RealityScan's columns with a ring of cameras; heading: the angle that a script writes for an azimuth in degrees."""
    write_photos(folder)
    rows = ["#name,x,y,alt,heading,pitch,roll,f,px,py,k1,k2,k3,k4,t1,t2"]
    for number, name in enumerate(NAMES):
        azimuth = 360 * number / len(NAMES)
        x, y = 4 * np.cos(np.radians(azimuth)), 4 * np.sin(np.radians(azimuth))
        rows.append(f"{name},{x:.6f},{y:.6f},0.8,{heading(azimuth)},{pitch},0,37.5,0,0,0,0,0,0,0,0")
    (folder / "cameras.csv").write_text("\n".join(rows))


@pytest.mark.parametrize(
    ("heading", "pitch"), [(lambda a: a, -78.7), (lambda a: -a, 78.7), (lambda a: 180 + a, 78.7), (lambda a: 90 - a, 78.7)]
)
def test_scripts_angles_in_realityscans_columns_are_read(tmp_path, heading, pitch):
    """The cameras look at the origin, and the tops of their photos are up."""
    write_ring(tmp_path, heading, pitch)
    capture = load_capture(tmp_path)
    assert "capture.realityscan_angles" in [warning.code for warning in capture.warnings]
    for view in capture.views:
        turn, position = view.camera.camera_to_world[:3, :3], view.camera.position
        np.testing.assert_allclose(-turn[:, 2], -position / np.linalg.norm(position), atol=2e-3)
        assert turn[2, 1] > 0.9 and np.linalg.det(turn) == pytest.approx(1)


@pytest.mark.parametrize("heading", [lambda a: a + 30, lambda a: 2 * a, lambda a: 7 * a % 50])
def test_unknown_angles_in_realityscans_columns_are_refused(tmp_path, heading):
    write_ring(tmp_path, heading)
    with pytest.raises(CaptureError, match=r"cameras look away from the others") as refused:
        load_capture(tmp_path)
    assert "COLMAP" in str(refused.value.hint)


def test_degrees_of_realityscan_are_refused(tmp_path):
    cameras = known_cameras()
    for camera in cameras:
        camera.camera_to_world[:2, 3] = [13.4, 52.5] + camera.camera_to_world[:2, 3] * 1e-5
    write_realityscan(tmp_path, cameras)
    assert "x and y are degrees of longitude and latitude" in refused(tmp_path).message


def test_the_folder_of_polycam_may_be_keyframes_itself(tmp_path):
    truth = known_cameras(square=False)
    check(tmp_path / "keyframes", truth, write_polycam(tmp_path, truth))


def test_meshroom_may_name_the_distortion_apart_from_the_camera(tmp_path):
    truth = known_cameras(BROWN, square=False)
    formulas = write_meshroom(tmp_path, truth)

    def rename(scene):
        for entry in scene["intrinsics"]:
            entry |= {"type": "pinhole", "distortionType": "brown", "undistortionType": "none", "undistortionParams": ""}

    in_json("cameras.sfm", rename)(tmp_path)
    check(tmp_path, truth, formulas)


class _Attack:
    """What a pickle of it calls when it is read as pickles are."""

    def __init__(self, *call):
        self.call = call

    def __reduce__(self):
        return self.call


@pytest.mark.parametrize("protocol", [0, 2, 4])
def test_a_pickle_runs_no_code(tmp_path, protocol):
    write_nero(tmp_path, known_cameras())
    made = tmp_path / "made"
    (tmp_path / "a-camera.pkl").write_bytes(pickle.dumps((_Attack(os.mkdir, (str(made),)), 0), protocol))
    error = refused(tmp_path)
    assert "mkdir, which no array needs" in error.message and not made.exists()


def test_a_pickle_of_other_things_is_refused(tmp_path):
    write_nero(tmp_path, known_cameras())
    for content in (np.zeros((3, 4)), ("pose", "K"), (np.zeros((30, 40)), 0), (np.array([None] * 12), 0)):
        (tmp_path / "a-camera.pkl").write_bytes(pickle.dumps(content))
        assert "a-camera.pkl cannot be read" in refused(tmp_path).message
    (tmp_path / "a-camera.pkl").write_bytes(b"\x80\x04r\xff\xff\xff\x7f")
    assert "a-camera.pkl cannot be read" in refused(tmp_path).message


def in_json(path: str, change):
    """A change of a JSON file."""

    def apply(folder: Path) -> None:
        content = json.loads((folder / path).read_text())
        change(content)
        (folder / path).write_text(json.dumps(content))

    return apply


def in_text(path: str, old: str, new: str):
    """A change of a text file."""

    def apply(folder: Path) -> None:
        text = (folder / path).read_text()
        assert old in text
        (folder / path).write_text(text.replace(old, new))

    return apply


BROKEN = {
    "a line of realityscan is too short": (write_realityscan, in_text("export.csv", "a.png,", ""), "line 3: 15 values"),
    "a comment stands before realityscan's names": (
        write_realityscan,
        in_text("export.csv", "#name", "# #name"),
        "has no line of names",
    ),
    "realityscan has no pitch": (write_realityscan, in_text("export.csv", ",pitch", ",pinch"), "no column pitch"),
    "a word in a line of realityscan": (write_realityscan, in_text("export.csv", "a.png,", "a.png,x"), "line 3: x is not"),
    "meshroom's file is torn": (write_meshroom, in_text("cameras.sfm", '"poses"', ""), "cannot be read"),
    "meshroom's pose scales": (
        write_meshroom,
        in_json("cameras.sfm", lambda scene: scene["poses"][0]["pose"]["transform"].update(rotation=["2"] * 9)),
        "not rigid",
    ),
    "meshroom's distortion is unknown": (
        write_meshroom,
        in_json(
            "cameras.sfm",
            lambda scene: scene["intrinsics"][0].update(
                type="pinhole", distortionType="radialk3pt", distortionParams=["0.1"]
            ),
        ),
        "distortion radialk3pt is not supported",
    ),
    "meshroom's lens is unknown": (
        write_meshroom,
        in_json("cameras.sfm", lambda scene: scene["intrinsics"][0].update(type="3declassicld")),
        "camera type 3declassicld with distortion 3declassicld is not supported",
    ),
    "opensfm's camera is a sphere": (
        write_opensfm,
        in_text("reconstruction.json", '"brown"', '"spherical"'),
        "projection type spherical is not supported",
    ),
    "opensfm's camera is missing": (
        write_opensfm,
        in_json("reconstruction.json", lambda parts: parts[1]["cameras"].pop("v2 a.png")),
        "no JSON object 'v2 a.png'",
    ),
    "visualsfm's file ends early": (write_visualsfm, in_text("model.nvm", "\n4\n", "\n40\n"), "has not 11 parts"),
    "an xmp file is torn": (write_realityscan_xmp, in_text("a.xmp", "</rdf:RDF>", ""), "a.xmp cannot be read"),
    "an xmp file has another lens": (
        partial(write_realityscan_xmp, model="division"),
        in_text("a.xmp", 'Coeficients="0.0', 'Coeficients="-0.1'),
        "the distortion model division is not supported",
    ),
    "openmvg's lens is unknown": (
        write_openmvg,
        in_text("sfm_data.json", '"disto_t2"', '"disto_k1_pba"'),
        "the distortion disto_k1_pba is not supported",
    ),
    "openmvg has no poses yet": (
        write_openmvg,
        in_json("sfm_data.json", lambda scene: scene.update(extrinsics=[])),
        "has no photos with a pose",
    ),
    "record3d's quaternion is long": (
        write_record3d,
        in_json("metadata.json", lambda said: said["poses"][0].__setitem__(3, 9)),
        "not rigid",
    ),
    "sdfstudio's matrix is short": (
        write_sdfstudio,
        in_json("meta_data.json", lambda said: said["frames"][0].update(camtoworld=[[1, 0], [0, 1]])),
        "camtoworld is not a matrix",
    ),
    "mvsnet's file ends early": (
        write_mvsnet,
        lambda folder: (folder / "cams/a_cam.txt").write_text("extrinsic 1 0 0 0 intrinsic 1"),
        "a_cam.txt: extrinsic is not 16 numbers",
    ),
    "a camera of gaussians is no object": (
        write_gaussians,
        in_json("cameras.json", lambda entries: entries.append(3)),
        "no text 'img_name'",
    ),
    "polycam's number is missing": (
        write_polycam,
        in_json("keyframes/corrected_cameras/a.json", lambda said: said.pop("t_12")),
        "a.json: t_12 is not a number",
    ),
    "polycam's focal length is 0": (
        write_polycam,
        in_json("keyframes/corrected_cameras/a.json", lambda said: said.update(fx=0)),
        "must be positive",
    ),
}


@pytest.mark.parametrize("case", BROKEN)
def test_a_broken_file_says_what_is_wrong(tmp_path, case):
    write, spoil, message = BROKEN[case]
    write(tmp_path, known_cameras())
    spoil(tmp_path)
    error = refused(tmp_path)
    assert error.code == 3 and message in error.message and error.hint


@pytest.mark.parametrize("photos", [0, 3])
@pytest.mark.parametrize("name", FOREIGN)
def test_cameras_that_are_not_read_say_whose_they_are(tmp_path, name, photos):
    program, text = FOREIGN[name]
    (tmp_path / name).write_text(text)
    for number in range(photos):
        Image.new("RGB", (8, 6)).save(tmp_path / f"{number}.jpg")
    error = refused(tmp_path)
    assert (error.code, error.name) == (3, "capture.foreign_cameras")
    assert f"holds cameras of {program} ({name}) that cannot be read" in error.message
    assert (f"blender-nep cameras {tmp_path}" in error.hint) == (photos > 0)


@pytest.mark.parametrize("name", ["train.log", "blocks.xml", "job.mg", "0.xmp", "metadata.json", ".hidden.psx"])
def test_other_files_with_such_names_are_nobodys(tmp_path, name):
    (tmp_path / name).write_text("0 0 0\nstarted the search\n")
    assert foreign_cameras(tmp_path) is None
