"""Cones against closed forms and brute force."""

import math

import pytest
import torch

from blender_nep.shading import brdf, cones


@pytest.mark.parametrize("roughness", [0.05, 0.3, 0.7, 1.0])
def test_half_vector_angle_holds_its_share(roughness):
    r = torch.tensor(roughness, dtype=torch.float64)
    theta = cones.half_vector_angle(r, 0.9)
    # Brute force: the share of the projected microfacet area within theta.
    x = torch.linspace(0, 1, 400_001, dtype=torch.float64) * theta
    density = brdf.ggx_d(x.cos(), brdf.alpha_of(r)) * x.cos() * x.sin() * 2 * math.pi
    assert torch.trapezoid(density, x).item() == pytest.approx(0.9, abs=1e-4)


def test_lobe_angles_grow_to_a_hemisphere_and_stay_there():
    angle = cones.lobe_half_angle(torch.linspace(0.02, 1, 200))
    assert (angle.diff() >= 0).all() and angle[-1].item() == pytest.approx(math.pi / 2)
    assert torch.isfinite(angle).all() and angle[0] > 0


@pytest.mark.parametrize("roughness", [0.1, 0.2, 0.3])
def test_lobe_holds_its_share_of_reflected_energy(roughness):
    v = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64)
    u = torch.rand(200_000, 2, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    r = torch.tensor(roughness, dtype=torch.float64)
    h, _ = brdf.sample_vndf(v.expand(len(u), 3), brdf.alpha_of(r).expand(len(u)), u)
    inside = brdf.reflect(v.expand(len(u), 3), h)[:, 2] > cones.lobe_half_angle(r).cos()
    assert inside.double().mean().item() == pytest.approx(0.9, abs=0.01)


def test_solid_angles_invert():
    angle = torch.tensor([1e-4, 0.1, 1.0, math.pi / 2, math.pi], dtype=torch.float64)
    assert torch.allclose(cones.half_angle_of(cones.solid_angle(angle)), angle)
    assert cones.solid_angle(angle)[3].item() == pytest.approx(2 * math.pi)


class Lobes:
    """Radiance exp(k (d.a - 1)), and its mean over cones by quadrature."""

    axis = torch.nn.functional.normalize(torch.tensor([0.5, 0.2, 0.8], dtype=torch.float64), dim=0)
    sharpness = 6.0

    def __call__(self, d):
        return torch.exp(self.sharpness * ((d * self.axis).sum(-1) - 1))

    def cone(self, d, half_angle):
        side = 12
        ring = (torch.arange(side, dtype=d.dtype) + 0.5) / side
        turn = ring * 2 * math.pi
        z = 1 - ring[:, None] * (1 - half_angle.cos())[..., None, None]
        s = (1 - z * z).clamp_min(0).sqrt()
        local = torch.stack([s * turn.cos(), s * turn.sin(), z.expand(*s.shape[:-1], side)], -1)
        f = brdf.frame(d)
        return self(torch.einsum("...ij,...abj->...abi", f, local)).mean((-1, -2))


@pytest.mark.parametrize("roughness", [0.15, 0.3, 0.5, 0.8, 1.0])
def test_four_cones_match_many_rays(roughness):
    light = Lobes()
    generator = torch.Generator().manual_seed(1)
    turn = torch.rand(400, 2, generator=generator, dtype=torch.float64)
    v = torch.nn.functional.normalize(torch.tensor([-0.4, 0.1, 0.9], dtype=torch.float64), dim=0)
    r = torch.full((400,), roughness, dtype=torch.float64)
    to_light, weight, _, angle = cones.specular_cones(v.expand(400, 3), r, 4, turn)
    by_cones = (weight * light.cone(to_light, angle)).sum(-1)
    to_light, weight, _, _ = cones.specular_cones(v.expand(400, 3), r, 128, turn)
    by_rays = (weight * light(to_light)).sum(-1)
    truth = by_rays.mean()
    assert by_cones.mean().item() == pytest.approx(truth.item(), rel=0.08)
    four_rays = cones.specular_cones(v.expand(400, 3), r, 4, turn)
    noisy = (four_rays[1] * light(four_rays[0])).sum(-1)
    assert by_cones.std() < noisy.std()


def test_eight_diffuse_cones_match_the_irradiance():
    light = Lobes()
    turn = torch.rand(400, 2, generator=torch.Generator().manual_seed(2), dtype=torch.float64)
    to_light, angle = cones.diffuse_cones(8, turn)
    by_cones = light.cone(to_light, angle).mean(-1)
    u = torch.rand(400_000, 2, generator=torch.Generator().manual_seed(3), dtype=torch.float64)
    dense, _ = brdf.sample_cosine(u)
    truth = light(dense).mean().item()
    assert by_cones.mean().item() == pytest.approx(truth, rel=0.1)
    assert by_cones.std() < light(to_light).mean(-1).std()


def test_specular_weights_sum_to_the_albedo():
    for roughness in (0.1, 0.5, 1.0):
        turn = torch.rand(4000, 2, generator=torch.Generator().manual_seed(5), dtype=torch.float64)
        v = torch.nn.functional.normalize(torch.tensor([0.8, 0.0, 0.6], dtype=torch.float64), dim=0)
        r = torch.full((4000,), roughness, dtype=torch.float64)
        weight = cones.specular_cones(v.expand(4000, 3), r, 4, turn)[1].sum(-1).mean()
        assert weight.item() == pytest.approx(brdf.specular_albedo(v[2], r[0]).item(), abs=0.01)
