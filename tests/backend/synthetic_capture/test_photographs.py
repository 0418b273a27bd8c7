"""The scene of photographs: the photographer, the living room, the cameras, two days; and whole captures of photographs."""

import json
import math
import sys
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
from PIL import ExifTags, Image

from support.own_process import in_blender, run_file

SMALL = ("--scene", "box", "--views", 3, "--test-views", 1, "--size", 24, "--samples", 2)


def synthesize(folder: Path, *options: object) -> None:
    done = run_file("backend/synthetic.py", *options, "--out", folder, timeout=200)
    assert done.returncode == 0, done.stderr


def meta_of(folder: Path, name: str = "transforms.json") -> dict:
    return json.loads((folder / name).read_text())


def channels(path: Path) -> dict[str, np.ndarray]:
    found = OpenEXR.File(str(path), separate_channels=True).channels()
    return {name: np.asarray(channel.pixels, np.float32) for name, channel in found.items()}


@pytest.fixture(scope="module")
def clean(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("clean")
    synthesize(folder, *SMALL)
    return folder


@pytest.mark.slow
def test_the_test_views_and_the_ground_truth_stay_clean(clean, tmp_path):
    synthesize(tmp_path, *SMALL, "--photograph", "photographer", "aperture", "framing", "camera")
    assert meta_of(clean, "transforms_test.json") == meta_of(tmp_path, "transforms_test.json")
    for file in ("gt/000.exr", "test/000.exr"):
        one, other = channels(clean / file), channels(tmp_path / file)
        scale = np.median(other["G"] / one["G"]) if file.startswith("test") else 1.0  # the exposure of the photos
        assert all(np.abs(scale * one[name] - other[name]).max() < 0.02 * scale * one[name].max() + 1e-3 for name in one)
    assert (clean / "gt_mesh.ply").read_bytes() == (tmp_path / "gt_mesh.ply").read_bytes()
    assert meta_of(clean)["color_space"] == "linear" and meta_of(tmp_path)["color_space"] == "srgb"


def test_all_effects_together_make_a_capture_with_exif(tmp_path):
    from blender_nep.capture import load_capture
    from blender_nep.capture.camera_settings import expected_response

    synthesize(tmp_path, *SMALL, "--photograph", "all")
    capture = load_capture(tmp_path)
    assert len(capture.views) == 3 and expected_response(capture) == 1, "EXIF names a camera, whose curve is likely"
    told = json.loads((tmp_path / "photographs.json").read_text())
    assert "two_days" in told["effects"] and [photo["day"] for photo in told["photos"]] == [0, 0, 1]
    said = []
    for photo in told["photos"]:
        with Image.open(tmp_path / photo["file_path"]) as image:
            assert image.format == "JPEG" and image.size == (24, 24)
            assert image.getexif()[ExifTags.Base.Make] and image.getexif()[ExifTags.Base.Model]
            tags = image.getexif().get_ifd(ExifTags.IFD.Exif)
        seconds, f_number = (float(tags[tag]) for tag in (ExifTags.Base.ExposureTime, ExifTags.Base.FNumber))
        said.append(seconds * tags[ExifTags.Base.ISOSpeedRatings] / f_number**2 / photo["gain"])
        assert tags[ExifTags.Base.DateTimeOriginal].replace(":", "") == photo["taken_at"].translate(
            {45: "", 58: "", 84: " "}
        )
    np.testing.assert_allclose(np.array(said) / said[0], 1, rtol=5e-3)


def test_a_capture_is_developed_without_rendering(clean, tmp_path):
    for name in ("first", "second"):
        synthesize(tmp_path / name, "--develop", clean, "--photograph", "camera")
    source, first = meta_of(clean), meta_of(tmp_path / "first")
    assert [Path(frame["file_path"]).suffix for frame in first["frames"]] == [".jpg"] * len(source["frames"])
    for one, other in zip(source["frames"], first["frames"], strict=True):
        assert one["transform_matrix"] == other["transform_matrix"]
        assert (clean / one["mask_path"]).read_bytes() == (tmp_path / "first" / other["mask_path"]).read_bytes()
        photos = [(tmp_path / name / other["file_path"]).read_bytes() for name in ("first", "second")]
        assert photos[0] == photos[1], "the same seed gives the same photos"
    for file in ("gt/000.exr", "test/000.exr", "gt_mesh.ply", "transforms_test.json"):
        assert (clean / file).read_bytes() == (tmp_path / "first" / file).read_bytes()
    means = [np.asarray(Image.open(path)).mean() for path in (tmp_path / "first" / "images").iterdir()]
    assert 50 < np.mean(means) < 150


def test_a_random_scene_tells_its_photographs(tmp_path):
    small = ("--views", 3, "--test-views", 1, "--size", 16, "--samples", 1)
    synthesize(tmp_path, "--random", 3, *small, "--photograph", "room", "materials", "noise")
    scene = meta_of(tmp_path, "scene.json")
    assert scene["place"]["kind"] == "living room" and scene["support"]["kind"] == "table"
    assert (
        scene["summary"].endswith("; photographs: materials, noise, room") and "in cells; living room of" in scene["summary"]
    )
    truth, greens = channels(tmp_path / "gt" / "000.exr"), [part["color"][1] for part in scene["substances"]]
    inside = truth["albedo.G"][truth["mask.V"] == 1]
    assert len(inside) and min(greens) - 1e-3 <= inside.min() and inside.max() <= max(greens) + 1e-3
    assert [Path(frame["file_path"]).suffix for frame in meta_of(tmp_path)["frames"]] == [".jpg"] * 3


def test_what_cannot_be_developed_is_refused(clean, tmp_path):
    for source, words in ((tmp_path / "none", "no capture"), (clean, "its own folder")):
        out = tmp_path / "out" if words == "no capture" else source
        options = ("--develop", source, "--photograph", "noise", "--out", out)
        done = run_file("backend/synthetic.py", *options, timeout=100)
        assert done.returncode == 2 and words in done.stderr


def test_the_camera_does_not_see_the_photographer_a_mirror_does():
    in_blender(check_photographer)


def check_photographer():
    import bpy
    from mathutils import Matrix

    from backend.synthetic_capture import scenes
    from backend.synthetic_capture.ground_truth import ViewRenderer
    from backend.synthetic_capture.photograph.effects import Stage
    from backend.synthetic_capture.photograph.session import Camera, Session

    bpy.ops.wm.read_factory_settings(use_empty=True)
    world = bpy.context.scene.world = bpy.data.worlds.new("white")
    world.use_nodes = True
    next(node for node in world.node_tree.nodes if node.type == "BACKGROUND").inputs["Color"].default_value = (1, 1, 1, 1)
    bpy.ops.mesh.primitive_uv_sphere_add(segments=64, ring_count=32, radius=0.6)
    bpy.context.object.data.shade_smooth()
    mirror = scenes.object_material("uniform", (scenes.Substance((1, 1, 1), 0.0, 1.0),), np.random.default_rng(0))
    bpy.context.object.data.materials.append(mirror)
    session = Session(Camera(frozenset({"photographer"}), 0, 1, 1.27), Stage(-7.0, 18.0, 12.0))
    renderer = ViewRenderer(bpy.context.scene, 48, 16, math.radians(43), 0)
    bpy.context.scene.cycles.use_denoising = False
    pose = Matrix.Translation((0, -3, 0)) @ Matrix.Rotation(math.pi / 2, 4, "X")
    photos = {}
    for number in (0, None):
        session.set_up(renderer.camera.data, pose, number)
        photos[number], truth = renderer.render(pose)
    clean, taken, mask = photos[None], photos[0], truth["mask.V"]
    assert np.abs(clean - 1).max() < 0.02, "white everywhere: nobody is in a test view"
    assert np.abs(taken[mask == 0] - 1).max() < 1e-3, "the camera sees nobody"
    steep = Matrix.Rotation(math.radians(-60), 4, "X") @ pose
    session.set_up(renderer.camera.data, steep, 0)
    renderer.camera.data.angle = math.radians(120)  # wide enough for the legs of the photographer
    down, around = renderer.render(steep)
    assert np.abs(down[around["mask.V"] == 0] - 1).max() < 1e-3, "nor where the camera looks down"
    dark = (taken.mean(-1) < 0.5) & (mask == 1)
    rows, columns = np.nonzero(dark)
    assert 20 < dark.sum() < 0.3 * (mask == 1).sum() and abs(columns.mean() - 23.5) < 2 and rows.mean() > 24, (
        "the mirror shows a body before the camera, most of it below"
    )
    lowest = min((item.matrix_world @ corner).z for item in session.photographer.items for corner in corners(item))
    assert abs(lowest + 7.0) < 0.3, "the photographer stands on the floor"


def corners(item):
    from mathutils import Vector

    return [Vector(corner) for corner in item.bound_box]


def test_the_rooms_upper_half_is_in_no_photo():
    in_blender(check_room)


def check_room():
    import bpy
    from mathutils import Vector

    from backend.synthetic_capture import scenes
    from backend.synthetic_capture.photograph.effects import chosen
    from backend.synthetic_capture.photograph.living_room import RADII
    from backend.synthetic_capture.scene_building import build_fixed_scene
    from backend.synthetic_capture.viewpoints import FIELD_OF_VIEW

    edge = math.tan(FIELD_OF_VIEW / 2)
    for seed in (0, 1):
        bpy.ops.wm.read_factory_settings(use_empty=True)
        built = build_fixed_scene("box", None, seed, (24, 4), False, chosen(["room", "framing", "two_days"]))
        assert RADII[0] <= built.stage.half_width <= RADII[1]
        places = [viewpoint.matrix.translation for viewpoint in built.train]
        assert all(place.z > 0 for place in places)
        for viewpoint in built.train + built.test:
            for x, y in ((-edge, edge), (0, edge), (edge, edge)):
                ray = viewpoint.matrix.to_3x3() @ Vector((x, y, -1))
                assert ray.z < 0, "a photo shows what is above the camera"
        table = scenes.triangles(bpy.data.objects["support"])[0][:, 2].max()
        assert abs(table - scenes.triangles(built.target)[0][:, 2].min()) < 1e-4, "the object stands on the table"
        assert abs((table - built.stage.floor) / built.stage.meter - 0.75) < 1e-4
        near = [place.length < 2.7 for place in places]
        assert 4 <= sum(near) <= 16, "some photos are taken from near"
        heights = np.array([place.z / place.length for place in places])
        assert abs(heights[:16].mean() - heights[16:].mean()) < 0.15, "each day has photos of all heights"


def test_a_long_object_is_thin_in_its_sphere():
    in_blender(check_long)


def check_long():
    import bpy

    from backend.synthetic_capture import scenes
    from backend.synthetic_capture.photograph.object_changes import THICKNESS, stretch

    for source in ("suzanne", "box"):
        bpy.ops.wm.read_factory_settings(use_empty=True)
        target, _ = scenes.build_scene(source, "gold", np.random.default_rng(0), alone=True)
        stretch(target)
        vertices, _ = scenes.triangles(target)
        extent = np.sort(np.ptp(vertices, axis=0))
        assert abs(extent[1] / extent[2] - THICKNESS) < 1e-3
        assert np.linalg.norm(vertices, axis=1).max() <= scenes.OBJECT_RADIUS and extent[2] > 1.6


def test_the_light_and_the_lens_change_for_photos_alone():
    in_blender(check_settings)


def check_settings():
    import bpy

    from backend.synthetic_capture.photograph.effects import chosen
    from backend.synthetic_capture.photograph.session import FOCUS, SENSOR, Camera, Session
    from backend.synthetic_capture.scene_building import build_fixed_scene

    bpy.ops.wm.read_factory_settings(use_empty=True)
    effects = chosen(["two_days", "aperture"])
    built = build_fixed_scene("box", None, 0, (3, 1), False, effects)
    session = Session(Camera(effects, 0, 3, 1.27), built.stage)
    lens = bpy.data.cameras.new("camera")

    def strength(name):
        nodes = bpy.data.objects[name].material_slots[0].material.node_tree.nodes
        principled = next(node for node in nodes if node.type == "BSDF_PRINCIPLED")
        return principled.inputs["Emission Strength"].default_value

    matrix = built.train[0].matrix
    found = {}
    for number in (0, 2, None):
        session.set_up(lens, matrix, number)
        found[number] = strength("window"), strength("evening lamp"), lens.dof.use_dof
    assert found[0] == (8, 0, True) and found[None] == (8, 0, False)
    assert found[2][0] < 0.1 and found[2][1] > 10
    session.set_up(lens, matrix, 1)
    # The blur of a far point, as an angle: the width of the aperture over the distance at which the photo is sharp.
    width_in_meters = SENSOR / 36 * lens.lens / 1000 / session.camera.settings[1].f_number
    assert math.isclose(lens.lens / 1000 / lens.dof.aperture_fstop, width_in_meters * built.stage.meter, rel_tol=1e-5)
    assert math.isclose(lens.dof.focus_distance, matrix.translation.length - FOCUS, rel_tol=1e-5)


if __name__ == "__main__":
    globals()[sys.argv[1]](*sys.argv[2:])
