"""The rendering of a known surface."""

import torch

from blender_nep.fields.object import volume_rendering
from blender_nep.fields.object.field import ObjectField


def test_a_sphere_is_rendered_where_it_stands():
    field = ObjectField(16, 0.6)
    field.add_level()
    field.add_level()
    generator = torch.Generator().manual_seed(0)
    origins = torch.nn.functional.normalize(torch.randn(300, 3, generator=generator), dim=-1) * 3
    directions = torch.nn.functional.normalize(torch.randn(300, 3, generator=generator) * 0.4 - origins, dim=-1)
    surface = volume_rendering.render_surface(field.shape(), origins, directions, 200.0, 24, None)
    off_axis = torch.linalg.cross(origins, directions).norm(dim=-1)
    opacity = torch.zeros(300).index_add(0, surface.ray, surface.opacity)
    assert (opacity[off_axis < 0.55] > 0.99).all() and (opacity[off_axis > 0.65] < 0.01).all()
    solid = off_axis[surface.ray] < 0.5
    radius = surface.point[solid].norm(dim=-1)
    assert (radius - 0.6).abs().max() < 0.01  # 1 / sharpness, and the coarse start's rounding of the sphere
    normal = torch.nn.functional.normalize(surface.gradient[solid], dim=-1)
    outward = surface.point[solid] / radius[:, None]
    assert (normal * outward).sum(-1).min() > 0.99
