"""Known cameras come back from the files of other programs, and damaged files end in a clear message."""

import json
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from backend.scene_io.capture_files import read_bounds, read_frames, read_frames_of
from blender_nep.asset.cameras_file import CAMERAS, cameras_content
from blender_nep.capture import load_capture
from blender_nep.capture.cameras.lens import Lens
from blender_nep.capture.formats import bundler, cameras_sphere, llff, metashape
from blender_nep.errors import CaptureError
from support.camera_exports import (
    HEIGHT,
    NAMES,
    TARGET,
    WIDTH,
    known_cameras,
    similarity,
    write_bundler,
    write_cameras_sphere,
    write_llff,
    write_metashape,
    write_photos,
)

RADIAL = Lens(k1=-0.12, k2=0.03)
ALL_TERMS = Lens(k1=-0.2, k2=0.07, k3=0.01, k4=-0.002, p1=0.004, p2=-0.006)
FISHEYE = Lens(k1=0.04, k2=-0.012, k3=0.003, k4=-0.0004, fisheye=True)
GEOGRAPHIC = 'GEOGCS["WGS 84",DATUM["World Geodetic System 1984"]]'


def fisheye_metashape(folder, cameras):
    return write_metashape(folder, cameras, kind="fisheye")


def moved_metashape(folder, cameras):
    return write_metashape(folder, cameras, transform=similarity(3), reference='LOCAL_CS["Local Coordinates (m)"]')


def component_metashape(folder, cameras):
    return write_metashape(folder, cameras, transform=similarity(4), of_component=True)


CASES = {
    "llff": (write_llff, known_cameras(centered=True)),
    "cameras_sphere": (write_cameras_sphere, known_cameras(square=False)),
    "metashape": (write_metashape, known_cameras(ALL_TERMS, square=False)),
    "metashape, transform of the chunk": (moved_metashape, known_cameras(ALL_TERMS)),
    "metashape, transform of the component": (component_metashape, known_cameras(RADIAL)),
    "metashape, fisheye": (fisheye_metashape, known_cameras(FISHEYE)),
    "bundler": (write_bundler, known_cameras(RADIAL, centered=True)),
}
WRITERS = [write_llff, write_cameras_sphere, write_metashape, write_bundler]


@pytest.mark.parametrize("case", CASES)
def test_known_cameras_come_back_and_follow_the_formats_formula(tmp_path, case):
    write, truth = CASES[case]
    formulas = write(tmp_path, truth)
    capture = load_capture(tmp_path)
    assert [view.name for view in capture.views] == [Path(name).stem for name in NAMES] and not capture.warnings
    points = TARGET + np.random.default_rng(1).uniform(-0.6, 0.6, (200, 3))
    for view, expected, formula in zip(capture.views, truth, formulas, strict=True):
        camera = view.camera
        np.testing.assert_allclose(camera.camera_to_world, expected.camera_to_world, atol=1e-6)
        for name in ("width", "height", "fl_x", "fl_y", "cx", "cy"):
            assert getattr(camera, name) == pytest.approx(getattr(expected, name), abs=1e-6)
        assert camera.lens == expected.lens
        u, v, depth = camera.project(points)
        assert (depth > 0).all()
        np.testing.assert_allclose([u, v], formula(points), atol=1e-6)


@pytest.mark.parametrize("write", WRITERS)
def test_blenders_side_reads_the_cameras_from_the_asset_alone(tmp_path, write):
    folder, asset = tmp_path / "capture", tmp_path / "asset"
    folder.mkdir()
    asset.mkdir()
    write(folder, known_cameras(centered=True))
    assert read_bounds(folder) is None
    with pytest.raises(OSError, match=re.escape("has no transforms.json")):
        read_frames(folder)
    capture = load_capture(folder)
    (asset / CAMERAS).write_text(json.dumps(cameras_content(capture, asset)))
    for frame, view in zip(read_frames_of(folder, asset), capture.views, strict=True):
        assert frame.path.samefile(view.image_path) and frame.fl_x == view.camera.fl_x


