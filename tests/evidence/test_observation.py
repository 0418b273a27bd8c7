"""Which photos show a point, at what cosine and in what color: balls, for which all of it has a closed form."""

from dataclasses import replace

import numpy as np
import pytest
import torch
import trimesh

from blender_nep.capture import PixelRays, load_capture
from blender_nep.evidence.full_photos import FullPhotos, Sampling
from blender_nep.evidence.observation import chosen_views, colors_of, observe, visible
from blender_nep.evidence.occluders import MeshOccluder, SdfOccluder
from blender_nep.evidence.sdf_grid import SdfGrid
from blender_nep.evidence.small_photos import SmallPhotos
from blender_nep.geometry.ray_tracing import RayTracer
from blender_nep.tone_mapping import tone_map
from support.paths import SUZANNE_SMALL

RADIUS = 0.5
OTHER, OTHER_RADIUS = torch.tensor([0.25, 0.3, 0.75]), 0.2
"""A second ball, which touches nothing"""


@pytest.fixture(scope="module")
def rays():
    """Photos whose red and green tell the place across and down the photo, 0..1, and whose blue tells the view."""
    rays = PixelRays.from_capture(load_capture(SUZANNE_SMALL), 10_000, False, torch.device("cpu"))
    photos = []
    for view, (height, width) in enumerate(rays.size):
        row, column = torch.meshgrid(torch.arange(height) + 0.5, torch.arange(width) + 0.5, indexing="ij")
        photos.append(torch.stack([column / width, row / height, torch.full_like(row, view / 100)], -1).reshape(-1, 3))
    return replace(rays, radiance=torch.cat(photos), exposure=1.0)


def points_on_ball(count=3000):
    """Points [n, 3] spread evenly over the ball, and its normals there."""
    normals = torch.nn.functional.normalize(torch.randn(count, 3, generator=torch.Generator().manual_seed(0)), dim=-1)
    return RADIUS * normals, normals


def expected_cosine(rays, view, points, normals):
    towards = rays.camera(view)[0] - points
    return (towards * normals).sum(-1) / towards.norm(dim=-1)


def distance_of_line(points, camera, center):
    """The distance [n] of a center [3] from the lines of sight from points [n, 3] to a camera [3]."""
    towards = torch.nn.functional.normalize(camera - points, dim=-1)
    along = ((center - points) * towards).sum(-1).clamp(min=0)
    return (points + along[:, None] * towards - center).norm(dim=-1)


@pytest.mark.parametrize("least", [0.0, 0.15, 0.6])
def test_a_photo_shows_what_faces_it_at_the_right_cosine(rays, least):
    points, normals = points_on_ball()
    for view in (0, rays.views - 1):
        seen = visible(rays, view, points, normals, least_cosine=least)
        expected = expected_cosine(rays, view, points, normals)
        assert torch.equal(seen.index, (expected > least).nonzero()[:, 0])
        torch.testing.assert_close(seen.cosine, expected[seen.index], rtol=0, atol=1e-6)
        camera = rays.camera(view)[0]
        torch.testing.assert_close(seen.towards, torch.nn.functional.normalize(camera - points[seen.index], dim=-1))
        assert torch.equal(seen.place, rays.project(view, points)[0][seen.index])


def test_both_sides_of_a_surface_count_where_that_is_asked(rays):
    points, normals = points_on_ball()
    one, other = (visible(rays, 0, points, side, least_cosine=0.2).index for side in (normals, -normals))
    both = visible(rays, 0, points, normals, least_cosine=0.2, two_sided=True).index
    assert torch.equal(both, torch.cat([one, other]).sort()[0]) and len(one) and len(other)


def test_without_normals_every_angle_counts(rays):
    points, _ = points_on_ball()
    seen = visible(rays, 0, points, least_cosine=0.9)
    assert torch.equal(seen.index, torch.arange(len(points))) and seen.cosine.isnan().all()


def test_a_lifted_point_is_looked_at_from_above_the_surface(rays):
    points, normals = points_on_ball()
    seen = visible(rays, 0, points, normals, lift=0.3)
    expected = expected_cosine(rays, 0, points + 0.3 * normals, normals)
    torch.testing.assert_close(seen.cosine, expected[seen.index], rtol=0, atol=1e-6)
    assert torch.equal(seen.place, rays.project(0, points)[0][seen.index]), "its color is that of the point itself"


def test_what_lies_beside_or_behind_the_camera_is_not_shown(rays):
    camera, rotation = rays.camera(0)
    beside = rays.rays(torch.tensor([0]))
    edge = beside.directions[0] - 0.05 * rotation[:, 0] + 0.05 * rotation[:, 1]  # to the left of the first pixel, and above
    points = torch.stack([torch.zeros(3), camera + 3 * edge, camera + rotation[:, 2], 2 * camera])
    assert visible(rays, 0, points).index.tolist() == [0]


