"""The reference's object field: a sphere at the start, normals against differences, samples at the surface, learning."""

from copy import deepcopy
from dataclasses import replace

import numpy as np
import pytest
import torch
from torch.nn import functional

pytest.importorskip("igl")
from benchmarks.baselines.reference_field import ReferenceField
from benchmarks.baselines.reference_path import COLUMNS, REFERENCE, SIZES, cells
from benchmarks.suite.harness import with_changes
from blender_nep.capture import PixelRays, load_capture
from blender_nep.fields.training import FieldsLearning
from blender_nep.presets import preset
from blender_nep.scene.scene import Scene
from blender_nep.surface.extraction import extract_surface
from support.paths import SUZANNE_SMALL


def test_a_failed_run_shows_its_message_once():
    row = {"capture": "box", "size": "small"}
    assert cells(row | {"error": "no surface"}) == ["box", "small", "no surface"]
    assert cells(row | dict.fromkeys(COLUMNS, 2)) == ["box", "small", *[2.0] * len(COLUMNS)]


def directions(count: int, seed: int) -> torch.Tensor:
    return functional.normalize(torch.randn(count, 3, generator=torch.Generator().manual_seed(seed)), dim=-1)


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("seed", range(3))
def test_it_starts_as_a_sphere_of_the_radius_asked_for(seed, size):
    torch.manual_seed(seed)
    field = ReferenceField(0.6, width=SIZES[size]["width"], layers=SIZES[size]["layers"])
    radius = torch.linspace(0.2, 0.95, 76)
    values = field.sdf((directions(200, 1)[:, None] * radius[:, None]).reshape(-1, 3)).reshape(200, -1)
    assert (values[:, 0] < 0).all() and (values[:, -1] > 0).all()
    assert ((values > 0).float().diff(dim=1).abs().sum(1) == 1).all(), "one surface in every direction"
    zero = radius[(values > 0).float().argmax(1)]
    # as published: a sphere up to the randomness of 128 or 256 weights a layer
    assert abs(zero.mean() - 0.6) < 0.15 and zero.std() < 0.1
    at = directions(200, 1) * zero[:, None]
    assert ((field.normal(at) * directions(200, 1)).sum(1) > 0.8).all()


def test_normals_are_differences_of_the_sdf_with_a_learned_norm():
    torch.manual_seed(0)
    field = ReferenceField(0.6, width=48).double()
    with torch.no_grad():  # not the sphere: every frequency at work
        for parameter in field.layers.parameters():
            parameter.add_(0.05 * torch.randn(parameter.shape, dtype=torch.float64))
    points, step = 0.7 * torch.rand(40, 3, dtype=torch.float64) - 0.3, 1e-6
    values, gradients = field.values_and_gradients(points)
    torch.testing.assert_close(values.detach(), field.sdf(points))
    shifts = step * torch.eye(3, dtype=torch.float64)
    differences = torch.stack([(field.sdf(points + s) - field.sdf(points - s)) / (2 * step) for s in shifts], -1)
    torch.testing.assert_close(gradients.detach(), differences, rtol=1e-4, atol=1e-6)
    # the eikonal term's own derivative, through the second backward pass, by differences along one direction
    parameter = field.layers[0].bias

    def eikonal() -> torch.Tensor:
        return ((field.values_and_gradients(points)[1].norm(dim=-1) - 1) ** 2).mean()

    along = torch.randn(parameter.shape, dtype=torch.float64)
    slope = (torch.autograd.grad(eikonal(), parameter)[0] * along).sum()
    ends = []
    for sign in (1, -1):
        with torch.no_grad():
            parameter.add_(sign * step * along)
        ends.append(eikonal().detach())
        with torch.no_grad():
            parameter.sub_(sign * step * along)
    torch.testing.assert_close(slope, (ends[0] - ends[1]) / (2 * step), rtol=1e-3, atol=1e-7)


def test_half_of_the_samples_stand_at_the_zero_of_the_sdf(monkeypatch):
    torch.manual_seed(0)
    field = ReferenceField(0.6)
    direction = directions(64, 2)
    origin = -3 * direction
    placed, values_and_gradients = [], field.values_and_gradients

    def recorded(points: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        placed.append(points.detach())
        return values_and_gradients(points)

    monkeypatch.setattr(field, "values_and_gradients", recorded)
    with torch.no_grad():
        surface = field.render(origin, direction, 300.0, 128, torch.Generator().manual_seed(0))
    t = ((torch.cat(placed).reshape(64, 128, 3) - origin[:, None]) * direction[:, None]).sum(-1)
    assert (t.diff(dim=1) >= -1e-5).all() and t.min() >= 2 - 1e-5 and t.max() <= 4 + 1e-5
    assert (surface.opacity > 0.99).all() and torch.equal(surface.ray, torch.arange(64))
    assert ((t - surface.depth[:, None]).abs() < 0.06).float().mean() > 0.3, "evenly spread, 6 % would be that near"
    at = field.sdf(origin + surface.depth[:, None] * direction)
    assert at.abs().max() < 0.02
    monkeypatch.setattr(ReferenceField, "cell", 2 / 16)
    assert field.near(origin, direction, 0.05).all()
    beside = functional.normalize(torch.linalg.cross(direction, directions(64, 3)), dim=-1)
    assert not field.near(origin + 0.95 * beside, direction, 0.05).any()


def test_it_replaces_the_object_field_and_resumes_the_same(monkeypatch):
    monkeypatch.setattr(ReferenceField, "cell", 2 / 16)
    rays = PixelRays.from_capture(load_capture(SUZANNE_SMALL), 2500, False)
    settings = with_changes(preset("preview"), {"fields": REFERENCE["fields"]})
    short = {
        "background_steps": 2,
        "steps": 40,
        "object_rays": 64,
        "sphere_rays": 64,
        "outside_rays": 64,
        "first_samples": 16,
        "samples": 16,
        "object_pixels_at": (0.2,),
    }
    settings = with_changes(settings, {"fields": short, "environment": {"rays_per_step": 192}})

    def learning(seed: int) -> FieldsLearning:
        torch.manual_seed(seed)
        field = ReferenceField(0.6, width=48, layers=5)
        return FieldsLearning(Scene.of(rays), settings, 0, field)

    first, other = learning(0), learning(1)
    before = first.object_field.sdf_grid(8)
    losses = [first.learn_step() for _ in range(12)]
    assert np.isfinite(losses).all() and first.refinements.state()["object_pixels"]["passed"] == 1
    other.load(deepcopy(first.state()))
    assert [first.learn_step() for _ in range(3)] == [other.learn_step() for _ in range(3)]
    assert np.abs(first.object_field.sdf_grid(8) - before).max() > 1e-3
    assert np.isfinite(first.explanation_ratio(256))
    few = replace(settings.surface, grid=24, unwrapped_faces=200, faces=400, atlas_texels=64)
    surface = extract_surface(first.object_field, few).surface
    assert 200 < len(surface.faces) <= 400 and np.isfinite(surface.vertices).all()
