"""Photos as a phone takes them: their lens and their EXIF data agree with the true cameras, by the library's own lens."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image

from blender_nep.cameras.photo_folder import find_photos
from blender_nep.capture import load_capture
from blender_nep.capture.cameras.lens import NO_DISTORTION
from support.inverted_lens import invert
from support.own_process import in_blender, run_file

SIZE, FINE = 96, 4
ENCODINGS = {"transforms": ("srgb", ".jpg"), "transforms_test": ("linear", ".exr")}


@pytest.fixture(scope="module")
def snapshots(tmp_path_factory):
    folder = tmp_path_factory.mktemp("snapshots")
    (folder / "photos").mkdir()
    (folder / "photos" / "IMG_0004.jpg").write_bytes(b"a photo of an earlier run with more views")
    (folder / "with_cameras").mkdir()
    (folder / "with_cameras" / "gt_mesh.ply").write_bytes(b"its mesh, which shows that the run was ours")
    options = ("--snapshots", "--scene", "box", "--views", 3, "--test-views", 1, "--size", SIZE, "--samples", 4)
    done = run_file("backend/synthetic.py", *options, "--out", folder, timeout=200)
    assert done.returncode == 0, done.stderr
    return folder


def test_the_true_cameras_fit_the_masks(snapshots):
    capture = load_capture(snapshots / "with_cameras")
    mesh = trimesh.load(snapshots / "with_cameras" / "gt_mesh.ply", process=False)
    points = np.asarray(trimesh.sample.sample_surface(mesh, 500_000, seed=0)[0])
    for number, view in enumerate(capture.views):
        mask = capture.load_mask(number)
        with_lens = np.abs(coverage(view.camera, points) - mask).sum()
        without = np.abs(coverage(replace(view.camera, lens=NO_DISTORTION), points) - mask).sum()
        assert with_lens < 0.6 * without  # the rest is the pixel filter
        assert view.camera.lens.k1 == -0.12 and view.camera.lens.k2 == 0.03


def coverage(camera, points):
    """Which part of each pixel [SIZE, SIZE] shows the points: of FINE x FINE places in it."""
    x, y, _ = camera.project(points)
    shown = np.zeros((SIZE * FINE,) * 2)
    shown[tuple(np.floor(FINE * place).astype(int).clip(0, SIZE * FINE - 1) for place in (y, x))] = 1
    return shown.reshape(SIZE, FINE, SIZE, FINE).mean((1, 3))


def test_photos_tell_their_focal_length_and_nothing_else(snapshots):
    photos = find_photos(snapshots / "photos")
    assert [photo.path.name for photo in photos] == ["IMG_0001.jpg", "IMG_0002.jpg", "IMG_0003.jpg"]
    true = load_capture(snapshots / "with_cameras").views[0].camera.fl_x
    assert photos[0].focal_length == pytest.approx(true, rel=0.02)  # EXIF has whole millimeters
    assert len({photo.lens for photo in photos}) == 1
    with Image.open(photos[0].path) as image:
        assert image.size == (SIZE, SIZE) and 40 < np.asarray(image).mean() < 150
    assert not [path for path in (snapshots / "photos").iterdir() if path.suffix != ".jpg"]


def test_each_list_of_photos_has_the_encoding_of_its_photos(snapshots):
    listed = {name: json.loads((snapshots / "with_cameras" / f"{name}.json").read_text()) for name in ENCODINGS}
    assert {name: (meta["color_space"], Path(meta["frames"][0]["file_path"]).suffix) for name, meta in listed.items()} == (
        ENCODINGS
    )


def test_the_lens_is_inverted_exactly():
    in_blender(invert)
