"""Random scenes: what a seed draws, the meshes of the objects, the support and the cameras, and the files of photos."""

import itertools
import json
import math
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

from backend.synthetic_capture.random_scene import (
    BRIGHTNESS,
    FIELD_OF_VIEW,
    HALF_WIDTH,
    INDOOR_HDRIS,
    MESH_FILE,
    OBJECT_KINDS,
    OUTDOOR_HDRIS,
    PATTERNS,
    PHOTO_FORMATS,
    ROUGHNESS,
    SUPPORTS,
    TWO_RINGS,
    UPPER_HALF,
    VIEWS,
    WHOLE_SPHERE,
    draw_scene,
)
from backend.synthetic_capture.random_shapes import SHAPES
from support.blender_checks import told_in
from support.own_process import in_blender

SEEDS = range(100)


def test_a_seed_draws_one_scene_and_other_seeds_draw_others():
    assert [draw_scene(seed) for seed in SEEDS] == [draw_scene(seed) for seed in SEEDS]
    assert len({replace(draw_scene(seed), seed=0) for seed in SEEDS}) == len(SEEDS)


def test_a_scene_keeps_the_ranges():
    for seed in SEEDS:
        with told_in(f"seed {seed}"):
            check_ranges(draw_scene(seed))


def check_ranges(scene):
    assert scene.object in OBJECT_KINDS and scene.mesh is None
    assert len(scene.substances) == (1 if scene.pattern == "uniform" else 2)
    assert scene.pattern in ("uniform", *PATTERNS)
    for part in scene.substances:
        assert ROUGHNESS[0] <= part.roughness <= ROUGHNESS[1] and part.metallic in (0, 1)
        assert all(0 <= channel <= 0.95 for channel in part.color)
    if scene.place.kind == "room":
        assert HALF_WIDTH[0] <= scene.place.half_width <= HALF_WIDTH[1] and scene.place.hdri is None
    else:
        assert scene.place.half_width is None and scene.place.hdri in INDOOR_HDRIS + OUTDOOR_HDRIS
    assert 2 <= scene.place.things <= 16
    assert VIEWS[0] <= scene.cameras.views <= VIEWS[1]
    assert FIELD_OF_VIEW[0] <= scene.cameras.field_of_view <= FIELD_OF_VIEW[1]
    assert BRIGHTNESS[0] <= scene.photography.brightness <= BRIGHTNESS[1]
    assert scene.photography.format in PHOTO_FORMATS
    supported = scene.support.kind != "none"
    assert scene.cameras.kind in ((UPPER_HALF, TWO_RINGS) if supported else (WHOLE_SPHERE, UPPER_HALF, TWO_RINGS))
    assert (min(scene.cameras.elevations) > 10) == (scene.cameras.kind != WHOLE_SPHERE)
    assert (scene.support.half_width >= 0.8) == supported


@pytest.mark.parametrize("first", [1, 2], ids=["odd", "even"])
def test_six_odd_or_even_seeds_have_all_objects_and_places(first):
    scenes = [draw_scene(seed) for seed in range(first, first + 12, 2)]
    assert sorted(scene.object for scene in scenes) == sorted(OBJECT_KINDS)
    assert sorted(scene.support.kind for scene in scenes) == sorted(SUPPORTS * 2)
    assert [scene.place.kind for scene in scenes].count("room") == 3


def test_a_hundred_seeds_draw_every_choice():
    scenes = [draw_scene(seed) for seed in SEEDS]
    assert {scene.photography.format for scene in scenes} == set(PHOTO_FORMATS)
    assert {scene.photography.auto_exposure for scene in scenes} == {True, False}
    assert {scene.cameras.kind for scene in scenes} == {WHOLE_SPHERE, UPPER_HALF, TWO_RINGS}
    assert {scene.pattern for scene in scenes} == {"uniform", *PATTERNS}
    assert {part.metallic for scene in scenes for part in scene.substances} == {0.0, 1.0}
    widths = [scene.place.half_width for scene in scenes if scene.place.half_width]
    assert min(widths) < 5 and max(widths) > 40


