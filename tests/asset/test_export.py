"""The asset folder. Every file is read by another library, or another function, than the one that wrote it."""

from __future__ import annotations

import json

import numpy as np
import OpenEXR
import pytest
import torch
import trimesh
from PIL import Image

from blender_nep.asset import export as asset
from blender_nep.asset import preview
from blender_nep.asset.preview import PreviewView, Pyramid, shade
from blender_nep.capture import PixelRays, load_capture
from blender_nep.capture.rays.rigid_motions import RigidMotions
from blender_nep.color import srgb_to_linear
from blender_nep.errors import OutputError
from blender_nep.job.stages import AssetInput, AssetStage, SurfaceResult, SurfaceStage
from blender_nep.scene.scene import Scene
from blender_nep.surface.normal_map import LeanMesh
from support.ball_stages import GrayLight, ball_surface, ball_textures
from support.captures import CENTER, RADIUS


class Textures:
    """Takes the place of Materials."""

    def __init__(self):
        self.__dict__.update(ball_textures())


@pytest.fixture
def write(make_capture, tmp_path):
    """write(light) writes the ball's asset, at `center` where that is given, and returns its folder."""
    capture = load_capture(make_capture(masks=True).folder)
    seen = PixelRays.from_capture(capture, 10**6, use_masks=True)
    folder = tmp_path / "asset"
    folder.mkdir()

    def run(light=None, report=lambda: {"seed": 3}, center=CENTER, exposure=1.0, lean=None):
        scene = Scene.of(seen.with_exposure(exposure))
        surface, radiance = ball_surface(), light if light is not None else GrayLight().equirect(16)[0].numpy()
        view = PreviewView.best(scene.rays, surface)
        place = asset.Placement(np.asarray(center), capture.object_radius)
        shape = SurfaceResult(surface, lean=lean)
        AssetStage().run(AssetInput(folder, scene, capture, place, shape, Textures(), radiance, view, report))
        return folder

    return run


def test_the_folder_holds_what_the_format_names(write):
    folder = write()
    found = {str(p.relative_to(folder)) for p in folder.rglob("*") if p.is_file()}
    textures = {f"textures/{n}.{s}" for n in ("albedo", "roughness", "metallic", "confidence") for s in ("exr", "png")}
    others = {"mesh.obj", "mesh.mtl", "asset.glb", "environment.exr", "preview.png", "cameras.json", "report.json"}
    assert found == textures | others
    assert json.loads((folder / "report.json").read_text()) == {"seed": 3}


def lean_ball():
    """A ball of 20 faces, with a normal map that holds the same tilt everywhere."""
    few = ball_surface(0)
    return LeanMesh(few, np.full((16, 16, 3), (0.75, 0.25, 0.9), np.float32))


def test_a_lean_mesh_brings_its_normal_map(write):
    folder = write(lean=lean_ball())
    mesh = trimesh.load(folder / "mesh.obj", process=False, maintain_order=True, force="mesh")
    assert len(mesh.faces) == 20
    assert "norm textures/normal.png" in (folder / "mesh.mtl").read_text().splitlines()
    linear = OpenEXR.File(str(folder / "textures/normal.exr")).channels()["RGB"].pixels
    np.testing.assert_allclose(linear, np.broadcast_to((0.75, 0.25, 0.9), (16, 16, 3)), atol=1e-3)
    eight_bit = np.asarray(Image.open(folder / "textures/normal.png"))
    np.testing.assert_array_equal(eight_bit[3, 4], (191, 64, 230))  # linear, not sRGB-encoded
    material = next(iter(trimesh.load(folder / "asset.glb").geometry.values())).visual.material
    np.testing.assert_array_equal(np.asarray(material.normalTexture)[3, 4], (191, 64, 230))
    write()
    assert not list((folder / "textures").glob("normal.*")), "the map of the lean mesh does not fit another mesh"
    assert "norm " not in (folder / "mesh.mtl").read_text()
    assert next(iter(trimesh.load(folder / "asset.glb").geometry.values())).visual.material.normalTexture is None


