"""The visual hull: exact silhouettes of known bodies are carved back into them; F_e's residuals show the object."""

import numpy as np
import pytest
import torch
from torch.nn import functional

from blender_nep.capture import PixelRays, load_capture
from blender_nep.fields.object_field import ObjectField
from blender_nep.fields.visual_hull import carve, mask_silhouettes
from support.paths import SUZANNE_SMALL


@pytest.fixture(scope="module")
def rays():
    return PixelRays.from_capture(load_capture(SUZANNE_SMALL), 10_000, True, torch.device("cpu"))


def silhouettes_of(rays, centre, radius):
    """Exact silhouettes of a ball, from the distance of each ray to its centre."""
    maps = []
    for view, (height, width) in enumerate(rays.size):
        origin, direction, _ = rays.rays(torch.arange(rays.offset[view], rays.offset[view + 1]))
        away = torch.linalg.cross(origin - centre, direction).norm(dim=-1)
        maps.append(functional.avg_pool2d((away < radius).float().reshape(1, height, width), 2)[0])
    return maps


def signed_distance(cells, centre, radius):
    axis = (np.arange(cells) + 0.5) / cells * 2 - 1
    grid = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), -1)
    return np.linalg.norm(grid - centre, axis=-1) - radius


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
    centre, radius, cells = torch.tensor([0.25, -0.1, 0.1]), 0.4, 48
    hull = carve(rays, silhouettes_of(rays, centre, radius), cells)
    true = signed_distance(cells, centre.numpy(), radius)
    both, either = ((hull.sdf < 0) & (true < 0)).sum(), ((hull.sdf < 0) | (true < 0)).sum()
    assert both / either > 0.85 and hull.contrast > 10
    assert hull.volume == pytest.approx(radius**3, rel=0.15)
    near = np.abs(true) < 0.15
    assert np.abs(hull.sdf - true)[near].mean() < 2 / cells


@pytest.mark.parametrize("value", [0.0, 0.3])
def test_silhouettes_without_an_object_give_no_hull(rays, value):
    assert carve(rays, [torch.full((20, 20), value)] * rays.views, 32) is None


def test_the_masks_hull_holds_the_object(rays):
    import trimesh

    capture = load_capture(SUZANNE_SMALL)
    truth = trimesh.load(SUZANNE_SMALL / "gt_mesh.ply", process=False, force="mesh")
    points = trimesh.sample.sample_surface(truth, 3000, seed=0)[0]
    points = torch.from_numpy((points - capture.object_center) / capture.object_radius).float()
    hull = carve(rays, mask_silhouettes(rays), 64)
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
    away = true > -0.4  # a smooth field rounds the point at the ball's centre
    assert (field.sdf(points) - true).abs()[away].max() < 0.01
    with pytest.raises(ValueError, match="32"):
        field.start_from(sdf[:16, :16, :16])
