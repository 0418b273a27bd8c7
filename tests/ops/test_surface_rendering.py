"""Samples on rays and their compositing: NeuS's published formula, gradients, and both bodies against each other."""

import pytest
import torch

from blender_nep.ops.object.surface_rendering import composite, neus_weights, place_samples

BODIES = pytest.mark.parametrize("body", ["numba", "torch"])


def test_weights_equal_the_published_quotient_and_are_finite():
    sdf = torch.linspace(0.3, -0.3, 33, dtype=torch.float64)[None]
    s = 20.0
    weights = neus_weights(sdf, s)[0]
    phi = torch.sigmoid(s * sdf[0])
    alpha = ((phi[:-1] - phi[1:]) / phi[:-1]).clamp(min=0)
    expected = alpha * torch.cumprod(torch.cat([torch.ones(1, dtype=torch.float64), 1 - alpha]), 0)[:-1]
    torch.testing.assert_close(weights, expected)
    deep = torch.linspace(-50, -60, 20).requires_grad_()
    inside = neus_weights(deep[None], 500.0)
    inside.sum().backward()
    assert torch.isfinite(inside).all() and torch.isfinite(deep.grad).all()
    # a ray that goes from inside to outside meets no front face
    assert neus_weights(torch.linspace(-0.2, 0.2, 20)[None], 50.0).abs().max() < 1e-6


def test_weights_gradcheck():
    sdf = (torch.rand(3, 9, dtype=torch.float64, generator=torch.Generator().manual_seed(0)) - 0.6).requires_grad_()
    assert torch.autograd.gradcheck(lambda f: neus_weights(f, 7.0), sdf)


@BODIES
def test_weights_of_a_ray_never_exceed_one(body):
    sdf = torch.tensor([[1e30, -1e30, 1e30], [0.0, 0.0, 0.0], [1e30, 1.0, -1e30], [-1e9, -1e9, 1e9]])
    field, t = torch.cat([sdf[..., None], torch.ones(4, 3, 3)], -1), torch.arange(3.0).expand(4, 3)
    for sharpness in (1e-6, 1.0, 1e6):
        weights = neus_weights(sdf, sharpness)
        assert torch.isfinite(weights).all() and (weights >= 0).all() and (weights.sum(1) <= 1 + 1e-6).all()
        found = composite(field, t, sharpness, body)
        torch.testing.assert_close(found.opacity, weights.sum(1))
        torch.testing.assert_close(found.gradient, weights.sum(1)[:, None].expand(4, 3))


@BODIES
def test_samples_stay_inside_their_spans_and_in_order(body):
    spans = torch.tensor([[[1.0, 1.5], [2.0, 2.25], [0, 0]], [[0.5, 0.6], [0, 0], [0, 0]]])
    t = place_samples(spans, torch.tensor([2, 1], dtype=torch.int32), 12, torch.tensor([0.3, 0.9]), body)
    assert t.shape == (2, 13)
    assert (t[:, 1:] >= t[:, :-1]).all()
    assert (((t[0] >= 1) & (t[0] <= 1.5)) | ((t[0] >= 2) & (t[0] <= 2.25))).all()
    assert t[0, 0] == 1 and t[0, -1] == 2.25
    assert abs(int((t[0] <= 1.5).sum()) - 9) <= 1, "samples are shared by length: two thirds in the first span"
    assert ((t[1] >= 0.5) & (t[1] <= 0.6 + 1e-6)).all()


@BODIES
def test_samples_stand_in_order_also_in_spans_without_length(body):
    spans = torch.tensor([[[1.0, 1.0], [2.0, 2.0]], [[1.0, 2.0], [0.0, 0.0]], [[1.0, 1.5], [3.0, 3.5]]])
    t = place_samples(spans, torch.tensor([2, 1, 2], dtype=torch.int32), 6, torch.tensor([0.0, 0.5, 0.999]), body)
    assert torch.isfinite(t).all() and (t.diff(dim=1) >= 0).all() and t.min() >= 1 and t.max() <= 3.5


