"""Encodings against scipy's spherical harmonics, brute-force integration and formulas. Both bodies of each."""

import numpy as np
import pytest
import torch
from scipy.special import sph_harm_y

from blender_nep.ops.object.encodings import encoding_size, integrated_directional_encoding, positional_encoding

BODIES = pytest.mark.parametrize("body", ["numba", "torch"])
PAIRS = [(2**i, m) for i in range(4) for m in range(2**i + 1)]


def harmonics(directions: np.ndarray) -> np.ndarray:
    theta, phi = np.arccos(directions[:, 2].clip(-1, 1)), np.arctan2(directions[:, 1], directions[:, 0])
    y = np.stack([sph_harm_y(degree, order, theta, phi) for degree, order in PAIRS], -1)
    return np.concatenate([y.real, y.imag], -1)


def unit(n: int, seed: int = 0) -> torch.Tensor:
    d = torch.randn(n, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(seed))
    return d / d.norm(dim=-1, keepdim=True)


@BODIES
def test_without_roughness_the_encoding_is_spherical_harmonics(body):
    d = unit(50)
    encoded = integrated_directional_encoding(d, torch.zeros(50, 1, dtype=torch.float64), body=body)
    assert encoded.shape[-1] == encoding_size(4)
    np.testing.assert_allclose(encoded.numpy(), harmonics(d.numpy()), atol=1e-12)


@BODIES
def test_attenuation_is_the_mean_over_a_von_mises_fisher_lobe(body):
    kappa, n = 40.0, 400_000
    rng = np.random.default_rng(0)
    cosine = 1 + np.log(1 - rng.random(n)) / kappa
    phi = rng.random(n) * 2 * np.pi
    sine = np.sqrt(1 - cosine.clip(-1) ** 2)
    axis = unit(1, 5)
    a = np.cross(axis[0], [1.0, 0, 0])
    a /= np.linalg.norm(a)
    b = np.cross(axis[0], a)
    lobe = cosine[:, None] * axis.numpy() + sine[:, None] * (np.cos(phi)[:, None] * a + np.sin(phi)[:, None] * b)
    encoded = integrated_directional_encoding(axis, torch.full((1, 1), 1 / kappa, dtype=torch.float64), body=body)
    # exp(-l (l + 1) / 2 kappa) is Ref-NeRF's approximation: a few percent at degree 8
    np.testing.assert_allclose(encoded.numpy()[0], harmonics(lobe).mean(0), atol=0.02)


@BODIES
def test_gradient_is_finite_at_the_poles(body):
    d = torch.tensor([[0.0, 0, 1], [0, 0, -1], [1, 0, 0]], requires_grad=True)
    kappa_inv = torch.zeros(3, 1, requires_grad=True)
    integrated_directional_encoding(d, kappa_inv, body=body).sum().backward()
    assert torch.isfinite(d.grad).all() and torch.isfinite(kappa_inv.grad).all()


@BODIES
def test_positional_encoding_shape_and_values(body):
    x = torch.tensor([[0.5, -1.0, 0.25]], dtype=torch.float64)
    out = positional_encoding(x, 2, body)
    assert out.shape == (1, 15)
    torch.testing.assert_close(out[0, 3:6], torch.sin(x[0] * torch.pi / 2))
    torch.testing.assert_close(out[0, 12:15], torch.cos(x[0] * torch.pi))


@BODIES
@pytest.mark.parametrize("levels", [1, 3, 4])
def test_directional_encoding_gradcheck(body, levels):
    """The direction may also leave the unit sphere, as it does in a numerical gradient. 19 directions fill two blocks."""
    kappa_inv = torch.rand(19, 1, dtype=torch.float64, generator=torch.Generator().manual_seed(1)) + 0.01
    assert torch.autograd.gradcheck(
        lambda d, k: integrated_directional_encoding(d, k, levels, body),
        (unit(19).requires_grad_(), kappa_inv.requires_grad_()),
    )


@BODIES
def test_a_negative_roughness_counts_as_zero_and_has_no_gradient(body):
    kappa_inv = torch.full((4, 1), -0.5, dtype=torch.float64, requires_grad=True)
    encoded = integrated_directional_encoding(unit(4), kappa_inv, body=body)
    encoded.sum().backward()
    np.testing.assert_allclose(encoded.detach().numpy(), harmonics(unit(4).numpy()), atol=1e-12)
    assert (kappa_inv.grad == 0).all()


@BODIES
def test_positional_encoding_gradcheck(body):
    x = torch.randn(7, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(2)).requires_grad_()
    assert torch.autograd.gradcheck(lambda x: positional_encoding(x, 5, body), x)


def test_both_bodies_agree_in_float32():
    generator = torch.Generator().manual_seed(3)
    direction, roughness, point = unit(100).float(), torch.rand(100, 1, generator=generator), unit(100, 4).float()
    for encode in (
        lambda b: integrated_directional_encoding(direction, roughness, body=b),
        lambda b: positional_encoding(point, 5, b),
    ):
        torch.testing.assert_close(encode("numba"), encode("torch"), rtol=0, atol=1e-5)
