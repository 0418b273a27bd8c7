"""Stage 1 where the object turned and the light stood still: F_e and F_o's light are in the room's frame."""

import math
from dataclasses import replace

import torch

from blender_nep.capture.rays.ray_bundle import RayBundle
from blender_nep.fields.environment.field import EnvironmentField
from blender_nep.fields.fields import new_object_field
from blender_nep.fields.rendering import FieldsRenderer, RenderSettings
from support.brief_preset import brief_preset
from support.turns import turned_about_z

CPU = torch.device("cpu")
SETTINGS = RenderSettings(sharpness=40.0, samples=16)
COLUMNS = 3
"""The object is turned by so many columns of F_e's grid, so that a turned grid is exact."""


def renderer() -> FieldsRenderer:
    """A sphere in a patterned fog."""
    torch.manual_seed(0)
    preset = brief_preset()
    environment = EnvironmentField(preset.environment)
    with torch.no_grad():
        environment.raw += torch.randn(environment.raw.shape)
    return FieldsRenderer(new_object_field(preset, CPU), environment, preset.fields)


def rays(count: int = 40) -> RayBundle:
    """Rays from a distance of 3 radii past the middle of the sphere."""
    generator = torch.Generator().manual_seed(1)
    origins = 3 * torch.nn.functional.normalize(torch.randn(count, 3, generator=generator), dim=-1)
    aims = 1.2 * torch.rand(count, 3, generator=generator) - 0.6
    return RayBundle(origins, torch.nn.functional.normalize(aims - origins, dim=-1), torch.full((count,), 1e-3))


def test_motions_of_an_object_that_stood_still_change_nothing() -> None:
    fields, seen = renderer(), rays()
    still = replace(seen, motion=turned_about_z([0.0] * len(seen)))
    alone, with_motion = (fields.render(each, SETTINGS, None) for each in (seen, still))
    torch.testing.assert_close(with_motion.radiance, alone.radiance, rtol=1e-5, atol=1e-6)
    torch.testing.assert_close(fields.background(still), fields.background(seen), rtol=1e-5, atol=1e-6)


def test_a_turned_object_sees_what_a_turned_room_shows() -> None:
    fields, seen = renderer(), rays()
    rows = fields.environment.raw.shape[1]
    moved = replace(seen, motion=turned_about_z([math.pi * COLUMNS / rows] * len(seen)))
    turned = renderer()
    with torch.no_grad():  # columns fall with the azimuth from one side to the other, so a roll is a turn
        turned.environment.raw.copy_(fields.environment.raw.roll(-COLUMNS, 2))
    expected, other = turned.background(seen), fields.background(seen)
    found = fields.background(moved)
    torch.testing.assert_close(found, expected, rtol=1e-3, atol=1e-4)
    assert (other - expected).abs().mean() > 0.02, "another turn shows another room"


def test_the_light_of_a_turned_surface_is_that_of_the_room() -> None:
    field = renderer().object_field
    generator = torch.Generator().manual_seed(2)
    points, normals, directions = torch.nn.functional.normalize(torch.randn(3, 30, 3, generator=generator), dim=-1)
    motion = turned_about_z([0.1 * k for k in range(30)], axis=(0.2, -0.1))
    seen = field.appearance(points, normals, directions, motion)
    still = field.appearance(points, normals, directions)
    lit = field.lit(field.paint(points), motion.points(points), motion.directions(normals), motion.directions(directions))
    torch.testing.assert_close(seen.light, lit.light)
    torch.testing.assert_close(seen.albedo, still.albedo, rtol=0, atol=0)
    assert (seen.light - still.light).abs().max() > 1e-3


def test_distances_along_a_ray_are_the_same_in_the_room() -> None:
    seen = rays()
    room = replace(seen, motion=turned_about_z([0.7] * len(seen), axis=(0.3, 0.0))).in_room()
    center = turned_about_z([0.7], axis=(0.3, 0.0)).points(torch.zeros(1, 3))
    torch.testing.assert_close((room.origins - center).norm(dim=-1), seen.origins.norm(dim=-1))
    end = room.origins + 2.5 * room.directions - center
    torch.testing.assert_close(end.norm(dim=-1), (seen.origins + 2.5 * seen.directions).norm(dim=-1))