def test_a_lean_mesh_is_kept_on_the_disk_with_its_map():
    before = SurfaceResult(ball_surface(), {"faces": 320}, lean_ball())
    after = SurfaceStage().unpack(SurfaceStage().pack(before), None)
    np.testing.assert_array_equal(after.of_asset.faces, before.lean.surface.faces)
    np.testing.assert_array_equal(after.textures["normal"], before.lean.normal_map)
    alone = SurfaceStage().unpack(SurfaceStage().pack(SurfaceResult(ball_surface())), None)
    assert alone.lean is None and alone.of_asset is alone.surface and alone.textures == {}


def test_obj_is_the_surface_in_capture_coordinates(write):
    path = write() / "mesh.obj"
    mesh = trimesh.load(path, process=False, maintain_order=True, force="mesh")
    surface = ball_surface()
    np.testing.assert_allclose(mesh.vertices, surface.vertices * RADIUS + CENTER, atol=1e-6)
    np.testing.assert_array_equal(mesh.faces, surface.faces)
    np.testing.assert_allclose(mesh.visual.uv, surface.uv, atol=1e-6)
    normals = [line.split()[1:] for line in path.read_text().splitlines() if line.startswith("vn ")]
    np.testing.assert_allclose(np.array(normals, float), surface.normals, atol=1e-4)
    assert mesh.volume > 0


def test_textures_are_half_float_and_upright_and_8_bit_in_png(write):
    folder = write()
    truth = ball_textures()
    albedo = OpenEXR.File(str(folder / "textures/albedo.exr")).channels()["RGB"].pixels
    assert albedo.dtype == np.float16
    np.testing.assert_allclose(albedo, truth["albedo"], atol=5e-4)
    rough = OpenEXR.File(str(folder / "textures/roughness.exr")).channels()
    assert list(rough) == ["V"]
    np.testing.assert_allclose(rough["V"].pixels, truth["roughness"], atol=5e-4)
    linear = np.asarray(Image.open(folder / "textures/roughness.png")) / 255
    np.testing.assert_allclose(linear, truth["roughness"], atol=0.5 / 255 + 1e-6)
    encoded = np.asarray(Image.open(folder / "textures/albedo.png")) / 255
    assert encoded[0, 0, 2] == pytest.approx(1.055 * 0.25 ** (1 / 2.4) - 0.055, abs=0.5 / 255)


@pytest.mark.parametrize("unit", [1.0, 1e6, 1e-7, 1e-8])
def test_light_in_any_unit_keeps_its_energy(tmp_path, unit):
    """A lamp above the range of half floats would be clipped, and tiny values would become steps, or zero."""
    light = np.random.default_rng(0).uniform(0, 1, (8, 16, 3)).astype(np.float32) * np.float32(unit)
    light[2, 3] = 50 * unit
    asset.write_exr(tmp_path / "light.exr", light)
    stored = OpenEXR.File(str(tmp_path / "light.exr")).channels()["RGB"].pixels
    np.testing.assert_allclose(stored.astype(np.float64).sum(), light.astype(np.float64).sum(), rtol=1e-3)
    np.testing.assert_allclose(stored, light, rtol=1e-3, atol=1e-3 * unit)
    assert stored.dtype == (np.float16 if unit == 1 else np.float32), "half floats where they are enough"


def test_glb_is_y_up_with_packed_textures(write):
    scene = trimesh.load(write() / "asset.glb", process=False)
    mesh = next(iter(scene.geometry.values()))
    (node,) = scene.graph.nodes_geometry
    surface = ball_surface()
    world = surface.vertices * RADIUS + CENTER
    placed = trimesh.transform_points(mesh.vertices, scene.graph[node][0])
    np.testing.assert_allclose(placed, world[:, [0, 2, 1]] * [1, 1, -1], atol=1e-5)
    np.testing.assert_allclose(mesh.vertex_normals, surface.normals[:, [0, 2, 1]] * [1, 1, -1], atol=1e-3)
    assert mesh.volume > 0  # right-handed still
    packed = np.asarray(mesh.visual.material.metallicRoughnessTexture)
    truth = ball_textures()
    np.testing.assert_allclose(packed[..., 1] / 255, truth["roughness"], atol=2 / 255)
    np.testing.assert_allclose(packed[..., 2] / 255, truth["metallic"], atol=2 / 255)


