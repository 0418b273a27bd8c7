"""Captures in other forms give the same cameras. pycolmap 4.2.1 wrote `colmap_project/`, and what its cameras see."""

import json
import shutil
import struct
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from blender_nep.capture import PixelRays, load_capture
from blender_nep.capture.cameras.lens import Lens
from blender_nep.capture.formats import colmap
from blender_nep.errors import CaptureError

PROJECT = Path(__file__).parent / "colmap_project"


def project(folder: Path, ending: str, place: str = "sparse/0", photos: str = "images") -> Path:
    """The project with black photos in `folder`, its files with one ending only."""
    (folder / place).mkdir(parents=True)
    for name in ("cameras", "images"):
        shutil.copy(PROJECT / f"{name}.{ending}", folder / place)
    for entry in json.loads((PROJECT / "truth.json").read_text()):
        path = folder / photos / entry["name"]
        path.parent.mkdir(parents=True, exist_ok=True)
        Image.new("RGB", (32, 24)).save(path)
    return folder


@pytest.mark.parametrize("place", ["sparse/0", "colmap/sparse/0", ""])
@pytest.mark.parametrize("ending", ["bin", "txt"])
def test_colmap_cameras_see_what_pycolmap_says(tmp_path, ending, place):
    folder = project(tmp_path / "capture", ending, place)
    assert colmap.recognizes(folder)
    said = colmap.read(folder)
    truth = {entry["name"]: entry for entry in json.loads((PROJECT / "truth.json").read_text())}
    assert [view.name for view in said.views] == ["fourth", "second", "side a/first", "third"]
    for view in said.views:
        entry = truth[f"{view.name}.png"]
        np.testing.assert_allclose(view.camera.position, entry["position"], atol=1e-12)
        x, y = np.array(entry["pixels"]).T
        np.testing.assert_allclose(view.camera.directions(x, y), entry["directions"], atol=1e-9)
    assert said.views[1].camera.lens == Lens(k1=0.02, k2=-0.01, k3=0.003, k4=-0.0005, fisheye=True)


@pytest.mark.parametrize("small", ["bin", "txt"])
@pytest.mark.parametrize("large", ["bin", "txt"])
def test_of_several_models_the_one_with_the_most_photos_counts(tmp_path, small, large):
    """COLMAP numbers its models as it makes them: the first one may be small."""
    folder = project(tmp_path / "capture", large, "sparse/1")
    few = project(tmp_path / "few", "txt") / "sparse/0"
    poses = [line for line in (few / "images.txt").read_text().splitlines() if not line.startswith("#")]
    (few / "images.txt").write_text("\n".join(poses[:4]) + "\n")
    if small == "bin":  # it is only counted
        (few / "images.bin").write_bytes((2).to_bytes(8, "little") + bytes(100))
        shutil.copy(PROJECT / "cameras.bin", few)
    shutil.copytree(few, folder / "sparse/0")
    (folder / "sparse/no model").mkdir()
    said = colmap.read(folder)
    assert len(said.views) == 4 and said.files[0] == folder / f"sparse/1/cameras.{large}"
    values = {"models": 2, "place": "sparse/1", "photos": 4, "others": 2}
    assert [(message.code, message.values) for message in said.warnings] == [("capture.several_models", values)]
    shutil.rmtree(folder / "sparse/0")
    assert len(colmap.read(folder).views) == 4 and not colmap.read(folder).warnings


def test_photos_beside_the_project_and_masks_are_found(tmp_path):
    folder = project(tmp_path / "capture", "txt", photos="")
    (folder / "masks").mkdir()
    (folder / "masks/side a").mkdir()
    for name in ("second.png.png", "third.png", "side a/first_mask.png"):
        Image.new("L", (32, 24)).save(folder / "masks" / name)
    said = colmap.read(folder)
    masks = {view.name: view.mask_path for view in said.views}
    assert masks["second"].name == "second.png.png" and masks["third"].name == "third.png" and masks["fourth"] is None
    assert masks["side a/first"] == folder / "masks/side a/first_mask.png" and not said.warnings


def test_masks_with_the_names_of_no_photo_are_a_warning(tmp_path):
    folder = project(tmp_path / "capture", "txt")
    (folder / "masks/deeper").mkdir(parents=True)
    (folder / "masks/notes.txt").touch()
    assert not colmap.read(folder).warnings
    Image.new("L", (32, 24)).save(folder / "masks/deeper/mask 2.PNG")
    (warning,) = colmap.read(folder).warnings
    assert (warning.code, warning.values) == ("capture.masks_unmatched", {"example": "fourth.png"})


