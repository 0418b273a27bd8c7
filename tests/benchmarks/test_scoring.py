"""The scores of the benchmarks on bodies whose scores are known. Ablations change only the fields that they name."""

from dataclasses import asdict, replace
from datetime import datetime
from types import SimpleNamespace

import numpy as np
import pytest
import torch
import trimesh

pytest.importorskip("igl")
from backend.synthetic_capture.random_scene import draw_scene
from benchmarks.row_files import write_row
from benchmarks.scoring import light_map, shading_normals
from benchmarks.scoring.environment import background_psnr, exposures_differ
from benchmarks.scoring.geometry import Body, inner, load_test_views, score, true_mesh
from benchmarks.scoring.materials import read_channels
from benchmarks.scoring.scores import score_asset
from benchmarks.studies import scaling
from benchmarks.suite.harness import commit_now, resumed, with_changes
from benchmarks.suite.plan import ABLATIONS
from blender_nep.asset.export import TexturedMesh, write_exr, write_obj
from blender_nep.capture import PixelRays, load_capture
from blender_nep.errors import LearningError, Stopped
from blender_nep.geometry.mesh import Surface
from blender_nep.presets import preset
from blender_nep.tone_mapping import tone_map
from support.ball_stages import ball_surface
from support.own_process import in_blender
from support.paths import SUZANNE_SMALL
from support.rescaled_albedo import check_rescaled_albedo
from support.true_mesh import true_surface


def test_the_truth_scores_perfectly_and_a_copy_by_its_shift():
    capture = load_capture(SUZANNE_SMALL)
    test = load_test_views(SUZANNE_SMALL, capture)
    mesh = trimesh.load(SUZANNE_SMALL / "gt_mesh.ply", process=False, force="mesh")
    mesh.apply_transform(capture.to_unit)
    vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces)
    same = score(Surface(vertices, faces, np.zeros_like(vertices)), SUZANNE_SMALL, capture, test)
    assert same["cd_visible"] < 1e-6 and same["cd_full"] < 1e-6 and same["normal_deg"] < 1e-3
    assert same["mask_iou"] == 1 and same["fscore_005"] == 1
    turned = score(Surface(vertices, faces[:, ::-1], np.zeros_like(vertices)), SUZANNE_SMALL, capture, test)
    assert turned["seen_from_behind"] > 0.999 and same["seen_from_behind"] < 0.001, "it is inside out"
    assert turned["mask_iou"] == 1 and turned["cd_visible"] < 1e-6
    moved = score(Surface(vertices + np.array([0, 0, 0.02]), faces, np.zeros_like(vertices)), SUZANNE_SMALL, capture, test)
    assert 0.002 < moved["cd_visible"] < 0.02 and 0.8 < moved["mask_iou"] < 0.99


def test_distances_of_concentric_balls_are_differences_of_radii():
    small, large = (trimesh.creation.icosphere(subdivisions=4, radius=r) for r in (0.5, 0.6))
    distance = Body(large.vertices, large.faces).distance(np.asarray(small.vertices))
    assert distance == pytest.approx(0.1, abs=2e-3)


@pytest.mark.parametrize("depth", [0.3, 0.6, 1.0])
def test_a_round_hollow_sees_the_sky_as_places_of_a_sphere_do(depth):
    # A point of a sphere sees each part of it with a share that is that part's share of the whole area.
    ball = trimesh.creation.icosphere(subdivisions=6)
    bowl = ball.submesh([ball.triangles_center[:, 2] < depth - 1], append=True)
    deepest = np.asarray(bowl.triangles_center)
    deepest = deepest[deepest[:, 2] < 0.5 * depth - 1][::7]
    found = Body(bowl.vertices, bowl.faces).sky_visibility(
        deepest, -deepest / np.linalg.norm(deepest, axis=1, keepdims=True)
    )
    assert found.mean() == pytest.approx(1 - depth / 2, abs=0.01)
    assert found == pytest.approx(np.full(len(found), 1 - depth / 2), abs=0.08)


def test_a_silhouette_has_no_inner_pixels_at_the_border():
    mask = np.ones((5, 6), bool)
    mask[2, 3] = False
    expected = np.zeros_like(mask)
    expected[1:4, 1] = expected[1, 2] = expected[3, 2] = expected[1, 4] = expected[3, 4] = True
    expected[1, 3] = expected[3, 3] = expected[2, 2] = expected[2, 4] = False
    assert (inner(mask) == expected).all()


