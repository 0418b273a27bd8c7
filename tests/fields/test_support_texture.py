"""The colors of the support plane in the object's sphere are found, and the object is not taken for the plane."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from blender_nep.capture import PixelRays, load_capture
from blender_nep.capture.rays.ray_bundle import RayBundle
from blender_nep.fields.refinements import carve as carve_again
from blender_nep.fields.training import FieldsLearning
from blender_nep.fields.visual_hull import background_silhouettes, carve, score_cells
from blender_nep.presets import PRESETS
from blender_nep.scene.scene import Scene
from blender_nep.support.agreed_colors import AgreedColors
from blender_nep.support.plane import Support
from blender_nep.support.texture import PlaneTexture
from support.table_scene import BALL, CENTER, HEIGHT, pattern, shadow, write_table_scene

PLANE = Support(np.array([0.0, 0.0, 1.0]), HEIGHT)
AXIS = (np.arange(64) + 0.5) / 64 * 2 - 1
CELLS = np.stack(np.meshgrid(AXIS, AXIS, AXIS, indexing="ij"), -1)
BALL_SDF = (np.linalg.norm(CELLS - CENTER, axis=-1) - BALL).astype(np.float32)


@pytest.fixture(params=["patterned", "plain"])
def table(request, tmp_path):
    """The pixels of a ball on a table, and the table's true colors."""
    plain = request.param == "plain"
    folder = write_table_scene(tmp_path / "capture", plain=plain)
    return PixelRays.from_capture(load_capture(folder), 10_000, False, torch.device("cpu")), shadow if plain else pattern