def as_colmap(tiny) -> Path:
    """The capture of `tiny` as a COLMAP project in text form, written here, without transforms.json."""
    camera = tiny.meta
    lines = []
    for number, frame in enumerate(camera["frames"], 1):
        matrix = np.array(frame["transform_matrix"])
        to_camera = (matrix[:3, :3] * [1, -1, -1]).T
        w = 0.5 * np.sqrt(max(0, 1 + np.trace(to_camera)))
        assert w > 0.05, "the formula below needs it"
        x, y, z = (to_camera[[2, 0, 1], [1, 2, 0]] - to_camera[[1, 2, 0], [2, 0, 1]]) / (4 * w)
        t = -to_camera @ matrix[:3, 3]
        numbers = " ".join(repr(float(value)) for value in (w, x, y, z, *t))
        lines += [f"{number} {numbers} 1 {Path(frame['file_path']).name}", ""]
    terms = " ".join(str(camera[key]) for key in ("fl_x", "fl_y", "cx", "cy"))
    (tiny.folder / "cameras.txt").write_text(f"1 PINHOLE {camera['w']} {camera['h']} {terms}\n")
    (tiny.folder / "images.txt").write_text("# two lines a photo\n" + "\n".join(lines) + "\n")
    (tiny.folder / "transforms.json").unlink()
    return tiny.folder


def test_a_capture_gives_the_same_rays_as_a_colmap_project(make_capture):
    tiny = make_capture(views=6)
    before = load_capture(tiny.folder)
    after = load_capture(as_colmap(tiny))
    assert [view.name for view in after.views] == [view.name for view in before.views]
    for one, other in zip(before.views, after.views, strict=True):
        np.testing.assert_allclose(other.camera.camera_to_world, one.camera.camera_to_world, atol=1e-9)
        assert (other.camera.fl_x, other.camera.cx) == (one.camera.fl_x, one.camera.cx)
    # The project says no sphere: it is estimated where the cameras look, which is the tiny capture's center.
    np.testing.assert_allclose(after.object_center, before.object_center, atol=1e-3)
    assert after.bounds_source == "cameras" and len(PixelRays.from_capture(after, 10**6, use_masks=False).sphere) > 0


def test_a_nerf_data_set_is_recognized_by_its_training_file(make_capture):
    tiny = make_capture(views=5, suffix=".png", alpha=True)
    before = load_capture(tiny.folder)
    for frame in tiny.meta["frames"]:
        frame["file_path"] = "./" + frame["file_path"].removesuffix(".png")
    meta = {
        "camera_angle_x": 2 * np.arctan(0.5 * tiny.meta["w"] / tiny.meta["fl_x"]),
        "frames": tiny.meta["frames"],
        "object_center": tiny.meta["object_center"],
        "object_radius": tiny.meta["object_radius"],
    }
    (tiny.folder / "transforms.json").unlink()
    (tiny.folder / "transforms_train.json").write_text(json.dumps(meta))
    after = load_capture(tiny.folder)
    for one, other in zip(before.views, after.views, strict=True):
        assert other.camera.fl_x == pytest.approx(one.camera.fl_x) and other.image_path == one.image_path
        np.testing.assert_array_equal(other.camera.camera_to_world, one.camera.camera_to_world)


def torn(folder):
    path = folder / "sparse/0/images.bin"
    path.write_bytes(path.read_bytes()[:300])


def endless_focal_length(folder):
    path = folder / "sparse/0/cameras.bin"
    data = bytearray(path.read_bytes())
    data[32:40] = np.array([np.inf]).tobytes()
    path.write_bytes(data)


def two_photos(folder):
    (folder / "images/third.png").unlink()
    (folder / "images/fourth.png").unlink()


def model_of_the_future(folder):
    path = folder / "sparse/0/cameras.bin"
    data = bytearray(path.read_bytes())
    data[12] = 77
    path.write_bytes(data)


def other_photos(folder):
    Image.new("RGB", (40, 10)).save(folder / "images/third.png")


def empty(folder):
    (folder / "sparse/0/images.bin").write_bytes(bytes(8))


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (torn, "cannot be read"),
        (endless_focal_length, "cannot be read"),
        (two_photos, "2 of 4 photos of COLMAP are missing, the first: "),
        (model_of_the_future, "^camera model 77 is not supported"),
        (other_photos, "third.png is 40 x 10 pixels, but COLMAP says 32 x 24"),
        (empty, "no photos with a pose"),
    ],
)
def test_a_damaged_project_ends_in_a_clear_message(tmp_path, damage, message):
    folder = project(tmp_path / "capture", "bin")
    damage(folder)
    with pytest.raises(CaptureError, match=message):
        colmap.read(folder)


