"""Directional encodings against scipy's spherical harmonics and brute-force integration."""

import numpy as np
import torch
from scipy.special import sph_harm_y

from blender_nep.fields.encodings import encoding_size, integrated_directional_encoding, positional_encoding

PAIRS = [(2**i, m) for i in range(4) for m in range(2**i + 1)]


def harmonics(directions: np.ndarray) -> np.ndarray:
    theta, phi = np.arccos(directions[:, 2].clip(-1, 1)), np.arctan2(directions[:, 1], directions[:, 0])
    y = np.stack([sph_harm_y(degree, order, theta, phi) for degree, order in PAIRS], -1)
    return np.concatenate([y.real, y.imag], -1)


def unit(n: int, seed: int = 0) -> torch.Tensor:
    d = torch.randn(n, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(seed))
    return d / d.norm(dim=-1, keepdim=True)


def test_without_roughness_the_encoding_is_spherical_harmonics():
    d = unit(50)
    encoded = integrated_directional_encoding(d, torch.zeros(50, 1, dtype=torch.float64))
    assert encoded.shape[-1] == encoding_size(4)
    np.testing.assert_allclose(encoded.numpy(), harmonics(d.numpy()), atol=1e-12)


def test_attenuation_is_the_mean_over_a_von_mises_fisher_lobe():
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
    encoded = integrated_directional_encoding(axis, torch.full((1, 1), 1 / kappa, dtype=torch.float64))
    # exp(-l (l + 1) / 2 kappa) is Ref-NeRF's approximation: a few percent at degree 8
    np.testing.assert_allclose(encoded.numpy()[0], harmonics(lobe).mean(0), atol=0.02)


def test_gradient_is_finite_at_the_poles():
    d = torch.tensor([[0.0, 0, 1], [0, 0, -1], [1, 0, 0]], requires_grad=True)
    kappa_inv = torch.zeros(3, 1, requires_grad=True)
    integrated_directional_encoding(d, kappa_inv).sum().backward()
    assert torch.isfinite(d.grad).all() and torch.isfinite(kappa_inv.grad).all()


def test_positional_encoding_shape_and_values():
    x = torch.tensor([[0.5, -1.0, 0.25]], dtype=torch.float64)
    out = positional_encoding(x, 2)
    assert out.shape == (1, 15)
    torch.testing.assert_close(out[0, 3:6], torch.sin(x[0] * torch.pi / 2))
    torch.testing.assert_close(out[0, 12:15], torch.cos(x[0] * torch.pi))