def test_far_from_the_origin_the_mesh_keeps_its_shape(write):
    """A million radii away float32 and seven digits would leave steps of 0.06 radii."""
    far = np.array([1e6, -5e5, 2.5e5])
    folder = write(center=far)
    surface = ball_surface()
    lines = [line.split() for line in (folder / "mesh.obj").read_text().splitlines() if line.startswith("v ")]
    vertices = np.array(lines)[:, 1:].astype(np.float64)
    np.testing.assert_allclose((vertices - far) / RADIUS, surface.vertices, atol=2e-7)
    scene = trimesh.load(folder / "asset.glb", process=False)
    (node,) = scene.graph.nodes_geometry
    placed = trimesh.transform_points(next(iter(scene.geometry.values())).vertices, scene.graph[node][0])
    unit = (placed @ np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]).T - far) / RADIUS
    np.testing.assert_allclose(unit, surface.vertices, atol=2e-7)


def test_a_failed_write_leaves_no_report(write):
    folder = write()

    def report():
        raise OSError(28, "No space left on device")

    with pytest.raises(OutputError, match="disk is full"):
        write(report=report)
    assert (folder / "report.json").exists()  # nothing was replaced yet: the old asset is whole
    assert not (folder / ".partial").exists()


def test_the_report_is_removed_first_and_put_in_place_last(write, monkeypatch):
    folder = write()
    moved, fail_at = [], None
    replace = asset.os.replace

    def watch(source, target):
        assert not (folder / "report.json").exists()
        moved.append(str(target.relative_to(folder)))
        if len(moved) == fail_at:
            raise PermissionError(13, "Permission denied")
        replace(source, target)

    monkeypatch.setattr(asset.os, "replace", watch)
    write()
    assert moved[-1] == "report.json" and len(moved) == len({p for p in folder.rglob("*") if p.is_file()})
    moved, fail_at = [], 4
    with pytest.raises(OutputError, match="Permission denied"):
        write()
    assert len(moved) == 4 and not (folder / "report.json").exists()


def test_preview_shows_a_photo_beside_the_same_view_of_the_asset(write, tmp_path):
    """The photos show a gray ball before a background that changes. The asset has a colored ball in gray light."""
    picture = np.asarray(Image.open(write() / "preview.png"), np.float64)
    assert picture.shape == (24, 48, 3)
    photo, view = picture[:, :24], picture[:, 24:]
    ball = np.asarray(Image.open(tmp_path / "capture" / "masks" / "000.png")) > 127  # the same in all photos
    assert ((photo.std(-1) < 1) == ball).mean() > 0.97, "the photo's ball is gray, and its background is not"
    light = np.median(view[~ball], axis=0)
    assert np.ptp(light) < 1, "the gray light is seen beside the asset"
    assert ((np.abs(view - light).max(-1) > 3) == ball).mean() > 0.95, "the asset stands where the photo shows the ball"


def test_a_pixel_of_the_preview_is_the_mean_of_what_it_shows(monkeypatch):
    """The other way to it: a picture of twice as many pixels and one ray each, of which four become one."""

    def render(side, rays_across):
        monkeypatch.setattr(preview, "RAYS_ACROSS", rays_across)
        y, x = ((np.mgrid[:side, :side] + 0.5) / side - 0.5) * 0.8
        directions = np.stack([x, -y, -np.ones_like(x)], -1)
        directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
        view = PreviewView(np.full((side, side, 3), 0.8, np.float32), np.array([0, 0, 2.0]), directions.reshape(-1, 3))
        light = np.random.default_rng(0).uniform(0.1, 0.8, (8, 16, 3)).astype(np.float32)
        return srgb_to_linear(view.render(ball_surface(), ball_textures(), light)[:, side:] / 255.0)

    coarse, fine, one_ray = render(24, 2), render(48, 1), render(24, 1)
    means = fine.reshape(24, 2, 24, 2, 3).mean((1, 3))
    np.testing.assert_allclose(coarse, means, atol=0.01)
    assert np.abs(one_ray - means).max() > 0.1, "at the outline, one ray is not the mean"


