"""The visual hull: exact silhouettes of known bodies are carved back into them; F_e's residuals show the object."""

import numpy as np
import pytest
import torch
from torch.nn import functional

from blender_nep.capture import PixelRays, load_capture
from blender_nep.fields.object.field import ObjectField
from blender_nep.fields.visual_hull import (
    LEAST_EXCESS,
    background_silhouettes,
    carve,
    excess,
    low_quantile,
    mask_silhouettes,
    near_sphere,
    score_cells,
)
from blender_nep.support.plane import Support
from blender_nep.tone_mapping import tone_map
from support.paths import SUZANNE_SMALL


@pytest.fixture(scope="module")
def rays():
    return PixelRays.from_capture(load_capture(SUZANNE_SMALL), 10_000, True, torch.device("cpu"))


def silhouettes_of(rays, center, radius):
    """Exact silhouettes of a ball, from the distance of each ray to its center."""
    maps = []
    for view, (height, width) in enumerate(rays.size):
        origin, direction, _ = rays.rays(torch.arange(rays.offset[view], rays.offset[view + 1]))
        away = torch.linalg.cross(origin - center, direction).norm(dim=-1)
        maps.append(functional.avg_pool2d((away < radius).float().reshape(1, height, width), 2)[0])
    return maps


def signed_distance(cells, center, radius):
    axis = (np.arange(cells) + 0.5) / cells * 2 - 1
    grid = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), -1)
    return np.linalg.norm(grid - center, axis=-1) - radius


@pytest.mark.parametrize("views", [1, 2, 3, 40])
@pytest.mark.parametrize("share", [0.0, 0.05, 0.3, 1.0])
def test_low_quantile_is_that_of_the_known_values(views, share):
    generator = torch.Generator().manual_seed(views)
    values = torch.rand(views, 500, generator=generator)
    values[torch.rand(views, 500, generator=generator) < torch.linspace(0, 1.2, 500)] = torch.nan
    assert values.isnan().all(0).any() and not values.isnan().any(0).all()
    expected = torch.nanquantile(values, share, dim=0)
    torch.testing.assert_close(low_quantile(values, share), expected, rtol=1e-6, atol=0, equal_nan=True)