def test_normals_that_are_wrong_only_in_hollows_are_scored_there(monkeypatch):
    capture = load_capture(SUZANNE_SMALL)
    test = load_test_views(SUZANNE_SMALL, capture)
    surface = true_surface()
    sky = Body(surface.vertices, surface.faces).sky_visibility(surface.vertices, surface.normals)
    turned = np.cross(surface.normals, [0.6, 0.0, 0.8])
    wrong = np.where((sky < shading_normals.HOLLOW)[:, None], turned, surface.normals)
    right, tilted = (
        shading_normals.score(replace(surface, normals=normals), SUZANNE_SMALL, capture, test)
        for normals in (surface.normals, wrong)
    )
    assert right["hollow_normal_deg"] < 5 and tilted["hollow_normal_deg"] > 50
    assert tilted["shading_normal_deg"] < right["shading_normal_deg"] + 0.2 * tilted["hollow_normal_deg"]
    monkeypatch.setattr(shading_normals, "HOLLOW", 0.0)
    assert "hollow_normal_deg" not in shading_normals.score(surface, SUZANNE_SMALL, capture, test)


def test_an_ablation_changes_the_fields_it_names_and_no_others():
    for ablation, changes in ABLATIONS.items():
        expected, found = asdict(preset("balanced")), asdict(with_changes(preset("balanced"), changes))
        for part, values in changes.items():
            at = expected if part == "preset" else expected[part]
            assert set(values) <= set(at), ablation
            at |= values
        assert found == expected, ablation


def test_a_failed_run_is_a_row_and_a_done_one_is_not_run_again(tmp_path):
    def fail():
        raise LearningError("no surface was found", "look again")

    def stop():
        raise Stopped("SIGTERM")

    start = {"capture": "a"} | {"commit": commit_now(), "date": datetime.now().date().isoformat()}
    assert resumed(tmp_path / "failed.json", {"capture": "a"}, fail) == start | {"error": "no surface was found"}
    assert resumed(tmp_path / "crashed.json", start, lambda: 1 / 0)["error"] == "ZeroDivisionError: division by zero"
    assert resumed(tmp_path / "done.json", start, lambda: {"seconds": 1.0}) == start | {"seconds": 1.0}
    measured = {"levels": (1, 2), "error": float("nan"), 3: "c"}  # what JSON changes
    assert resumed(tmp_path / "more.json", start | {"sizes": (4, 5)}, lambda: measured)["levels"] == [1, 2]
    assert resumed(tmp_path / "done.json", start, fail)["seconds"] == 1.0
    with pytest.raises(SystemExit, match="something else"):
        resumed(tmp_path / "done.json", start | {"photos": "others"}, fail)
    with pytest.raises(Stopped):
        resumed(tmp_path / "stopped.json", start, stop)
    assert not (tmp_path / "stopped.json").exists()


@pytest.mark.slow
def test_the_truth_scores_perfectly_except_for_a_planted_error(tmp_path, monkeypatch):
    gold = {
        name: read_channels(SUZANNE_SMALL / "gt" / "000.exr")[channel]
        for name, channel in (
            ("albedo", "albedo"),
            ("roughness", "roughness.V"),
            ("metallic", "metallic.V"),
            ("confidence", "mask.V"),
        )
    }
    inside = gold["confidence"] > 0.99
    asset, picture = tmp_path / "asset", tmp_path / "materials.png"
    (asset / "textures").mkdir(parents=True)
    for name, wrong in (("albedo", 0.0), ("roughness", 0.1), ("metallic", 0.0), ("confidence", 0.0)):
        value = gold[name][inside][0, :3] if name == "albedo" else gold[name][inside][0]
        assert gold[name][inside].std(0).max() < 0.01  # one material
        write_exr(asset / "textures" / f"{name}.exr", np.full((8, 8, *np.shape(value)), value, np.float32) + wrong)
    capture = load_capture(SUZANNE_SMALL)
    surface = true_surface()
    vertices = surface.vertices * capture.object_radius + capture.object_center
    write_obj(asset / "mesh.obj", TexturedMesh(vertices, surface.faces, surface.normals, surface.uv, {}))
    found = score_asset(SUZANNE_SMALL, asset, preset("preview"), "cpu", picture)
    assert found["cd_visible"] < 1e-5 and found["mask_iou"] > 0.999 and found["texture_rows"] == 8
    # the photos show interpolated normals, the true mesh has flat faces
    assert found["shading_normal_deg"] < 0.5 * found["normal_floor_deg"] and found["normal_floor_deg"] > 1
    assert found["mse_albedo"] < 1e-5 and found["mse_metallic"] < 1e-5
    assert found["albedo_ratio"] == pytest.approx([1, 1, 1], abs=0.01)
    assert found["mse_roughness"] == pytest.approx(0.01, rel=0.01) and found["true_roughness_deviation"] < 1e-3
    assert picture.is_file() and "background_psnr" not in found
    assert score_asset(tmp_path, asset, preset("preview"), "cpu", picture) == {}
    inside_out = TexturedMesh(vertices, surface.faces[:, ::-1], -surface.normals, surface.uv, {})
    write_obj(asset / "mesh.obj", inside_out)
    assert score_asset(SUZANNE_SMALL, asset, preset("preview"), "cpu", picture)["seen_from_behind"] > 0.999