def test_a_preview_may_have_one_row_of_pixels():
    directions = np.array([[x, 0, -2.0] for x in (-1.5, 0, 1.5)])
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    view = PreviewView(np.full((1, 3, 3), 0.8, np.float32), np.array([0, 0, 2.0]), directions)
    picture = view.render(ball_surface(), ball_textures(), np.full((8, 16, 3), 0.4, np.float32))
    assert picture.shape == (1, 6, 3)
    np.testing.assert_array_equal(picture[0, 3], picture[0, 5])
    assert (picture[0, 4] != picture[0, 3]).any(), "the ball stands in the middle"


def test_the_preview_of_a_turned_object_has_the_still_light():
    """The other way to it: the object stands still, and the light map is turned back by the same quarter."""
    y, x = ((np.mgrid[:24, :24] + 0.5) / 24 - 0.5) * 1.6
    directions = np.stack([-np.ones_like(x), x, -y], -1)
    directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
    photo, origin = np.full((24, 24, 3), 0.8, np.float32), np.array([2.0, 0, 0])
    light = np.random.default_rng(0).uniform(0.1, 0.8, (8, 16, 3)).astype(np.float32)
    quarter = np.array([[0, -1.0, 0], [1, 0, 0], [0, 0, 1]])  # to the left, which are 4 of the map's 16 columns

    def render(light, to_room=None):
        view = PreviewView(photo, origin, directions.reshape(-1, 3), to_room=to_room)
        view.check()
        return view.render(ball_surface(), ball_textures(), light).astype(int)

    turned = render(light, quarter)
    assert np.abs(turned - render(np.roll(light, 4, axis=1))).max() <= 1
    assert np.abs(turned - render(light))[:, 24:].mean() > 5, "the test would see a light that turns with the object"


def test_the_view_of_the_preview_knows_how_the_object_stood(make_capture):
    rays = PixelRays.from_capture(load_capture(make_capture(masks=True).folder), 10**6, use_masks=True)
    assert PreviewView.best(rays, ball_surface()).to_room is None
    turns = torch.stack([(n + 1.0) * torch.eye(3) for n in range(rays.views)])
    view = PreviewView.best(rays.with_turntable(RigidMotions(turns, torch.zeros(rays.views, 3))), ball_surface())
    shown = next(n for n in range(rays.views) if np.array_equal(rays.camera(n)[0].numpy(), view.origin))
    np.testing.assert_array_equal(view.to_room, turns[shown].numpy())


def test_preview_light_of_one_color_shades_in_closed_form():
    """In uniform light L a white diffuse surface sends back L, a perfect mirror L too (Fresnel 1)."""
    light = Pyramid.of(np.full((64, 128, 3), 2.0))
    normal = np.array([[0, 0, 1.0], [0.6, 0, 0.8]])
    np.testing.assert_allclose(light.irradiance(normal), 2 * np.pi, rtol=0.02)
    np.testing.assert_allclose(light.lookup(normal, np.array([0.1, 0.8])), 2.0, rtol=1e-5)
    mirror = {"albedo": np.ones((2, 3)), "roughness": np.full((2, 1), 0.02), "metallic": np.ones((2, 1))}
    np.testing.assert_allclose(shade(normal, normal, mirror, light), 2.0, rtol=0.02)


def test_preview_light_is_looked_up_as_in_blender():
    """Blender's equirectangular: the middle column is +x, a quarter to the left +y, the first row the zenith."""
    light = np.zeros((64, 128, 3), np.float32)
    light[31:33, 63:65] = (1, 0, 0)
    light[31:33, 31:33] = (0, 1, 0)
    light[:2] = (0, 0, 1)
    found = Pyramid.of(light).lookup(np.array([[1.0, 0, 0], [0, 1, 0], [0, 0, 1]]), np.zeros(3))
    np.testing.assert_allclose(found, np.eye(3), atol=1e-5)


def test_the_environment_map_is_as_bright_as_the_photos(write):
    """The method sees the photos four times as bright, so the light that it finds is four times too bright."""
    folder = write(light=np.full((16, 32, 3), 2.0, np.float32), exposure=4.0)
    np.testing.assert_array_equal(OpenEXR.File(str(folder / "environment.exr")).channels()["RGB"].pixels, 0.5)
