"""NeuS weights, sample placement and the rendering of a known surface."""

import torch

from blender_nep.fields import volume_rendering
from blender_nep.fields.object_field import ObjectField


def test_weights_equal_the_published_quotient_and_stay_finite_deep_inside():
    sdf = torch.linspace(0.3, -0.3, 33, dtype=torch.float64)[None]
    s = 20.0
    weights = volume_rendering.neus_weights(sdf, s)[0]
    phi = torch.sigmoid(s * sdf[0])
    alpha = ((phi[:-1] - phi[1:]) / phi[:-1]).clamp(min=0)
    expected = alpha * torch.cumprod(torch.cat([torch.ones(1, dtype=torch.float64), 1 - alpha]), 0)[:-1]
    torch.testing.assert_close(weights, expected)
    deep = torch.linspace(-50, -60, 20).requires_grad_()
    inside = volume_rendering.neus_weights(deep[None], 500.0)
    inside.sum().backward()
    assert torch.isfinite(inside).all() and torch.isfinite(deep.grad).all()
    # a ray that goes from inside to outside meets no front face
    assert volume_rendering.neus_weights(torch.linspace(-0.2, 0.2, 20)[None], 50.0).abs().max() < 1e-6


def test_weights_gradcheck():
    sdf = (torch.rand(3, 9, dtype=torch.float64, generator=torch.Generator().manual_seed(0)) - 0.6).requires_grad_()
    assert torch.autograd.gradcheck(lambda f: volume_rendering.neus_weights(f, 7.0), sdf)


def test_samples_stay_inside_their_spans_and_in_order():
    spans = torch.tensor([[[1.0, 1.5], [2.0, 2.25], [0, 0]], [[0.5, 0.6], [0, 0], [0, 0]]])
    t = volume_rendering.place_samples(spans, torch.tensor([2, 1], dtype=torch.int32), 12, torch.tensor([0.3, 0.9]))
    assert t.shape == (2, 13)
    assert (t[:, 1:] >= t[:, :-1]).all()
    assert (((t[0] >= 1) & (t[0] <= 1.5)) | ((t[0] >= 2) & (t[0] <= 2.25))).all()
    assert t[0, 0] == 1 and t[0, -1] == 2.25
    assert abs(int((t[0] <= 1.5).sum()) - 9) <= 1, "samples are shared by length: two thirds in the first span"
    assert ((t[1] >= 0.5) & (t[1] <= 0.6 + 1e-6)).all()


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