def with_first_camera(folder, ending, number, model, terms):
    """A project of one photo whose camera has this model of COLMAP. Its other files are those of `project`."""
    made = project(folder, "txt")
    sparse = made / "sparse/0"
    poses = [line for line in (sparse / "images.txt").read_text().splitlines() if not line.startswith("#")]
    words = poses[0].split()
    numbers, camera, name = [float(word) for word in words[1:8]], int(words[8]), " ".join(words[9:])
    if ending == "txt":
        (sparse / "images.txt").write_text("\n".join(poses[:2]) + "\n")
        (sparse / "cameras.txt").write_text(" ".join(map(str, (camera, model, 32, 24, *terms))) + "\n")
        return made
    for text in (sparse / "images.txt", sparse / "cameras.txt"):  # it would have more photos
        text.unlink()
    head = struct.pack("<QiiQQ", 1, camera, number, 32, 24)
    (sparse / "cameras.bin").write_bytes(head + struct.pack(f"<{len(terms)}d", *terms))
    pose = struct.pack("<Qi7di", 1, 1, *numbers, camera)
    (sparse / "images.bin").write_bytes(pose + name.encode() + b"\0" + struct.pack("<Q", 0))
    return made


@pytest.mark.parametrize("ending", ["bin", "txt"])
@pytest.mark.parametrize(
    ("number", "model", "terms"),
    [(14, "SIMPLE_FISHEYE", (30.0, 16.0, 12.0)), (15, "FISHEYE", (30.0, 31.0, 16.0, 12.0))],
)
def test_the_equidistant_lenses_of_colmap_4_are_read(tmp_path, ending, number, model, terms):
    (view,) = colmap.read(with_first_camera(tmp_path / "capture", ending, number, model, terms)).views
    camera = view.camera
    assert camera.lens == Lens(fisheye=True)
    assert (camera.fl_x, camera.fl_y, camera.cx, camera.cy) == (terms[0], terms[-3], 16, 12)
    local = np.array([[np.sin(0.4), 0, -np.cos(0.4)]]) @ camera.camera_to_world[:3, :3].T
    x, y, _ = camera.project(camera.position + local)
    np.testing.assert_allclose([x[0], y[0]], [16 + 30 * 0.4, 12], atol=1e-9)


@pytest.mark.parametrize("ending", ["bin", "txt"])
@pytest.mark.parametrize(
    ("number", "model", "count", "hint"),
    [
        (11, "RAD_TAN_THIN_PRISM_FISHEYE", 16, "image_undistorter"),
        (12, "SIMPLE_DIVISION", 4, "image_undistorter"),
        (13, "DIVISION", 5, "image_undistorter"),
        (16, "EUCM", 6, "image_undistorter"),
        (17, "EQUIRECTANGULAR", 2, "Cut the panoramas into ordinary photos"),
        (18, "18", 6, "OPENCV_FISHEYE"),
    ],
)
def test_other_lenses_of_colmap_4_are_named_as_not_supported(tmp_path, ending, number, model, count, hint):
    folder = with_first_camera(tmp_path / "capture", ending, number, model, [30.0] * count)
    with pytest.raises(CaptureError, match=f"^camera model {model} is not supported") as refused:
        colmap.read(folder)
    assert hint in refused.value.hint


def with_model(folder, model, more):
    """A project whose first camera has another model, with more parameters."""
    made = project(folder, "txt")
    path = made / "sparse/0/cameras.txt"
    path.write_text(path.read_text().replace("1 OPENCV 32 24", f"1 {model} 32 24").replace("-0.001\n", f"-0.001 {more}\n"))
    return made


def test_a_camera_model_that_no_lens_has_is_refused(tmp_path):
    with pytest.raises(CaptureError, match="FULL_OPENCV is not supported"):
        colmap.read(with_model(tmp_path / "capture", "FULL_OPENCV", "0 0 0.01 0"))


def test_a_full_model_without_denominator_is_opencvs_with_k3(tmp_path):
    plain = colmap.read(project(tmp_path / "plain", "txt")).views[0].camera.lens
    lens = colmap.read(with_model(tmp_path / "capture", "FULL_OPENCV", "0.003 0 0 0")).views[0].camera.lens
    assert lens == replace(plain, k3=0.003)