def test_rendered_truth_has_a_name_of_scene_cameras_and_settings(tmp_path, monkeypatch):
    pytest.importorskip("bpy")
    from benchmarks.scoring import relighting

    rendered = []

    def render(item, frames, *_):
        rendered.append(item)
        return np.full((1, 1, 2, 2, 3), len(rendered), np.float32)

    monkeypatch.setattr(relighting, "render", render)
    monkeypatch.setattr(relighting, "true_object", lambda blend: blend.read_text())
    (tmp_path / "scene.blend").write_text("gold")
    (tmp_path / "transforms_test.json").write_text("{}")

    def truth() -> float:
        kept = tmp_path / "truth" / "gold_0.05.npz"
        return relighting.rendered_truth(tmp_path, [], [], (2, 2), 1, kept).max()

    assert truth() == truth() == 1
    (tmp_path / "scene.blend").write_text("blue")
    assert truth() == 2 and rendered == ["gold", "blue"]
    (tmp_path / "transforms_test.json").write_text("{} ")
    assert truth() == 3
    monkeypatch.setattr(relighting, "SAMPLES", 8)
    assert truth() == 4
    assert all(file.name.startswith("gold_0.05-") for file in (tmp_path / "truth").iterdir())


def test_f_e_is_scored_without_the_exposure_of_each_test_photo():
    """A field of one radiance, test photos that show it with known gains, and a little more light in one pixel of ten."""
    capture = load_capture(SUZANNE_SMALL)
    rays = PixelRays.from_capture(load_test_views(SUZANNE_SMALL, capture), 900, False).with_exposure(2.0)
    truth = true_mesh(SUZANNE_SMALL, capture)
    color = torch.tensor([0.2, 0.3, 0.1])
    constant = SimpleNamespace(
        preset=SimpleNamespace(camera_near=0.1),
        render=lambda origins, *_: SimpleNamespace(radiance=2.0 * color.expand(len(origins), 3)),
    )
    view = rays.view_of(torch.arange(rays.count))
    gains = torch.linspace(0.7, 1.4, rays.views)[view, None]
    brighter = torch.where(torch.arange(rays.count) % 10 == 0, 1.2, 1.0)[:, None]
    exact, plain, exposed = (
        replace(rays, radiance=color * factor) for factor in (gains * torch.ones(1), brighter, gains * brighter)
    )
    assert background_psnr(constant, exact, truth, True) > 80
    without = background_psnr(constant, plain, truth)
    assert background_psnr(constant, plain, truth, True) == without, "a gain of 1 changes nothing"
    assert background_psnr(constant, exposed, truth, True) == pytest.approx(without, abs=1.0)
    assert background_psnr(constant, exposed, truth) < without - 5
    error = tone_map(1.2 * color) - tone_map(color)
    assert without == pytest.approx(float(-10 * torch.log10(0.1 * error.square().mean())), abs=0.2)


def test_only_automatic_exposure_gives_differing_test_photos(tmp_path):
    assert not exposures_differ(SUZANNE_SMALL)
    for auto in (False, True):
        write_row(tmp_path / "scene.json", draw_scene_with(auto_exposure=auto))
        assert exposures_differ(tmp_path) == auto


def draw_scene_with(auto_exposure: bool) -> dict:
    """The scene.json of the first random scene whose photos are exposed so."""
    scenes = (draw_scene(seed) for seed in range(100))
    return next(scene.as_json() for scene in scenes if scene.photography.auto_exposure == auto_exposure)


def test_a_tenth_of_difference_has_a_psnr_of_20_over_the_object():
    pytest.importorskip("bpy")
    from benchmarks.scoring.relighting import agreement, exposed

    rng = np.random.default_rng(0)
    true = rng.random((2, 1, 32, 32, 3)).astype(np.float32) * 0.5
    inside = np.zeros((2, 32, 32), bool)
    inside[:, 8:24, 8:24] = True
    beside = true + ~inside[:, None, :, :, None] * 0.3  # what does not belong to the object does not count
    pairs, inner = [[(a[0], b[0])] for a, b in zip(true, beside, strict=True)], np.zeros_like(inside)
    inner[:, 11:21, 11:21] = True  # the windows of SSIM are 7 pixels wide
    assert agreement(pairs, inside)[0] == [pytest.approx(120)] and agreement(pairs, inner)[1] == [pytest.approx(1)]
    psnr, ssim = agreement([[(a[0], a[0] + np.float32(0.1))] for a in true], inside)
    assert psnr == [pytest.approx(20, abs=1e-3)] and 0.5 < ssim[0] < 1
    bright, other = exposed(true[0, 0] * 50, true[0, 0] * 50, inside[0])
    dark, _ = exposed(true[0, 0], true[0, 0], inside[0])
    assert bright == pytest.approx(dark, abs=1e-5) and (bright == other).all()


