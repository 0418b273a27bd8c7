"""The BRDF against quadrature, and its samplers against their densities."""

import math

import numpy as np
import pytest
import torch
from scipy import stats

from blender_nep.shading import brdf


def hemisphere(side=400, dtype=torch.float64):
    """Midpoint grid in (cos, phi): directions [m,3] and the solid angle of a cell."""
    z = (torch.arange(side, dtype=dtype) + 0.5) / side
    phi = (torch.arange(side, dtype=dtype) + 0.5) / side * 2 * math.pi
    z, phi = torch.meshgrid(z, phi, indexing="ij")
    s = (1 - z * z).sqrt()
    return torch.stack([s * phi.cos(), s * phi.sin(), z], -1).reshape(-1, 3), 2 * math.pi / side**2


def view(cosine):
    return torch.tensor([math.sqrt(1 - cosine**2), 0.0, cosine], dtype=torch.float64)


@pytest.mark.parametrize("cosine", [0.3, 0.9])
@pytest.mark.parametrize("roughness", [0.3, 0.6, 1.0])
def test_white_furnace(roughness, cosine):
    to_light, cell = hemisphere()
    v = view(cosine).expand_as(to_light)
    r = torch.full((len(to_light),), roughness, dtype=torch.float64)
    for metallic in (0.0, 1.0):
        f = brdf.evaluate(v, to_light, torch.ones_like(to_light), r, torch.full_like(r, metallic))
        total = (f[:, 0] * to_light[:, 2]).sum() * cell
        assert total.item() == pytest.approx(1, abs=0.01), (roughness, cosine, metallic)


@pytest.mark.parametrize("roughness", [0.02, 0.05, 0.1, 0.3, 1.0])
def test_white_furnace_by_each_lobes_own_samples(roughness):
    generator = torch.Generator().manual_seed(0)
    u = torch.rand(200_000, 2, generator=generator, dtype=torch.float64)
    v = view(0.9).expand(len(u), 3)
    r = torch.tensor(roughness, dtype=torch.float64)
    h, pdf = brdf.sample_vndf(v, brdf.alpha_of(r).expand(len(u)), u)
    to_light = brdf.reflect(v, h)
    lobe = brdf.specular(v[:, 2], to_light[:, 2], h[:, 2], brdf.alpha_of(r))
    single = (lobe * to_light[:, 2].clamp_min(0) / pdf).mean()
    assert (single * brdf.multiscatter_scale(1.0, v[0, 2], r)).item() == pytest.approx(1, abs=0.01)


def test_dielectric_and_schlick_fresnel():
    c = torch.tensor([1.0, 0.5, 0.0], dtype=torch.float64)
    f = brdf.dielectric_fresnel(c)
    assert f[0].item() == pytest.approx(0.04, abs=1e-6) and f[2].item() == pytest.approx(1, abs=1e-6)
    sin_t = math.sqrt(0.75) / 1.5
    cos_t = math.sqrt(1 - sin_t**2)
    rs = ((0.5 - 1.5 * cos_t) / (0.5 + 1.5 * cos_t)) ** 2
    rp = ((1.5 * 0.5 - cos_t) / (1.5 * 0.5 + cos_t)) ** 2
    assert f[1].item() == pytest.approx((rs + rp) / 2, abs=1e-9)
    assert brdf.schlick_weight(c).tolist() == pytest.approx([0, 0.5**5, 1])
    mu = torch.linspace(0, 1, 20001, dtype=torch.float64)
    mean = torch.trapezoid(2 * mu * brdf.dielectric_fresnel(mu), mu)
    assert brdf.DIELECTRIC_FSS == pytest.approx(mean.item(), abs=0.004)


@pytest.mark.parametrize("roughness", [0.1, 0.4, 1.0])
def test_projected_microfacet_area_is_one(roughness):
    theta = torch.linspace(0, math.pi / 2, 200_001, dtype=torch.float64)
    d = brdf.ggx_d(theta.cos(), brdf.alpha_of(torch.tensor(roughness, dtype=torch.float64)))
    area = torch.trapezoid(d * theta.cos() * 2 * math.pi * theta.sin(), theta)
    assert area.item() == pytest.approx(1, abs=1e-4)


def chi_square(samples, pdf_at, cells=(16, 32), fine=12):
    """p-value of the samples [n,3] against a density over the upper hemisphere (after Mitsuba's chi2 test)."""
    n = len(samples)
    z, phi = samples[:, 2].numpy(), np.mod(np.arctan2(samples[:, 1].numpy(), samples[:, 0].numpy()), 2 * np.pi)
    above = z > 0
    observed = np.histogram2d(z[above], phi[above], cells, [[0, 1], [0, 2 * np.pi]])[0].ravel()
    a = (torch.arange(cells[0] * fine, dtype=torch.float64) + 0.5) / (cells[0] * fine)
    b = (torch.arange(cells[1] * fine, dtype=torch.float64) + 0.5) / (cells[1] * fine) * 2 * math.pi
    a, b = torch.meshgrid(a, b, indexing="ij")
    s = (1 - a * a).sqrt()
    density = pdf_at(torch.stack([s * b.cos(), s * b.sin(), a], -1).reshape(-1, 3)).reshape(a.shape)
    expected = density.reshape(cells[0], fine, cells[1], fine).sum((1, 3)).numpy().ravel()
    expected *= n * 2 * np.pi / (density.numel())
    # Pool the cells in which too little is expected.
    order = np.argsort(expected)
    observed, expected = observed[order], expected[order]
    pooled = np.searchsorted(np.cumsum(expected), 20) + 1
    observed = np.append(observed[pooled:], observed[:pooled].sum())
    expected = np.append(expected[pooled:], expected[:pooled].sum())
    statistic = ((observed - expected) ** 2 / expected).sum()
    return stats.chi2.sf(statistic, len(expected) - 1), expected.sum() / n