def test_projecting_a_point_on_a_pixels_ray_gives_the_pixel(rays):
    for view in (0, rays.views - 1):
        height, width = rays.size[view]
        index = rays.offset[view] + torch.arange(0, height * width, 37)
        origin, direction, _ = rays.rays(index)
        place, ahead = rays.project(view, origin + 2.5 * direction)
        local = index - rays.offset[view]
        expected = torch.stack([2 * (local % width + 0.5) / width - 1, 2 * (local // width + 0.5) / height - 1], -1)
        assert ahead.all()
        torch.testing.assert_close(place, expected, atol=2e-4, rtol=0)
        assert not rays.project(view, origin - direction)[1].any()


def test_the_silhouettes_of_a_ball_are_carved_into_the_ball(rays):
    center, radius, cells = torch.tensor([0.25, -0.1, 0.1]), 0.4, 48
    hull = carve(score_cells(rays, silhouettes_of(rays, center, radius), cells))
    true = signed_distance(cells, center.numpy(), radius)
    both, either = ((hull.sdf < 0) & (true < 0)).sum(), ((hull.sdf < 0) | (true < 0)).sum()
    assert both / either > 0.85 and hull.contrast > 10
    assert hull.volume == pytest.approx(radius**3, rel=0.15)
    near = np.abs(true) < 0.15
    assert np.abs(hull.sdf - true)[near].mean() < 2 / cells


def intersection(one, other):
    """Intersection over union of two solids, bool [n, n, n]."""
    return (one & other).sum() / (one | other).sum()


@pytest.mark.parametrize(("strength", "found"), [(0.18, True), (0.06, False)])
def test_on_a_support_a_weak_foot_is_found_and_free_space_is_not(rays, strength, found):
    """Two balls: the maps hold 0.4 for one, `strength` for the other, and 0.02 for the background."""
    body, foot, cells = torch.tensor([0.0, 0.0, 0.35]), torch.tensor([0.0, 0.0, -0.35]), 48
    maps = [
        torch.maximum(0.4 * strong, strength * weak).clamp(min=0.02)
        for strong, weak in zip(silhouettes_of(rays, body, 0.4), silhouettes_of(rays, foot, 0.35), strict=True)
    ]
    upper = signed_distance(cells, body.numpy(), 0.4) < 0
    both = upper | (signed_distance(cells, foot.numpy(), 0.35) < 0)
    score = score_cells(rays, maps, cells)
    floating, on_support = (carve(score, support).sdf < 0 for support in (False, True))
    assert intersection(floating, upper) > 0.8 and intersection(floating, both) < 0.7
    assert intersection(on_support, both if found else upper) > 0.8


def test_what_the_background_explains_is_taken_from_the_object(rays):
    center, radius, cells = torch.tensor([0.1, 0.0, -0.1]), 0.4, 48
    true = signed_distance(cells, center.numpy(), radius)
    lump = signed_distance(cells, np.array([0.1, 0.0, 0.35]), 0.2)
    sdf = np.minimum(true, lump)
    change = excess(rays, silhouettes_of(rays, center, radius), sdf)
    left = sdf + change
    assert (left[(lump < 0) & (true > 0.06)] > 0).all(), "the lump is free space"
    assert (change[true < -0.06] == 0).all() and (change[sdf > 0] == 0).all()
    speck = true.copy()
    speck[30:32, 30:32, 40:42] = -0.01
    assert speck[30:32, 30:32, 40:42].size < LEAST_EXCESS
    assert (excess(rays, silhouettes_of(rays, center, radius), speck)[30:32, 30:32, 40:42] == 0).all()
    assert not excess(rays, silhouettes_of(rays, center, radius), np.ones((8, 8, 8))).any()


def test_the_background_is_asked_only_of_the_wanted_rays(rays):
    asked = []

    def black(bundle):
        asked.append(len(bundle))
        return torch.zeros_like(bundle.directions)

    maps = background_silhouettes(black, rays, 4, lambda bundle: bundle.directions[:, 2] < 0)
    everything = background_silhouettes(black, rays, 4, lambda bundle: bundle.half_angle > 0)
    assert sum(asked[: rays.views]) < sum(asked[rays.views :]) == sum(map(torch.numel, maps))
    height, width = rays.size[0]
    photo = tone_map(rays.photo(torch.arange(height * width))).reshape(height, width, 3)
    expected = functional.avg_pool2d(photo.permute(2, 0, 1), 4).mean(0)
    torch.testing.assert_close(everything[0], expected)
    assert all(((part == 0) | (part == whole)).all() for part, whole in zip(maps, everything, strict=True))


@pytest.mark.parametrize("block", [2, 4])
def test_scores_are_of_all_rays_though_only_near_ones_are_asked(rays, block):
    def every(bundle):
        return bundle.half_angle > 0

    def colors(bundle):
        return bundle.directions.abs()

    scores = [score_cells(rays, background_silhouettes(colors, rays, block, wanted), 32) for wanted in (None, every)]
    np.testing.assert_array_equal(*scores)
    asked = near_sphere(rays.rays(torch.arange(rays.count)), block)
    assert 0.5 < asked.float().mean() < 0.95


@pytest.mark.parametrize("value", [0.0, 0.3])
def test_silhouettes_without_an_object_give_no_hull(rays, value):
    assert carve(score_cells(rays, [torch.full((20, 20), value)] * rays.views, 32)) is None


def test_the_masks_hull_holds_the_object(rays):
    import trimesh

    capture = load_capture(SUZANNE_SMALL)
    truth = trimesh.load(SUZANNE_SMALL / "gt_mesh.ply", process=False, force="mesh")
    points = trimesh.sample.sample_surface(truth, 3000, seed=0)[0]
    points = torch.from_numpy((points - capture.object_center) / capture.object_radius).float()
    hull = carve(score_cells(rays, mask_silhouettes(rays), 64))
    value = functional.grid_sample(
        torch.from_numpy(hull.sdf)[None, None], points.flip(-1)[None, None, None], align_corners=False
    ).flatten()
    assert (value < 2 * 2 / 64).float().mean() > 0.9, "a visual hull leaves nothing of the object out"


def test_a_field_can_start_from_an_sdf():
    field = ObjectField(16, 0.6)
    field.add_level()
    sdf = torch.from_numpy(signed_distance(32, np.array([0.1, 0.0, -0.2]), 0.5)).float()
    field.start_from(sdf)
    points = torch.randn(500, 3, generator=torch.Generator().manual_seed(0))
    points = 0.9 * points / points.norm(dim=-1, keepdim=True) * torch.linspace(0.2, 1, 500)[:, None]
    true = (points - torch.tensor([0.1, 0.0, -0.2])).norm(dim=-1) - 0.5
    away = true > -0.4  # a smooth field rounds the point at the ball's center
    assert (field.sdf(points) - true).abs()[away].max() < 0.01
    with pytest.raises(ValueError, match="32"):
        field.start_from(sdf[:16, :16, :16])


def test_a_field_tells_its_sdf_in_cells_and_takes_additions():
    field = ObjectField(16, 0.6)
    field.add_level()
    axis = (torch.arange(32) + 0.5) / 32 * 2 - 1
    centers = torch.stack(torch.meshgrid(axis, axis, axis, indexing="ij"), -1)
    inside = (centers.norm(dim=-1) <= 1).numpy()
    before = field.sdf_in_cells()
    away = inside & (centers.norm(dim=-1) > 0.2).numpy()  # a smooth field rounds the point at the sphere's center
    np.testing.assert_allclose(before[away], (centers.norm(dim=-1) - 0.6).numpy()[away], atol=0.02)
    assert (before[~inside] == 1).all()
    field.add(torch.full((32, 32, 32), 0.25))
    inner = (centers.abs().amax(-1) < 0.9).numpy() & inside  # beyond the border, no cell is added to
    np.testing.assert_allclose((field.sdf_in_cells() - before)[inner], 0.25, atol=1e-5)
    field.stand_on(Support(np.array([0.0, 0.0, 1.0]), -0.3))
    below = centers[..., 2].numpy() < -0.3
    assert (field.sdf_in_cells()[below] == 1).all() and (field.sdf_in_cells()[inside & ~below] < 1).all()
