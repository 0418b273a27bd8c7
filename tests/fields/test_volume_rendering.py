"""NeuS weights, sample placement and the rendering of a known surface."""

import torch

from blender_nep.fields import volume_rendering
from blender_nep.fields.object_field import ObjectField, SplineShape


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


def test_an_object_that_reaches_out_of_the_sphere_is_cut_there():
    """A half space x < 0.2, against many samples along each ray, of which those outside of the sphere are in the air."""
    cells, sharpness = 32, 40.0
    center = (torch.arange(cells + 2) - 0.5) / cells * 2 - 1  # these coefficients make a linear function, exactly
    coefficients = (center - 0.2)[:, None, None].repeat(1, cells + 2, cells + 2).requires_grad_()
    generator = torch.Generator().manual_seed(0)
    origins = torch.nn.functional.normalize(torch.randn(400, 3, generator=generator), dim=-1) * 3
    directions = torch.nn.functional.normalize(torch.randn(400, 3, generator=generator) * 0.3 - origins, dim=-1)
    surface = volume_rendering.render_surface(SplineShape(coefficients), origins, directions, sharpness, 64, None)
    t = 1.5 + torch.linspace(0, 3, 20_001, dtype=torch.float64)
    points = origins[:, None].double() + t[:, None] * directions[:, None].double()
    outside = points.norm(dim=-1) > 1
    weights = volume_rendering.neus_weights(torch.where(outside, 1e3, points[..., 0] - 0.2), sharpness)
    weights = weights * ~outside[:, 1:]
    assert (outside[:, 0] & outside[:, -1]).all() and len(surface.ray) > 300
    meets = ~outside.all(1)
    opacity = torch.zeros(400).index_add(0, surface.ray, surface.opacity.detach())
    torch.testing.assert_close(opacity[meets].double(), weights.sum(1)[meets], rtol=0, atol=0.005)
    solid = surface.opacity.detach() > 0.99
    depth = ((weights * 0.5 * (t[1:] + t[:-1])).sum(1) / weights.sum(1))[surface.ray[solid]]
    torch.testing.assert_close(
        surface.depth.detach()[solid].double(), depth, rtol=0, atol=0.005
    )  # the band leaves out 0.0025
    cut = surface.point[:, 0] < -0.3  # far from the plane, rays meet the object only at the cut
    assert cut.sum() > 100
    torch.testing.assert_close(surface.gradient[cut], surface.point[cut], rtol=0, atol=1e-3)
    surface.opacity.sum().backward()
    assert torch.isfinite(coefficients.grad).all()
    # a ray that enters just beside the plane tells whether the object reaches there
    assert coefficients.grad[cells // 2 + 4].abs().max() > 0
