"""A small synthetic capture. Its cameras, masks and ground truth must agree with its mesh file, which is written apart."""

import contextlib
import io
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
import trimesh
from PIL import Image

from support.blender_checks import told_in
from support.own_process import in_blender
from support.paths import ROOT

LIMIT_S = 120
SIZE = 48
RED, PALE = (0.6, 0.05, 0.04), (0.9, 0.85, 0.75)  # the two substances of 'patches': paint and metal


def render(folder: Path, *options: str) -> subprocess.CompletedProcess:
    command = [sys.executable, ROOT / "backend" / "synthetic.py", "--out", folder, *options]
    return subprocess.run(command, capture_output=True, text=True, timeout=LIMIT_S)


@pytest.fixture(scope="module")
def capture(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("capture")
    done = render(folder, "--scene", "box", "--views", "3", "--test-views", "1", "--size", str(SIZE), "--samples", "8")
    assert done.returncode == 0, done.stderr
    return folder


FOREIGN = {
    "images/000.exr": (),
    "transforms.json": (),
    "gt/notes.txt": (),
    "scene.json": ("--random", "1"),
    "photos/IMG_0001.jpg": ("--snapshots",),
    "with_cameras/transforms.json": ("--snapshots",),
}
"""{somebody else's file in the folder: options with which it would be replaced}"""


def test_somebody_elses_files_are_not_replaced(tmp_path):
    in_blender(check_foreign_files, tmp_path)


def check_foreign_files(folder):
    from backend.synthetic import main

    small = ("--views", "3", "--test-views", "1", "--size", "16", "--samples", "1")
    for number, (name, options) in enumerate(FOREIGN.items()):
        out, said = Path(folder) / str(number), io.StringIO()
        file = out / name
        file.parent.mkdir(parents=True)
        file.write_text("mine")
        with told_in(name), contextlib.redirect_stderr(said):
            assert main(["--out", str(out), *small, *options]) == 2
            assert "choose another --out" in said.getvalue() and file.name in said.getvalue()
            assert [path for path in out.rglob("*") if path.is_file()] == [file] and file.read_text() == "mine"


@pytest.mark.slow
def test_a_capture_of_ours_is_rendered_again(tmp_path):
    small = ("--views", "3", "--test-views", "1", "--size", "16", "--samples", "1", "--snapshots")
    for _ in range(2):
        assert render(tmp_path, *small).returncode == 0
    assert sorted(path.name for path in (tmp_path / "photos").iterdir()) == [f"IMG_000{n}.jpg" for n in (1, 2, 3)]


def frames(capture: Path):
    for name in ("transforms.json", "transforms_test.json"):
        meta = json.loads((capture / name).read_text())
        for frame in meta["frames"]:
            yield meta, frame


def channels(path: Path) -> dict[str, np.ndarray]:
    found = OpenEXR.File(str(path), separate_channels=True).channels()
    return {name: np.asarray(channel.pixels, np.float32) for name, channel in found.items()}


def project(meta: dict, frame: dict, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pixel positions [N,2] and depths [N] after the conventions: camera looks down -z, y up, pixel centers +0.5."""
    matrix = np.linalg.inv(np.array(frame["transform_matrix"]))
    local = points @ matrix[:3, :3].T + matrix[:3, 3]
    depth = -local[:, 2]
    x = meta["cx"] + meta["fl_x"] * local[:, 0] / depth
    y = meta["cy"] - meta["fl_y"] * local[:, 1] / depth
    return np.stack([x, y], axis=1), depth


def surface_points(capture: Path) -> np.ndarray:
    mesh = trimesh.load(capture / "gt_mesh.ply", process=False)
    return np.asarray(trimesh.sample.sample_surface(mesh, 60_000, seed=0)[0])


def test_mesh_projects_onto_masks(capture):
    points = surface_points(capture)
    radius = json.loads((capture / "transforms.json").read_text())["object_radius"]
    assert np.linalg.norm(points, axis=1).max() <= radius
    for meta, frame in frames(capture):
        mask = np.asarray(Image.open(capture / frame["mask_path"]), np.float32) / 255
        assert mask.shape == (SIZE, SIZE)
        pixel = np.floor(project(meta, frame, points)[0]).astype(int)
        assert pixel.min() >= 0 and pixel.max() < SIZE, "the object leaves the picture"
        covered = np.zeros((SIZE, SIZE), bool)
        covered[pixel[:, 1], pixel[:, 0]] = True
        assert (covered & (mask > 0)).sum() >= 0.97 * covered.sum(), "the object is blocked, or the camera is wrong"
        assert (mask[covered] > 0).sum() / ((mask > 0) | covered).sum() > 0.9


def test_depth_is_that_of_the_mesh(capture):
    points = surface_points(capture)
    meta, frame = list(frames(capture))[-1]
    truth = channels(capture / "gt" / "000.exr")
    pixel, depth = project(meta, frame, points)
    index = np.floor(pixel).astype(int)
    nearest = np.full((SIZE, SIZE), np.inf)
    np.minimum.at(nearest, (index[:, 1], index[:, 0]), depth)
    inside = (truth["mask.V"] == 1) & np.isfinite(nearest)
    error = np.abs(nearest - truth["Depth.V"])[inside]
    assert inside.sum() > 200 and np.median(error) < 0.02


def test_the_ground_truth_agrees_with_the_materials_and_the_mask(capture):
    truth = channels(capture / "gt" / "000.exr")
    assert set(truth) == {
        "albedo.R",
        "albedo.G",
        "albedo.B",
        "albedo.A",
        "roughness.V",
        "metallic.V",
        "Normal.X",
        "Normal.Y",
        "Normal.Z",
        "Depth.V",
        "mask.V",
    }
    assert all(np.isfinite(values).all() for values in truth.values())
    mask = truth["mask.V"]
    png = np.asarray(Image.open(capture / "test_masks" / "000.png"), np.float32) / 255
    assert np.abs(png - mask).max() < 0.51 / 255 + 1e-3
    inside = mask == 1
    normal = np.stack([truth[f"Normal.{c}"] for c in "XYZ"], axis=-1)[inside]
    assert np.median(np.abs(np.linalg.norm(normal, axis=1) - 1)) < 0.01
    view = -np.array(json.loads((capture / "transforms_test.json").read_text())["frames"][0]["transform_matrix"])[:3, 2]
    assert (normal @ view < 0.3).all(), "normals point outward, against the view"
    metallic = truth["metallic.V"][inside]
    red, pale = metallic < 1e-3, metallic > 1 - 1e-3
    assert red.sum() > 20 and pale.sum() > 20, "the material varies over the surface"
    albedo = np.stack([truth[f"albedo.{c}"] for c in "RGB"], axis=-1)[inside]
    np.testing.assert_allclose(albedo[red], np.broadcast_to(RED, (red.sum(), 3)), atol=2e-3)
    np.testing.assert_allclose(albedo[pale], np.broadcast_to(PALE, (pale.sum(), 3)), atol=2e-3)
    np.testing.assert_allclose(truth["roughness.V"][inside][red], 0.15, atol=1e-3)
    np.testing.assert_allclose(truth["roughness.V"][inside][pale], 0.25, atol=1e-3)
    outside = mask == 0
    assert outside.any() and truth["albedo.R"][outside].max() == 0


def test_photos_hold_linear_radiance_above_white(capture):
    for _, frame in frames(capture):
        photo = np.stack([channels(capture / frame["file_path"])[c] for c in "RGB"], axis=-1)
        assert photo.shape == (SIZE, SIZE, 3) and np.isfinite(photo).all() and photo.min() >= 0
        assert 0.02 < np.median(photo) < 2 and photo.max() > 1.2


def test_the_same_seed_gives_the_same_cameras_at_any_image_size(capture, tmp_path):
    done = render(tmp_path, "--scene", "box", "--views", "3", "--test-views", "1", "--size", "8", "--samples", "1")
    assert done.returncode == 0, done.stderr
    for (_, first), (_, second) in zip(frames(capture), frames(tmp_path), strict=True):
        assert first == second


def test_a_mesh_file_is_scaled_to_fit_or_refused_if_missing(tmp_path):
    mesh = trimesh.creation.icosphere(subdivisions=2, radius=7.0)
    mesh.apply_translation([100, 0, -3])
    mesh.export(tmp_path / "ball.ply")
    done = render(
        tmp_path / "out",
        "--scene",
        str(tmp_path / "ball.ply"),
        "--views",
        "1",
        "--test-views",
        "0",
        "--size",
        "8",
        "--samples",
        "1",
    )
    assert done.returncode == 0, done.stderr
    ball = trimesh.load(tmp_path / "out" / "gt_mesh.ply", process=False)
    np.testing.assert_allclose(np.linalg.norm(ball.vertices, axis=1), 0.97, atol=1e-3)
    wrong = render(tmp_path / "none", "--scene", str(tmp_path / "missing.obj"))
    assert wrong.returncode == 2 and "missing.obj" in wrong.stderr
    assert not (tmp_path / "none").exists()


def test_a_random_scene_has_photos_of_its_format_and_brightness(tmp_path):
    from blender_nep.capture.photos.formats.png16 import read_png16  # imports torch, which the Blender above does not need

    done = render(tmp_path, "--random", "1", "--views", "4", "--test-views", "1", "--size", str(SIZE), "--samples", "8")
    assert done.returncode == 0, done.stderr
    scene = json.loads((tmp_path / "scene.json").read_text())
    assert (scene["seed"], scene["cameras"]["views"], scene["photography"]["format"]) == (1, 4, "PNG 16 bits sRGB")
    listed = list(frames(tmp_path))
    assert len(listed) == 5 and {Path(frame["file_path"]).suffix for _, frame in listed} == {".png"}
    assert listed[0][0]["color_space"] == "srgb" and (tmp_path / "gt" / "000.exr").is_file()
    photos = [read_png16(tmp_path / frame["file_path"])[..., :3] / 65535 for _, frame in listed]
    assert np.mean(photos) == pytest.approx(scene["photography"]["brightness"], abs=0.06)
    test_mesh_projects_onto_masks(tmp_path)


def test_a_random_scene_below_0_is_refused(tmp_path):
    done = render(tmp_path / "none", "--random", "-1")
    assert done.returncode == 2 and "-1 is below 0" in done.stderr


def test_bundled_capture_is_whole_and_small():
    bundled = ROOT / "data" / "suzanne_small"
    assert sum(path.stat().st_size for path in bundled.rglob("*") if path.is_file()) < 4_000_000
    listed = list(frames(bundled))
    assert len(listed) == 44
    assert all((bundled / frame[key]).is_file() for _, frame in listed for key in ("file_path", "mask_path"))
    assert len(list((bundled / "gt").glob("*.exr"))) == 4 and (bundled / "gt_mesh.ply").is_file()


if __name__ == "__main__":
    globals()[sys.argv[1]](*sys.argv[2:])