def _rays(n, samples, dtype=torch.float64, seed=0):
    """Random samples [n, samples + 1, 4] of an SDF that mostly falls along each ray, and their distances."""
    generator = torch.Generator().manual_seed(seed)
    t = torch.rand(n, samples + 1, dtype=dtype, generator=generator).sort(1).values + 2
    value = 1.2 - 0.5 * t + 0.1 * torch.randn(n, samples + 1, dtype=dtype, generator=generator)
    gradient = torch.randn(n, samples + 1, 3, dtype=dtype, generator=generator)
    return torch.cat([value[..., None], gradient], -1), t


@BODIES
def test_rays_are_composited_by_the_published_formula(body):
    field, t = _rays(50, 9)
    found = composite(field, t, 8.0, body)
    phi = torch.sigmoid(8.0 * field[..., 0])
    alpha = ((phi[:, :-1] - phi[:, 1:]) / phi[:, :-1]).clamp(min=0)
    clear = torch.cumprod(torch.cat([torch.ones(50, 1, dtype=torch.float64), 1 - alpha], 1), 1)[:, :-1]
    weight = (alpha * clear)[..., None]
    middle = (field[:, 1:, 1:] + field[:, :-1, 1:]) / 2
    torch.testing.assert_close(found.opacity, weight.sum((1, 2)))
    torch.testing.assert_close(found.gradient, (weight * middle).sum(1))
    distance = (weight[..., 0] * (t[:, 1:] + t[:, :-1]) / 2).sum(1) / found.opacity
    torch.testing.assert_close(found.depth, distance)
    length = (field[..., 1] ** 2 + field[..., 2] ** 2 + field[..., 3] ** 2).sqrt()
    torch.testing.assert_close(found.eikonal, ((length - 1) ** 2).mean(1))


@BODIES
@pytest.mark.parametrize("sharpness", [3.0, 60.0])
def test_compositing_gradcheck(body, sharpness):
    field, t = _rays(6, 5, seed=1)
    assert torch.autograd.gradcheck(lambda f: tuple(composite(f, t, sharpness, body)), field.requires_grad_())


@BODIES
def test_a_ray_from_inside_a_sharp_surface_has_finite_gradients(body):
    field = torch.full((1, 4, 4), -1000.0, requires_grad=True)
    composite(field, torch.linspace(1, 2, 4)[None], 1e8, body).opacity.sum().backward()
    torch.testing.assert_close(field.grad[0, :, 0], torch.tensor([1e8, 0, 0, -1e8]))


@BODIES
def test_a_ray_through_nothing_gets_finite_gradients(body):
    """Its SDF rises, and has no gradient anywhere."""
    field = torch.zeros(1, 5, 4)
    field[0, :, 0] = torch.linspace(0.1, 0.5, 5)
    found = composite(field.requires_grad_(), torch.linspace(1, 2, 5)[None], 50.0, body)
    sum(part.sum() for part in found).backward()
    assert found.opacity == 0 and found.depth == 0 and torch.isfinite(field.grad).all()


def test_both_bodies_agree_in_float32_also_far_inside_and_out():
    generator = torch.Generator().manual_seed(5)
    field, t = _rays(400, 8, torch.float32, seed=2)
    field[..., 0] += torch.randn(400, 1, generator=generator)
    cost = torch.randn(400, 6, generator=generator)
    results = []
    for body in ("numba", "torch"):
        leaf = field.clone().requires_grad_()
        found = composite(leaf, t, 100.0, body)
        out = torch.cat([part.reshape(400, -1) for part in found], 1)
        (out * cost).sum().backward()
        results.append((out.detach(), leaf.grad))
    for ours, reference in zip(*results, strict=True):
        torch.testing.assert_close(ours, reference, rtol=1e-4, atol=1e-4)


def test_both_bodies_place_samples_alike():
    generator = torch.Generator().manual_seed(7)
    spans = torch.rand(300, 8, generator=generator).sort(1).values.reshape(300, 4, 2)
    count = torch.randint(1, 5, (300,), generator=generator, dtype=torch.int32)
    jitter = torch.rand(300, generator=generator)
    ours, reference = (place_samples(spans, count, 8, jitter, body) for body in ("numba", "torch"))
    torch.testing.assert_close(ours, reference, rtol=0, atol=1e-5)