def test_llff_takes_smaller_copies_of_the_photos(tmp_path):
    write_llff(tmp_path, known_cameras(centered=True))
    shutil.rmtree(tmp_path / "images")
    write_photos(tmp_path / "images_4", size=(WIDTH // 4, HEIGHT // 4))
    said = llff.read(tmp_path)
    assert [message.code for message in said.warnings] == ["capture.photos_rescaled"]
    assert [view.camera.fl_x for view in said.views] == pytest.approx([17.5, 18.25, 19, 19.75])
    assert said.views[0].camera.cx == WIDTH / 8


def test_the_sphere_and_the_masks_of_neus_count(tmp_path):
    write_cameras_sphere(tmp_path, known_cameras())
    names = [f"{i:03d}.png" for i in range(4)]
    write_photos(tmp_path / "mask", names)
    capture = load_capture(tmp_path)
    np.testing.assert_allclose(capture.object_center, TARGET)
    assert capture.object_radius == pytest.approx(0.7) and capture.bounds_source == "cameras_sphere.npz"
    assert [view.mask_path.name for view in capture.views] == names


def test_neus_without_a_sphere_and_with_the_other_names(tmp_path):
    write_cameras_sphere(tmp_path, known_cameras(), file="cameras.npz", sphere=False)
    (tmp_path / "image").rename(tmp_path / "images")
    capture = load_capture(tmp_path)
    assert capture.bounds_source == "cameras" and capture.files == (tmp_path / "cameras.npz",)


def test_float32_projections_of_any_scale_are_decomposed(tmp_path):
    truth = known_cameras(square=False)
    write_cameras_sphere(tmp_path, truth, skew=0.001)
    path = tmp_path / "cameras_sphere.npz"
    with np.load(path) as stored:
        content = {name: (3 * stored[name] if "world" in name else stored[name]).astype(np.float32) for name in stored.files}
    np.savez(path, **content)
    for view, expected in zip(cameras_sphere.read(tmp_path).views, truth, strict=True):
        np.testing.assert_allclose(view.camera.camera_to_world, expected.camera_to_world, atol=1e-4)
        assert view.camera.fl_x == pytest.approx(expected.fl_x, rel=1e-4)


def test_metashape_leaves_out_what_has_no_pose(tmp_path):
    more = (
        '<camera id="7" sensor_id="0" label="unplaced"/>'
        '<camera id="8" sensor_id="0" component_id="0" label="off" enabled="false">'
        "<transform>1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1</transform></camera>"
    )
    write_metashape(tmp_path, known_cameras(), more_cameras=more)
    said = metashape.read(tmp_path)
    assert len(said.views) == 4
    assert [(m.code, m.values) for m in said.warnings] == [
        ("capture.photos_without_pose", {"count": 2, "names": ["unplaced", "off"]})
    ]
    assert str(said.warnings[0]).startswith("2 photos are left out, because they have no camera pose or are disabled")


def test_a_geographic_reference_keeps_scale_near_the_origin(tmp_path):
    truth, transform = known_cameras(), similarity(5, distance=6e6)
    write_metashape(tmp_path, truth, transform=transform, of_component=True, reference=GEOGRAPHIC)
    found = [view.camera for view in metashape.read(tmp_path).views]
    turn, shift, _ = transform
    for camera, expected in zip(found, truth, strict=True):
        np.testing.assert_allclose(camera.position, turn.T @ (expected.position - shift), rtol=1e-9)
    between, expected = (np.linalg.norm(c[0].position - c[1].position) for c in (found, truth))
    assert between == pytest.approx(expected, rel=1e-6)


def test_metashape_rescales_to_the_photos_and_finds_masks(tmp_path):
    write_metashape(tmp_path, known_cameras())
    write_photos(tmp_path / "images", size=(2 * WIDTH, 2 * HEIGHT))
    write_photos(tmp_path / "masks", ["a.png", "c.png.png"], size=(2 * WIDTH, 2 * HEIGHT))
    said = metashape.read(tmp_path)
    assert [message.code for message in said.warnings] == ["capture.photos_rescaled"]
    assert said.views[0].camera.fl_x == pytest.approx(140)
    assert [view.mask_path and view.mask_path.name for view in said.views] == ["a.png", None, "c.png.png", None]


@pytest.mark.parametrize("write", [write_llff, write_metashape, write_bundler])
def test_masks_with_the_names_of_no_photo_are_a_warning(tmp_path, write):
    write(tmp_path, known_cameras(centered=True))
    write_photos(tmp_path / "masks", ["mask of a.png"])
    capture = load_capture(tmp_path)
    assert not any(view.mask_path for view in capture.views)
    assert [message.code for message in capture.warnings] == ["capture.masks_unmatched"]
    write_photos(tmp_path / "masks", ["a_mask.png"])
    capture = load_capture(tmp_path)
    assert capture.views[0].mask_path == tmp_path / "masks/a_mask.png" and not capture.warnings


def test_bundler_leaves_out_what_it_has_not_placed(tmp_path):
    write_bundler(tmp_path, known_cameras(centered=True))
    path = tmp_path / "bundle.out"
    lines = path.read_text().splitlines()
    path.write_text("\n".join([*lines[:7], *["0 0 0"] * 5, *lines[12:]]))
    said = bundler.read(tmp_path)
    assert [view.name for view in said.views] == ["a", "c", "d"]
    assert [(m.code, m.values["names"]) for m in said.warnings] == [("capture.photos_without_pose", ["b 2.png"])]


@pytest.mark.parametrize(
    ("form", "place"),
    [
        ("{name} 0 532.5", "images"),
        ("./images/{name}", "images"),
        ("C:\\my photos\\{name}", "images"),
        ("/nowhere/set/{name}", "set"),
        ("{folder}/elsewhere/{name}", "../elsewhere"),
    ],
)
def test_photos_are_found_by_what_the_list_says(tmp_path, form, place):
    folder = tmp_path / "capture"
    folder.mkdir()
    write_bundler(folder, known_cameras())
    (folder / place).mkdir(parents=True)
    for name in NAMES:
        (folder / name).rename(folder / place / name)
    (folder / "list.txt").write_text("\n".join(form.format(name=name, folder=tmp_path) for name in NAMES))
    found = [view.image_path for view in bundler.read(folder).views]
    assert all(one.samefile(folder / place / name) for one, name in zip(found, NAMES, strict=True))


def test_bundlers_folders_and_other_names_of_files_are_known(tmp_path):
    write_bundler(tmp_path, known_cameras())
    (tmp_path / "bundle").mkdir()
    (tmp_path / "bundle.out").rename(tmp_path / "bundle/scan.out")
    (tmp_path / "list.txt").rename(tmp_path / "scan.list.txt")
    assert load_capture(tmp_path).files == (tmp_path / "bundle/scan.out", tmp_path / "scan.list.txt")


def two_photos(folder):
    for name in ("c.png", "d.png"):
        next(folder.rglob(name)).unlink()


def no_photo(folder):
    next(folder.rglob("c.png")).unlink()


def no_photos(folder):
    for path in list(folder.rglob("*.png")):
        path.unlink()


def one_more_photo(folder):
    write_photos(next(folder.rglob("c.png")).parent, ["e.png"])


def torn(folder):
    path = next(path for path in folder.iterdir() if path.suffix in (".npy", ".npz", ".xml", ".out"))
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def changed_rows(change):
    """Changes the poses [n, 3, 5] of LLFF."""

    def damage(folder):
        path = folder / "poses_bounds.npy"
        rows = np.load(path)
        poses = rows[:, :15].reshape(-1, 3, 5).copy()
        change(poses)
        np.save(path, np.hstack([poses.reshape(-1, 15), rows[:, 15:]]))

    return damage


def changed_arrays(change):
    """Changes the arrays of NeuS."""

    def damage(folder):
        path = folder / "cameras_sphere.npz"
        with np.load(path) as stored:
            content = dict(stored)
        change(content)
        np.savez(path, **content)

    return damage


def changed_text(file, change):
    def damage(folder):
        (folder / file).write_text(change((folder / file).read_text()))

    return damage


def with_line(n, change):
    """Changes line n of bundle.out. Camera 1 has the lines 7 to 11."""

    def changed(text):
        lines = text.splitlines()
        lines[n] = change(lines[n])
        return "\n".join(lines)

    return changed_text("bundle.out", changed)


def negated(line):
    return " ".join(str(-float(word)) for word in line.split())


def set_to(index, value):
    return lambda array: array.__setitem__(index, value)


def times(index, factor):
    return lambda array: array.__setitem__(index, array[index] * factor)


def sensor_text(old, new):
    return changed_text("cameras.xml", lambda text: text.replace(old, new))


def pose_text(change):
    """Changes the 16 numbers of the second camera's pose, as strings."""

    def changed(text):
        label = text.index(f'label="{NAMES[1]}"')
        begin = text.index("<transform>", label) + len("<transform>")
        end = text.index("</transform>", begin)
        return text[:begin] + " ".join(change(text[begin:end].split())) + text[end:]

    return changed_text("cameras.xml", changed)


BAD = [
    (write_llff, torn, "poses_bounds.npy cannot be read"),
    (write_llff, no_photo, "poses_bounds.npy has 4 cameras, but images/ has 3 photos"),
    (write_llff, no_photos, "poses_bounds.npy has 4 cameras, but images/ has 0 photos"),
    (write_llff, one_more_photo, "poses_bounds.npy has 4 cameras, but images/ has 5 photos"),
    (write_llff, changed_rows(set_to((1, 0, 3), np.nan)), "poses_bounds.npy: b 2.png: its pose is not finite"),
    (write_llff, changed_rows(set_to((1, 0, 0), np.nan)), "poses_bounds.npy: b 2.png: its pose is not finite"),
    (write_llff, changed_rows(times((2, slice(None), 0), -1)), "poses_bounds.npy: c.png: its pose mirrors"),
    (write_llff, changed_rows(times((2, slice(None), 0), 2)), "poses_bounds.npy: c.png: its pose is not rigid"),
    (write_llff, changed_rows(set_to((3, 2, 4), 0)), "poses_bounds.npy: d.png: focal length and size must be positive"),
    (write_llff, changed_rows(set_to((0, 0, 4), 200)), "a.png is 64 x 48 pixels, but poses_bounds.npy says 64 x 200"),
    (write_llff, lambda folder: np.save(folder / "poses_bounds.npy", np.ones((4, 12))), "poses_bounds.npy holds"),
    (write_cameras_sphere, torn, "cameras_sphere.npz cannot be read"),
    (write_cameras_sphere, no_photo, "cameras_sphere.npz has 4 cameras, but image/ has 3 photos"),
    (
        write_cameras_sphere,
        lambda folder: write_photos(folder / "mask", ["a.png"]),
        "masks in mask/ (1) is not that of the cameras of cameras_sphere.npz",
    ),
    (write_cameras_sphere, changed_arrays(set_to("world_mat_1", np.full((4, 4), np.nan))), "npz has no world_mat_1"),
    (write_cameras_sphere, changed_arrays(times("world_mat_1", np.array([[1], [0], [1], [1]]))), "is no camera"),
    (write_cameras_sphere, changed_arrays(times("world_mat_2", -1)), "npz: world_mat_2 of c.png mirrors"),
    (write_cameras_sphere, changed_arrays(lambda arrays: arrays.pop("world_mat_3")), "has 3 cameras"),
    (write_cameras_sphere, changed_arrays(times("scale_mat_0", np.diag([1, 2, 1, 1]))), "scale_mat_0 does not take"),
    (write_metashape, torn, "cameras.xml cannot be read"),
    (write_metashape, two_photos, "2 of 4 photos of cameras.xml are missing, the first: c"),
    (write_metashape, pose_text(lambda words: ["none", *words[1:]]), "cameras.xml: b 2.png: transform is not 16 numbers"),
    (write_metashape, pose_text(lambda words: words[:12]), "cameras.xml: b 2.png: transform is not 16 numbers"),
    (
        write_metashape,
        pose_text(lambda words: [negated(word) if i % 4 == 0 and i < 12 else word for i, word in enumerate(words)]),
        "cameras.xml: b 2.png: its pose mirrors",
    ),
    (write_metashape, sensor_text('sensor_id="1"', 'sensor_id="77"'), "cameras.xml: camera b 2.png has no sensor"),
    (write_metashape, sensor_text('type="frame"', 'type="spherical"'), "camera type spherical is not supported"),
    (write_metashape, sensor_text('type="frame"', 'type="equisolid_fisheye"'), "equisolid_fisheye is not supported"),
    (
        write_metashape,
        sensor_text("</calibration>", "<p3>0.1</p3></calibration>"),
        "lens 0: the distortion p3 of camera type frame",
    ),
    (write_metashape, sensor_text("<f>", "<fx>"), "cameras.xml cannot be read"),
    (write_metashape, sensor_text("<f>70.0</f>", "<fx>70.0</fx>"), "lens 0 has no calibration with a focal length"),
    (write_metashape, sensor_text(">70.0<", ">inf<"), "cameras.xml: sensor lens 0: f is not 1 number"),
    (write_metashape, sensor_text(' width="64"', ""), "cameras.xml: sensor lens 0: resolution is not 2 numbers"),
    (write_metashape, sensor_text('label="a"', 'label="d"'), "cameras.xml has several cameras for d.png"),
    (write_metashape, sensor_text('component_id="0" label="c"', 'component_id="1" label="c"'), "into 2 components"),
    (write_metashape, sensor_text("<camera ", '<camera enabled="false" '), "cameras.xml has no photos with a pose"),
    (write_metashape, lambda folder: shutil.copy(folder / "cameras.xml", folder / "b.xml"), "several exports of Metashape"),
    (write_bundler, torn, "bundle.out cannot be read"),
    (write_bundler, two_photos, "2 of 4 photos of list.txt are missing, the first: c.png"),
    (write_bundler, changed_text("list.txt", lambda text: text + "e.png"), "bundle.out has 4 cameras, but list.txt has 5"),
    (
        write_bundler,
        changed_text("list.txt", lambda text: text.replace("c.", "d.")),
        "list.txt has several cameras for d.png",
    ),
    (write_bundler, lambda folder: (folder / "list.txt").unlink(), "bundle.out has no list of photos"),
    (write_bundler, with_line(8, lambda line: "nan " + line.split(maxsplit=1)[1]), "bundle.out: b 2.png: its pose is not"),
    (write_bundler, with_line(11, lambda line: "nan " + line.split(maxsplit=1)[1]), "bundle.out: b 2.png: its pose is not"),
    (write_bundler, with_line(7, lambda line: "73.0 nan 0"), "bundle.out: b 2.png: its distortion is not finite"),
    (write_bundler, with_line(7, lambda line: "-73.0 0 0"), "bundle.out: b 2.png: focal length and size must be positive"),
    (write_bundler, with_line(8, negated), "bundle.out: b 2.png: its pose mirrors"),
    (write_bundler, with_line(1, lambda line: "many cameras"), "bundle.out cannot be read"),
]


@pytest.mark.parametrize(("write", "damage", "message"), BAD, ids=[f"{case[0].__name__} {case[2]}" for case in BAD])
def test_a_damaged_capture_ends_in_a_clear_message(tmp_path, write, damage, message):
    write(tmp_path, known_cameras(centered=True))
    damage(tmp_path)
    with pytest.raises(CaptureError, match=re.escape(message)):
        load_capture(tmp_path)


def test_tangential_distortion_of_a_fisheye_is_refused(tmp_path):
    write_metashape(tmp_path, known_cameras(FISHEYE), kind="equidistant_fisheye", terms="<p1>0.001</p1>")
    with pytest.raises(CaptureError, match="distortion p1 of camera type equidistant_fisheye"):
        metashape.read(tmp_path)


def test_the_axes_of_realityscans_other_export_are_refused(tmp_path):
    write_bundler(tmp_path, known_cameras(), flip=-1.0)
    with pytest.raises(CaptureError, match=r"points of bundle.out lie behind") as caught:
        bundler.read(tmp_path)
    assert "negative z" in caught.value.hint


def test_other_files_with_these_endings_are_no_capture(tmp_path):
    (tmp_path / "notes.xml").write_text("<chunk><cameras/></chunk>")
    (tmp_path / "broken.xml").write_text("no xml")
    (tmp_path / "render.out").write_text("done")
    Image.new("RGB", (8, 8)).save(tmp_path / "photo.png")
    with pytest.raises(CaptureError, match=re.escape("has no transforms.json")) as caught:
        load_capture(tmp_path)
    assert all(word in caught.value.hint for word in ("COLMAP", "Metashape", "Bundler", "LLFF", "NeuS"))