def test_mesh_files_are_drawn_and_described_by_their_names():
    scenes = [draw_scene(seed, ["/somewhere/cow.ply"]) for seed in SEEDS]
    drawn = [scene for scene in scenes if scene.object == MESH_FILE]
    assert 5 < len(drawn) < 30 and drawn[0].mesh == "/somewhere/cow.ply"
    saved = json.loads(json.dumps(drawn[0].as_json()))
    assert saved["mesh"] == "cow.ply" and saved["summary"] == drawn[0].summary and "somewhere" not in str(saved)
    assert saved["support"]["kind"] == drawn[0].support.kind and saved["cameras"]["views"] == drawn[0].cameras.views


def as_mesh(vertices: np.ndarray, faces: list[list[int]]) -> trimesh.Trimesh:
    fans = [[face[0], face[k], face[k + 1]] for face in faces for k in range(1, len(face) - 1)]
    return trimesh.Trimesh(vertices, fans, process=False)


@pytest.mark.parametrize("kind", SHAPES)
def test_a_shape_is_one_closed_body_whose_faces_point_outward(kind):
    for seed in range(4):
        mesh = as_mesh(*SHAPES[kind](np.random.default_rng(seed)))
        assert mesh.is_watertight and mesh.is_winding_consistent and mesh.volume > 0.05 and mesh.body_count == 1
        handles = 1 - mesh.euler_number / 2
        if kind == "gear":
            assert handles >= 4, "a bore and at least three windows"
        else:
            assert handles == (1 if kind == "torus knot" else 0)


def test_a_vase_is_hollow_and_a_shell_is_thin():
    for seed in range(4):
        vase = as_mesh(*SHAPES["vase"](np.random.default_rng(seed)))
        assert vase.volume < 0.5 * vase.convex_hull.volume
        shell = as_mesh(*SHAPES["thin shell"](np.random.default_rng(seed)))
        assert 2 * shell.volume / shell.area < 0.08


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """A folder with what `build` writes, which all is built in one Blender."""
    folder = tmp_path_factory.mktemp("built")
    in_blender(build, folder, limit_s=400)
    return folder


@pytest.mark.slow
@pytest.mark.parametrize("kind", OBJECT_KINDS)
def test_the_object_is_closed_sized_and_stands_on_its_support(kind, built):
    for support in SUPPORTS:
        found = np.load(built / f"{kind}, {support}.npz")
        mesh = trimesh.Trimesh(found["vertices"], found["faces"])
        assert mesh.is_watertight and mesh.volume > 0.01
        assert np.linalg.norm(mesh.vertices, axis=1).max() == pytest.approx(0.97, abs=1e-3)
        np.testing.assert_allclose(mesh.bounds.sum(0), 0, atol=1e-3)
        if support != "none":
            foot = mesh.bounds[0][2]
            assert float(found["top"]) == pytest.approx(foot, abs=1e-4)
            low = mesh.vertices[mesh.vertices[:, 2] < foot + 0.04]
            assert np.ptp(low[:, :2], axis=0).min() > 0.1, "the object rests on more than a point"
            middle = mesh.convex_hull.centroid[:2]
            assert (low[:, :2].min(0) < middle).all() and (middle < low[:, :2].max(0)).all(), "the object falls over"
        cameras = found["cameras"]
        assert (np.linalg.norm(cameras, axis=1) > 2.4).all() and float(found["clear"]) >= 0.98
        assert float(found["nearest"]) > 0.3
        assert support == "none" or (cameras[:, 2] > float(found["top"]) + 0.3).all()