def texels(texture: PlaneTexture) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points [n, 3], colors [n, 3] and whether they are known [n], of all texels."""
    axis = (np.arange(len(texture.known)) + 0.5) / len(texture.known) * 2 - 1
    across, along = PLANE.axes()
    points = axis[:, None, None] * across + axis[None, :, None] * along + HEIGHT * PLANE.normal
    return points.reshape(-1, 3), texture.color.reshape(-1, 3).numpy(), texture.known.flatten().numpy()


def test_known_colors_are_the_tables_and_not_the_balls(table):
    rays, true = table
    points, color, known = texels(AgreedColors(rays, PLANE).texture(BALL_SDF))
    beside = np.hypot(*(points - CENTER)[:, :2].T) > BALL
    in_sphere = np.linalg.norm(points, axis=1) < 0.97
    assert known[beside & in_sphere].mean() > 0.95
    assert not known[np.linalg.norm(points, axis=1) > 1].any()
    wrong = np.abs(color - true(points)).mean(1)
    # where the ball hides the foot from all photos, it has a color that the patterned table has elsewhere
    assert np.median(wrong[known]) < 0.01 and (wrong[known] > 0.05).mean() < 0.05


def test_colors_are_known_where_exposures_differ(tmp_path):
    """A shadow, noise, or exposures that are not known exactly: the table beside the ball tells how much photos differ."""
    folder = write_table_scene(tmp_path / "capture")
    rays = PixelRays.from_capture(load_capture(folder), 10_000, False, torch.device("cpu"))
    random = torch.Generator().manual_seed(0)
    gain = (0.18 * torch.randn(rays.views, generator=random)).exp()
    noise = 1 + 0.1 * torch.randn(rays.radiance.shape, generator=random)
    rays = replace(rays, radiance=rays.radiance * gain[rays.view_of(torch.arange(rays.count))][:, None] * noise)
    points, color, known = texels(AgreedColors(rays, PLANE).texture(BALL_SDF))
    beside = (np.hypot(*(points - CENTER)[:, :2].T) > BALL) & (np.linalg.norm(points, axis=1) < 0.97)
    assert known[beside].mean() > 0.9
    assert np.median(np.abs(color - pattern(points)).mean(1)[known & beside]) < 0.04


def test_rays_that_meet_the_plane_in_the_sphere_show_the_colors(table):
    rays, true = table
    texture = AgreedColors(rays, PLANE).texture(BALL_SDF)
    points = np.array([[-0.6, 0.1, HEIGHT], [-0.3, -0.55, HEIGHT], [0.0, -1.5, HEIGHT]])
    origins = torch.tensor(points + np.array([-1.0, 0.5, 2.0]), dtype=torch.float32)
    directions = torch.nn.functional.normalize(torch.tensor(points, dtype=torch.float32) - origins, dim=-1)
    black = torch.zeros(3, 3)
    shown = texture.shown(RayBundle(origins, directions, torch.zeros(3)), black).numpy()
    np.testing.assert_allclose(shown[:2], true(points[:2]), atol=0.02)
    assert (shown[2] == 0).all(), "the plane outside the sphere belongs to F_e"
    upwards = RayBundle(origins, -directions, torch.zeros(3))
    assert (texture.shown(upwards, black) == 0).all()


@pytest.mark.parametrize("table", [pytest.param("patterned", marks=pytest.mark.slow), "plain"], indirect=True)
def test_the_hull_loses_its_mound_and_keeps_the_ball(table):
    """The background shows the table beside the sphere, and walls in its place in the sphere, as F_e does."""
    rays, true = table

    def walls(bundle: RayBundle) -> torch.Tensor:
        origins, directions = bundle.origins.numpy(), bundle.directions.numpy()
        color = 0.3 + 0.2 * np.sin(3 * directions)
        points = origins + ((HEIGHT - origins[:, 2:]) / np.minimum(directions[:, 2:], -1e-6)) * directions
        beside = (directions[:, 2] < 0) & (np.linalg.norm(points, axis=1) > 1)
        color[beside] = true(points[beside])
        return torch.from_numpy(color.astype(np.float32))

    above, ball = PLANE.distance(CELLS) > 0, BALL_SDF < 0
    colors, sdf, overlap = AgreedColors(rays, PLANE), None, []
    for _ in range(9):
        background = walls if sdf is None else colors.texture(sdf).before(walls)
        hull = carve(score_cells(rays, background_silhouettes(background, rays), 64))
        sdf = hull.sdf
        found = (sdf < 0) & above
        overlap.append((found & ball).sum() / (found | ball).sum())
    assert overlap[0] < 0.5 and overlap[-1] > 0.7, overlap
    assert (sdf[BALL_SDF < -0.05] < 0).mean() > 0.99


def test_the_object_is_carved_again_with_the_colors_of_the_table(table, monkeypatch):
    """Without them, the background is that of an F_e and of color heads that have learned nothing."""
    rays, true = table
    learning, asked = FieldsLearning(Scene.of(rays), PRESETS["preview"], 0), []

    def nothing(background, rays, wanted):
        asked.append(background)
        return [torch.zeros(size) for size in rays.size]

    monkeypatch.setattr(carve_again, "background_silhouettes", nothing)
    learning.stand_on(PLANE)
    learning.object_field.start_from(torch.from_numpy(BALL_SDF))
    assert not carve_again.Carving((0.5,)).apply(learning).acted, "nothing is explained"
    index = torch.arange(rays.count)
    bundle = rays.rays(index)
    points = bundle.origins + ((HEIGHT - bundle.origins[:, 2:]) / bundle.directions[:, 2:]) * bundle.directions
    beside = (points[:, :2] - torch.tensor(CENTER[:2])).norm(dim=-1) > BALL + 0.1
    seen = (bundle.directions[:, 2] < 0) & (points.norm(dim=-1) < 0.9) & beside
    shown = asked[0](bundle[seen]).numpy()
    assert np.quantile(np.abs(shown - true(points[seen].numpy())), 0.95) < 0.05


def test_nothing_is_known_if_photos_show_the_object_alone(tmp_path):
    """A table as small as the foot: beside it are the walls, far below the plane."""
    folder = write_table_scene(tmp_path / "capture", radius=0.2)
    rays = PixelRays.from_capture(load_capture(folder), 10_000, False, torch.device("cpu"))
    assert float(AgreedColors(rays, PLANE).texture(BALL_SDF).known.float().mean()) < 0.02