def mesh_of_both_balls():
    balls = [trimesh.creation.icosphere(subdivisions=5, radius=radius) for radius in (RADIUS, OTHER_RADIUS)]
    balls[1].apply_translation(OTHER.numpy())
    whole = trimesh.util.concatenate(balls)
    return RayTracer(whole.vertices, whole.faces)


def grid_of(center, radius):
    """The SDF of a ball."""
    grid = SdfGrid(np.empty((128, 128, 128)))
    return SdfGrid((np.linalg.norm(grid.centers() - center.numpy(), axis=-1) - radius).astype(np.float32))


OCCLUDERS = {
    "mesh, rays begin above the surface": lambda: MeshOccluder(mesh_of_both_balls()),
    "mesh, rays begin on their way": lambda: MeshOccluder(mesh_of_both_balls(), ahead=0.02),
    "SDF": lambda: SdfOccluder(grid_of(OTHER, OTHER_RADIUS), level=0.0, first=0.02, last=1.5, steps=100),
}


@pytest.mark.parametrize("kind", OCCLUDERS)
def test_a_ball_hides_what_lies_behind_it(rays, kind):
    points, normals = points_on_ball()
    hidden = 0
    lift = 0.02 if "above" in kind else 0.0
    for view in range(0, rays.views, 3):
        camera = rays.camera(view)[0]
        index = visible(rays, view, points, normals, OCCLUDERS[kind](), least_cosine=0.1, lift=lift).index
        shown = torch.zeros(len(points), dtype=torch.bool)
        shown[index] = True
        away = distance_of_line(points + lift * normals, camera, OTHER)
        facing = expected_cosine(rays, view, points + lift * normals, normals) > 0.1
        clear = (away - OTHER_RADIUS).abs() > 0.01
        assert torch.equal(shown[clear], (facing & (away > OTHER_RADIUS))[clear])
        hidden += int((facing & (away < OTHER_RADIUS) & clear).sum())
    assert hidden > 100, "some points are hidden"


def test_a_point_on_a_face_is_not_hidden_by_its_own_face(rays):
    ball = trimesh.creation.icosphere(subdivisions=4, radius=RADIUS)
    tracer, faces = RayTracer(ball.vertices, ball.faces), np.arange(0, len(ball.faces), 7)
    points = torch.from_numpy(ball.triangles_center[faces].astype(np.float32))
    normals = torch.from_numpy(tracer.face_normals[faces])
    seen = visible(rays, 0, points, normals, MeshOccluder(tracer, faces=faces), least_cosine=0.0)
    assert torch.equal(seen.index, (expected_cosine(rays, 0, points, normals) > 0).nonzero()[:, 0])


def test_lines_of_sight_may_begin_above_a_touched_plane(rays):
    """Points in the middle of a thin plate lie in it. From above it, nothing hides them."""
    plate = trimesh.creation.box((1.0, 1.0, 0.02))
    tracer, points = RayTracer(plate.vertices, plate.faces), torch.tensor([[0.1, 0.2, 0.0], [-0.3, 0.1, 0.0]])
    high = [view for view in range(rays.views) if rays.camera(view)[0][2] > 0.5]
    for above, shown in ((0.02, [0, 1]), (0.005, [])):
        occluder = MeshOccluder(tracer, above=np.array([0.0, 0.0, above], np.float32))
        assert all(visible(rays, view, points, occluder=occluder).index.tolist() == shown for view in high) and high


@pytest.mark.parametrize(("level", "reach"), [(0.0, 0.3), (0.1, 0.4), (-0.1, 0.2)])
def test_the_level_of_an_sdf_makes_the_object_larger_or_smaller(rays, level, reach):
    camera, center = rays.camera(0)[0], torch.tensor([0.2, 0.1, -0.1])
    points = 2 * torch.rand(3000, 3, generator=torch.Generator().manual_seed(1)) - 1
    points = points[((points - center).norm(dim=-1) > 0.45) & (points.norm(dim=-1) < 0.8)]
    assert torch.equal(visible(rays, 0, points).index, torch.arange(len(points))), "all lie in the frame"
    occluder = SdfOccluder(grid_of(center, 0.3), level=level, first=0.0, last=3.0, steps=300)
    shown = torch.zeros(len(points), dtype=torch.bool)
    shown[visible(rays, 0, points, occluder=occluder).index] = True
    away = distance_of_line(points, camera, center)
    clear = (away - reach).abs() > 0.02
    assert torch.equal(shown[clear], (away > reach)[clear]) and not shown.all()