def build(folder):
    """Build a scene with each kind of object on each support. Write what the test measures into KIND, SUPPORT.npz."""
    import bpy

    from backend.synthetic_capture import scene_building, scenes
    from backend.synthetic_capture.viewpoints import Surroundings

    build_surroundings, around = scene_building.build_surroundings, []
    scene_building.build_surroundings = lambda *given: around.append(build_surroundings(*given)) or around[-1]
    for kind, support in itertools.product(OBJECT_KINDS, SUPPORTS):
        seed = next(
            seed for seed in range(500) if (draw_scene(seed).object, draw_scene(seed).support.kind) == (kind, support)
        )
        scene = draw_scene(seed)
        bpy.ops.wm.read_factory_settings(use_empty=True)
        built = scene_building.build_random_scene(replace(scene, cameras=replace(scene.cameras, views=30)), 2)
        vertices, faces = scenes.triangles(built.target)
        others = [item for item in bpy.data.objects if item.type == "MESH" and item != built.target]
        stand = bpy.data.objects.get("support")
        parts = [item for item in others if item not in around[-1].support]  # the leg of a support is one of its parts
        surroundings = Surroundings(parts, around[-1].support)
        places = [viewpoint.matrix.translation for viewpoint in built.train + built.test]
        nearest = [surroundings.solid.find_nearest(place)[3] for place in places]
        np.savez(
            Path(folder) / f"{kind}, {support}.npz",
            vertices=vertices,
            faces=faces,
            cameras=np.array(places),
            clear=min(surroundings.clear_fraction(place) for place in places),
            nearest=min(nearest),
            top=scenes.triangles(stand)[0][:, 2].max() if stand else math.nan,
        )


def test_a_gain_sets_brightness_and_automatic_exposure_varies():
    in_blender(check_gains)


def check_gains():
    from backend.scene_io.srgb import linear_to_srgb
    from backend.synthetic_capture.files.photo_files import automatic_gain, gain_for

    picture = np.random.default_rng(0).random((8, 8, 3))
    photos = [scale * picture for scale in (0.1, 0.9, 1.2, 40.0)]
    gain = gain_for(photos, 0.35)
    assert abs(np.mean([linear_to_srgb(photo * gain).mean() for photo in photos]) - 0.35) < 1e-6
    base = gain_for([photos[1]], 0.35)
    stops = np.log2([automatic_gain(photo, 0.35, base) / base for photo in photos])
    np.testing.assert_allclose(stops, [0.5, 0, -0.5 * np.log2(1.2 / 0.9), -0.5], atol=0.02)


@pytest.fixture(scope="module")
def photos(tmp_path_factory):
    """A folder with a folder for each format, which holds one photo."""
    folder = tmp_path_factory.mktemp("photos")
    for name in PHOTO_FORMATS:
        (folder / name).mkdir()
    in_blender(write, folder)
    return folder


@pytest.mark.parametrize("name", PHOTO_FORMATS)
def test_the_loader_reads_each_format_of_photos(name, photos):
    from blender_nep.capture.photos.photo_files import open_image

    (path,) = (path for path in (photos / name).iterdir() if path.suffix in (".exr", ".png"))
    found, _ = open_image(path, "srgb").rows()
    clipped = radiance() if path.suffix == ".exr" else np.minimum(radiance(), 1)
    error = {"EXR half linear": 0.05, "PNG 8 bits sRGB": 0.005, "PNG 16 bits sRGB": 2e-5}[name]
    np.testing.assert_allclose(found, clipped, rtol=error, atol=error)


def radiance() -> np.ndarray:
    """A smooth picture [24,32,3] from 0.02 to 2.5. Its rows and columns differ, and its channels do too."""
    rows, columns = np.mgrid[0:24, 0:32] / 32
    return np.stack([0.02 + 2 * columns + 0.5 * rows, 0.1 + rows, 0.5 + 0 * rows], axis=-1).astype(np.float32)


def write(folder):
    from backend.synthetic_capture.files.photo_files import ENDINGS, write_photo

    for name in PHOTO_FORMATS:
        write_photo(Path(folder) / name / f"photo{ENDINGS[name]}", radiance(), name)


if __name__ == "__main__":
    globals()[sys.argv[1]](*sys.argv[2:])