def test_an_exponent_is_that_of_the_power_law_or_nan():
    values = [5, 10, 20, 40]
    assert scaling.exponent(values, [3e-2 * v**1.5 for v in values]) == pytest.approx(1.5)
    assert np.isnan(scaling.exponent(values, [0.0, 1e-5, 1.0, 2.0]))
    rows = [{"factor": "views", "value": v, "cpu_seconds": {"decode": 0.01 * v}, "peak_mb": 500.0} for v in (20, 5, 10)]
    rows.append({"factor": "views", "value": 40, "error": "no memory"})
    assert scaling.curves(rows) == [
        ("views", "decode", [5, 10, 20], [0.05, 0.1, 0.2]),
        ("views", "peak memory, MB", [5, 10, 20], [500.0] * 3),
    ]
    assert "| views | decode | 5, 10, 20 | 0.05, 0.1, 0.2 | 1.00 |" in scaling.table(rows)


def test_every_value_of_a_varied_size_changes_the_measured_work():
    class Recorder:
        def __getattr__(self, kind):
            return lambda *arguments, **keywords: (kind, arguments, tuple(keywords.items()))

    for values, work, stages in scaling.FACTORS.values():
        assert len({work(Recorder(), value) for value in values}) == len(values) and stages


def test_textures_of_random_points_can_be_measured():
    """The points that the study makes up are those that the baking takes."""
    bench = scaling.Bench(SUZANNE_SMALL)
    bench.learned = lambda: (None, ball_surface())
    measured = scaling.measure(bench, 64, *scaling.FACTORS["texels a side"][1:])
    assert measured["cpu_seconds"]["textures"] > 0


def test_a_rescaled_albedo_scales_what_a_metal_reflects():
    """A metal that faces the camera under a gray light reflects its albedo times the light."""
    pytest.importorskip("bpy")
    in_blender(check_rescaled_albedo)


def test_a_map_of_the_light_is_compared_by_solid_angle():
    light = np.random.default_rng(0).uniform(0, 1, (64, 128, 3)).astype(np.float32)
    same = light_map.compare(light, light)
    assert same["light_psnr"] > 100 and same["light_correlation"] == pytest.approx(1)
    gray = np.full((64, 128, 3), 0.5, np.float32)
    off = np.log(1 + 4 * 0.5) / np.log(5) - np.log(1 + 4 * 0.25) / np.log(5)
    found = light_map.compare(gray, 0.5 * gray)
    assert found["light_psnr"] == pytest.approx(-20 * np.log10(off), abs=1e-3)
    assert found["light_ratio"] == pytest.approx([2, 2, 2], abs=1e-5)
    upper, ring = gray.copy(), gray.copy()
    upper[:32] *= 0.5  # half of all directions
    ring[28:36] *= 0.5  # a share of sin(pi / 16) of all directions
    for changed, share in ((upper, 0.5), (ring, np.sin(np.pi / 16))):
        expected = -10 * np.log10(share * off**2)
        assert light_map.compare(gray, changed)["light_psnr"] == pytest.approx(expected, abs=0.01)
    with pytest.raises(ValueError, match="60 x 120"):
        light_map.coarse(np.zeros((60, 120, 3)))


def test_light_is_scored_only_in_the_room_of_the_first_photo(tmp_path):
    asset = tmp_path / "asset"
    asset.mkdir()
    assert light_map.score(tmp_path, asset) == {}, "the capture has no true light"
    light = np.full((32, 64, 3), 0.5, np.float32)
    write_exr(tmp_path / "light.exr", light)
    write_exr(asset / "environment.exr", light)
    write_row(tmp_path / "transforms.json", {"frames": [{"file_path": "images/000.exr"}, {"file_path": "images/001.exr"}]})
    write_row(asset / "cameras.json", {"frames": [{"file_path": "../images/000.exr"}]})
    assert light_map.score(tmp_path, asset)["light_psnr"] > 100
    write_row(asset / "cameras.json", {"frames": [{"file_path": "../images/001.exr"}]})
    assert light_map.score(tmp_path, asset) == {}, "the object stood otherwise"