def test_cosine_sampler_chi_square():
    u = torch.rand(200_000, 2, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    to_light, pdf = brdf.sample_cosine(u)
    assert torch.allclose(pdf, to_light[:, 2] / math.pi)
    assert chi_square(to_light, lambda d: d[:, 2] / math.pi)[0] > 0.001


@pytest.mark.parametrize("roughness", [0.3, 0.6, 1.0])
@pytest.mark.parametrize("cosine", [0.2, 0.6, 1.0])
def test_vndf_sampler_chi_square(roughness, cosine):
    u = torch.rand(200_000, 2, generator=torch.Generator().manual_seed(2), dtype=torch.float64)
    alpha = brdf.alpha_of(torch.tensor(roughness, dtype=torch.float64))
    v = view(cosine)
    h, pdf = brdf.sample_vndf(v.expand(len(u), 3), alpha.expand(len(u)), u)

    def density(d):
        half = torch.nn.functional.normalize(d + v, dim=-1)
        return brdf.vndf_pdf(v[2], half[:, 2], alpha)

    to_light = brdf.reflect(v.expand(len(u), 3), h)
    assert torch.allclose(pdf, density(to_light), rtol=1e-4)
    p, mass = chi_square(to_light, density)
    assert p > 0.001
    assert mass == pytest.approx((to_light[:, 2] > 0).double().mean().item(), abs=0.01)


def test_brdf_is_reciprocal_but_for_the_albedo_scaling():
    generator = torch.Generator().manual_seed(3)
    v, to_light = brdf.sample_cosine(torch.rand(2, 500, 2, generator=generator, dtype=torch.float64))[0]
    h = torch.nn.functional.normalize(v + to_light, dim=-1)
    alpha = torch.full((500,), 0.2, dtype=torch.float64)
    there = brdf.specular(v[:, 2], to_light[:, 2], h[:, 2], alpha)
    assert torch.allclose(there, brdf.specular(to_light[:, 2], v[:, 2], h[:, 2], alpha))


def test_extremes_stay_finite_with_gradients():
    to_light, _ = hemisphere(16, torch.float32)
    to_light = torch.cat([to_light, torch.tensor([[1.0, 0, 0], [0, 0, 1.0]])])
    for cosine in (1.0, 1e-4):
        v = view(cosine).float().expand_as(to_light)
        for roughness in (0.0, 0.02, 1.0):
            for metallic in (0.0, 1.0):
                for albedo in (0.0, 1.0):
                    a = torch.full_like(to_light, albedo, requires_grad=True)
                    r = torch.full((len(to_light),), roughness, requires_grad=True)
                    m = torch.full((len(to_light),), metallic, requires_grad=True)
                    (brdf.evaluate(v, to_light, a, r, m) * 1e4).sum().backward()
                    assert all(torch.isfinite(x.grad).all() for x in (a, r, m))


def test_the_albedo_of_one_roughness_is_that_of_each_of_many():
    """One roughness for all directions has a lookup of its own."""
    cosine = torch.linspace(0, 1, 50, dtype=torch.float64)
    for r in (0.0, 0.03, 0.37, 1.0):
        one = torch.tensor([r], dtype=torch.float64, requires_grad=True)
        many = torch.full_like(cosine, r, requires_grad=True)
        for albedo in (brdf.specular_albedo, brdf.dielectric_albedo):
            torch.testing.assert_close(albedo(cosine, one), albedo(cosine, many))
            (of_one,), (of_many,) = (torch.autograd.grad(albedo(cosine, x).sum(), x) for x in (one, many))
            torch.testing.assert_close(of_one[0], of_many.sum())


def test_frames_are_orthonormal():
    n = torch.nn.functional.normalize(torch.randn(100, 3, generator=torch.Generator().manual_seed(4)), dim=-1)
    n = torch.cat([n, torch.tensor([[0, 0, -1.0], [0, 0, 1.0]])])
    f = brdf.frame(n)
    assert torch.allclose(f.transpose(-1, -2) @ f, torch.eye(3).expand(len(n), 3, 3), atol=1e-5)
    assert torch.allclose(f[..., 2], n) and torch.allclose(torch.linalg.det(f), torch.ones(len(n)), atol=1e-5)