def test_places_that_cannot_hide_anything_do_not_count(rays):
    points, _ = points_on_ball()
    given = {"level": 0.0, "first": 0.02, "last": 1.5, "steps": 100}
    some = SdfOccluder(grid_of(OTHER, OTHER_RADIUS), **given, counts=lambda places: places[..., 2] > 10)
    assert len(visible(rays, 0, points, occluder=some).index) == len(points)


@pytest.mark.parametrize(("sampling", "error"), [(Sampling.PIXEL, 0.5), (Sampling.FOUR_PIXELS, 1e-3)])
def test_full_photos_give_the_colors_of_the_places(rays, sampling, error):
    points, normals = points_on_ball()
    for seen in observe(FullPhotos(rays, sampling), points, normals, least_cosine=0.3):
        height, width = rays.size[seen.view]
        place = (rays.project(seen.view, points[seen.index])[0] + 1) / 2
        assert len(seen.index) > 100
        assert (seen.color[:, 0] - place[:, 0]).abs().max() * width <= error + 1e-3
        assert (seen.color[:, 1] - place[:, 1]).abs().max() * height <= error + 1e-3
        torch.testing.assert_close(seen.color[:, 2], torch.full_like(place[:, 0], seen.view / 100))


def test_at_the_edge_of_a_photo_there_are_no_four_pixels(rays):
    height, width = rays.size[0]
    place = torch.tensor([[0.0, 0.0], [-1 + 0.4 / width, 0.0], [0.0, 1 - 0.4 / height]])
    four, edge, pixel = (
        FullPhotos(rays, sampling).sample(0, place)
        for sampling in (Sampling.FOUR_PIXELS, Sampling.TO_THE_EDGE, Sampling.PIXEL)
    )
    assert torch.isfinite(four).all(-1).tolist() == [True, False, False]
    torch.testing.assert_close(four[0], edge[0])
    assert torch.isfinite(edge).all() and (edge[1:, :2] < pixel[1:, :2]).any(-1).all(), "the rim is darker"


@pytest.mark.parametrize("sampling", Sampling)
def test_a_photo_does_not_show_what_falls_on_an_invalid_pixel(rays, sampling):
    points, normals = points_on_ball()
    valid = torch.ones(rays.count, dtype=torch.bool)
    height, width = rays.size[0]
    valid[: rays.offset[1]] = (torch.arange(height * width) % width) < width // 2  # the right half of the first photo
    photos = FullPhotos(replace(rays, valid=valid), sampling)
    seen = next(iter(observe(photos, points, normals, least_cosine=0.3)))
    all_of_them = visible(rays, 0, points, normals, least_cosine=0.3)
    right = all_of_them.place[:, 0] > 1 / width
    left = all_of_them.place[:, 0] < -1 / width
    shown = torch.isin(all_of_them.index, seen.index)
    assert shown[left].all() and not shown[right].any() and left.any() and right.any()


def test_small_photos_give_the_same_with_and_without_questions(rays):
    """`colors` is `observe` in one step, bit for bit."""
    photos, (points, _) = SmallPhotos(rays), points_on_ball()
    points = torch.cat([points, torch.tensor([[40.0, 0.0, 0.0]])])
    colors = photos.colors(points)
    torch.testing.assert_close(colors_of(observe(photos, points), len(points)), colors, rtol=0, atol=0, equal_nan=True)
    place, ahead = rays.project(photos.views[1], points)
    inside = ahead & (place.abs() < 0.95).all(-1)
    expected = tone_map(torch.cat([(place + 1) / 2, torch.full((len(points), 1), photos.views[1] / 100)], 1))
    assert (colors[1] - expected)[inside].abs().max() < 0.03
    assert colors[:, -1].isnan().any()


def test_small_photos_show_a_surface_past_another_body(rays):
    points, normals = points_on_ball()
    photos = SmallPhotos(rays)
    colors = photos.surface_colors(points, normals, mesh_of_both_balls(), inexact=0.02)
    for row, view in enumerate(photos.views):
        start = points + 0.02 * normals
        away = distance_of_line(start, rays.camera(view)[0], OTHER)
        cosine = expected_cosine(rays, view, start, normals)
        clear = ((away - OTHER_RADIUS).abs() > 0.01) & ((cosine - 0.15).abs() > 1e-3)
        shown = torch.isfinite(colors[row, :, 0])
        assert torch.equal(shown[clear], ((cosine > 0.15) & (away > OTHER_RADIUS))[clear])
        assert torch.equal(photos.cameras[row], rays.camera(view)[0])


@pytest.mark.parametrize(("views", "most"), [(1, 40), (40, 40), (41, 40), (100, 40), (7, 3)])
def test_chosen_photos_are_spread_evenly_and_not_too_many(views, most):
    chosen = list(chosen_views(views, most))
    assert chosen[0] == 0 and len(chosen) <= most and len(set(np.diff(chosen))) <= 1
    assert views - chosen[-1] <= max(1, -(-views // most))
