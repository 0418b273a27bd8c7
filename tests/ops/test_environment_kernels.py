"""The environment's kernels: Numba against torch, both against closed forms and quadrature."""

import math

import numba
import numpy as np
import pytest
import torch

from blender_nep.fields.environment_prefilter import disc_mean
from blender_nep.ops.environment_rendering import EnvironmentVolume, render_environment
from blender_nep.ops.environment_rendering_torch import interpolate
from blender_nep.ops.environment_segments import RaySegments, scale_invariant_segments
from blender_nep.ops.environment_smoothness import total_variation
from blender_nep.ops.environment_weights import from_weights, weights_from_centre

OUTER = 20.0
EXACT = {"transmittance_limit": 0.0, "depth_limit": 0.0}


def random_rays(n: int, seed: int, dtype=torch.float64) -> tuple[torch.Tensor, ...]:
    """Rays from points 1.2 to 4 away, in all directions; a third of the segments end, the others do not."""
    generator = torch.Generator().manual_seed(seed)

    def normal(*shape):
        return torch.randn(*shape, generator=generator, dtype=dtype)

    origins = torch.nn.functional.normalize(normal(n, 3), dim=-1)
    origins = origins * (1.2 + 2.8 * torch.rand(n, 1, generator=generator, dtype=dtype))
    directions = torch.nn.functional.normalize(normal(n, 3), dim=-1)
    near = torch.full((n,), 0.6, dtype=dtype)
    far = torch.full((n,), math.inf, dtype=dtype)
    far[::3] = 0.7 + 2 * torch.rand(len(far[::3]), generator=generator, dtype=dtype)
    return origins, directions, near, far


def random_grid(shells: int, rows: int, seed: int) -> torch.Tensor:
    generator = torch.Generator().manual_seed(seed)
    return torch.randn(shells, rows, 2 * rows, 4, generator=generator, dtype=torch.float64) - 1


def render(raw, rays, body="numba", step=0.1, **more):
    jitter = more.pop("jitter", None)
    volume = EnvironmentVolume(outer_radius=OUTER, density_gain=2.0, relative_step=step, **(EXACT | more))
    return render_environment(raw, RaySegments(*rays), volume, jitter=jitter, body=body)


@pytest.mark.parametrize("gradient_near", [0.0, 1.5])
def test_numba_and_torch_agree(gradient_near):
    rays = random_rays(60, 0)
    jitter = torch.rand(60, generator=torch.Generator().manual_seed(5), dtype=torch.float64)
    weights = torch.randn(60, 4, generator=torch.Generator().manual_seed(6), dtype=torch.float64)
    results = []
    for body in ("numba", "torch"):
        raw = random_grid(6, 8, 1).requires_grad_()
        radiance, transmittance = render(raw, rays, body, jitter=jitter, gradient_near=gradient_near)
        (radiance * weights[:, :3]).sum().add((transmittance * weights[:, 3]).sum()).backward()
        results.append((radiance.detach(), transmittance.detach(), raw.grad))
    for ours, reference in zip(*results, strict=True):
        torch.testing.assert_close(ours, reference, rtol=1e-9, atol=1e-11)


def test_gradient_by_finite_differences():
    rays = random_rays(6, 2)
    raw = random_grid(3, 4, 3).requires_grad_()
    assert torch.autograd.gradcheck(lambda grid: render(grid, rays, step=0.4), (raw,), eps=1e-6, atol=1e-7)


def test_gradient_does_not_depend_on_the_number_of_threads():
    rays = random_rays(300, 4, torch.float32)
    gradients = []
    threads = numba.get_num_threads()
    try:
        for count in {1, threads}:
            numba.set_num_threads(count)
            raw = random_grid(6, 8, 1).float().requires_grad_()
            render(raw, rays)[0].sum().backward()
            gradients.append(raw.grad)
    finally:
        numba.set_num_threads(threads)
    assert all(torch.equal(gradients[0], other) for other in gradients)


def test_neglecting_little_changes_little():
    raw, rays = random_grid(6, 8, 1) * 3, random_rays(200, 7)
    exact, rough = render(raw, rays)[0], render(raw, rays, transmittance_limit=1e-3, depth_limit=1e-5)[0]
    assert ((exact - rough).abs() / (1 + exact)).max() < 0.02


@pytest.mark.parametrize("body", ["numba", "torch"])
def test_uniform_medium_has_its_closed_form(body):
    """Density sigma / |x|: optical depth sigma (asinh(t1 / b) - asinh(t0 / b)), t measured from the closest point."""
    origins, directions, near, far = random_rays(40, 8)
    far = torch.where(torch.isinf(far), 3.0, far)
    raw = torch.zeros(4, 6, 12, 4, dtype=torch.float64)
    raw[..., 0], raw[..., 1:] = 0.3, torch.tensor([0.1, -1.0, 2.0])
    radiance, transmittance = render(raw, (origins, directions, near, far), body)
    along = (origins * directions).sum(-1)
    b = (origins - along[:, None] * directions).norm(dim=-1)
    length = torch.asinh((far + along) / b) - torch.asinh((near + along) / b)
    expected = torch.exp(-2.0 * math.log1p(math.exp(0.3)) * length)
    torch.testing.assert_close(transmittance, expected, rtol=1e-9, atol=1e-12)
    torch.testing.assert_close(
        radiance, (1 - expected)[:, None] * torch.tensor([0.1, -1.0, 2.0]).double().exp(), rtol=1e-7, atol=1e-9
    )


def test_radial_medium_against_quadrature():
    """Raw values linear in log |x| are exact on the grid; the emission integral by brute force, in plain distances."""
    shells = torch.linspace(0, math.log(OUTER), 9, dtype=torch.float64)
    raw = torch.zeros(9, 6, 12, 4, dtype=torch.float64)
    raw[..., 0] = (1.5 * shells - 2.0)[:, None, None]
    raw[..., 1:] = (0.4 * shells - 1.0)[:, None, None, None]
    origins, directions, near, far = random_rays(5, 9)
    origins, far = origins * 2, torch.full_like(far, 4.0)
    radiance, transmittance = render(raw, (origins, directions, near, far), step=0.002)
    edges = np.linspace(0.6, 4.0, 40_001)
    t, dt = 0.5 * (edges[1:] + edges[:-1]), edges[1] - edges[0]
    for i in range(5):
        distance = np.linalg.norm(origins[i].numpy() + t[:, None] * directions[i].numpy(), axis=1).clip(1)
        density = 2.0 * np.log1p(np.exp(1.5 * np.log(distance) - 2.0)) / distance
        before = np.exp(-np.cumsum(density * dt) + 0.5 * density * dt)
        assert float(radiance[i, 0]) == pytest.approx(
            np.sum(before * density * dt * np.exp(0.4 * np.log(distance) - 1.0)), rel=1e-3
        )
        assert float(transmittance[i]) == pytest.approx(np.exp(-np.sum(density * dt)), rel=1e-3)


@pytest.mark.parametrize("body", ["numba", "torch"])
def test_two_segments_compose_to_one(body):
    raw, (origins, directions, near, _) = random_grid(6, 8, 1), random_rays(20, 10)
    middle, infinity = torch.full_like(near, 2.3), torch.full_like(near, math.inf)
    front, through = render(raw, (origins, directions, near, middle), body, step=0.002)
    back, closed = render(raw, (origins, directions, middle, infinity), body, step=0.002)
    whole, _ = render(raw, (origins, directions, near, infinity), body, step=0.002)
    torch.testing.assert_close(front + through[:, None] * back, whole, rtol=2e-2, atol=1e-3)
    assert (closed == 0).all()


@pytest.mark.parametrize("body", ["numba", "torch"])
def test_empty_segment_is_clear(body):
    origins, directions, near, _ = random_rays(5, 11)
    radiance, transmittance = render(random_grid(4, 4, 1), (origins, directions, near, near - 0.1), body)
    assert (radiance == 0).all() and (transmittance == 1).all()


def test_no_rays():
    none = torch.zeros(0, 3, dtype=torch.float64)
    ends = torch.zeros(0, dtype=torch.float64)
    assert render(random_grid(4, 4, 1), (none, none, ends, ends))[0].shape == (0, 3)


def test_segment_length_is_the_integral_of_dt_over_distance():
    origins, directions, near, far = random_rays(10, 12)
    length = scale_invariant_segments(RaySegments(origins, directions, near, far), OUTER).s_length
    for i in range(10):
        along = float((origins[i] * directions[i]).sum())
        leave = -along + math.sqrt(along**2 - float(origins[i].square().sum()) + OUTER**2)
        end = min(float(far[i]), leave)
        edges = np.linspace(0.6, end, 200_001)
        t = 0.5 * (edges[1:] + edges[:-1])
        distance = np.linalg.norm(origins[i].numpy() + t[:, None] * directions[i].numpy(), axis=1)
        assert float(length[i]) == pytest.approx(np.sum((end - 0.6) / len(t) / distance), rel=1e-4)


def test_interpolation_is_smooth_over_pole_and_seam():
    """z is smooth on the sphere: a cell-centred grid of it interpolates to z everywhere, also across pole and seam."""
    rows = 64
    theta = (torch.arange(rows).double() + 0.5) * math.pi / rows
    phi = (torch.arange(2 * rows).double() + 0.5) * math.pi / rows - math.pi
    theta, phi = torch.meshgrid(theta, phi, indexing="ij")
    node = torch.stack([theta.sin() * phi.cos(), theta.sin() * phi.sin(), theta.cos()], -1)
    raw = node[None].repeat(3, 1, 1, 1)
    generator = torch.Generator().manual_seed(0)
    points = torch.randn(2000, 3, generator=generator, dtype=torch.float64)
    points[:200, :2] *= 0.01
    points[200:400, 0], points[200:400, 1] = -1.0, points[200:400, 1] * 0.01
    points = torch.nn.functional.normalize(points, dim=-1)
    torch.testing.assert_close(interpolate(raw, points * 3, math.log(OUTER)), points, rtol=0, atol=2e-3)


@pytest.mark.parametrize("degrees", [5.0, 20.0, 60.0, 90.0])
def test_disc_mean_of_a_cosine(degrees):
    """The mean of a direction over a spherical cap of half angle a about d is d (1 + cos a) / 2, also at the poles."""
    rows, a = 48, math.radians(degrees)
    theta = ((torch.arange(rows).double() + 0.5) * math.pi / rows)[:, None]
    phi = ((torch.arange(2 * rows).double() + 0.5) * math.pi / rows)[None]
    z, x = theta.cos().expand(rows, 2 * rows), theta.sin() * phi.cos()
    values = torch.stack([z, x, torch.ones_like(z)], -1)[None]
    mean = disc_mean(values, a)
    expected = values * torch.tensor([(1 + math.cos(a)) / 2] * 2 + [1.0])
    torch.testing.assert_close(mean, expected.to(mean), rtol=0, atol=6e-3)


def test_weights_and_opacities_are_each_others_inverse():
    generator = torch.Generator().manual_seed(0)
    opacity = torch.rand(8, 3, 4, 1, generator=generator) * 0.7
    opacity[-1] = 1
    nodes = torch.cat(
        [torch.rand(8, 3, 4, 3, generator=generator), torch.ones(8, 3, 4, 1), torch.rand(8, 3, 4, 1, generator=generator)],
        -1,
    )
    clear = torch.cumprod(1 - opacity, 0)
    weights = opacity * torch.cat([torch.ones_like(clear[:1]), clear[:-1]])
    back = torch.from_numpy(from_weights(weights * nodes)).permute(2, 0, 1, 3)
    torch.testing.assert_close(back, opacity * nodes, rtol=2e-3, atol=1e-4)


def test_nothing_left_to_see_is_opaque_and_keeps_its_color():
    weighted = torch.zeros(4, 1, 1, 5)
    weighted[1] = torch.tensor([2.0, 3.0, 4.0, 1.0, 0.5])
    out = torch.from_numpy(from_weights(weighted))[0, 0]
    assert (out[0] == 0).all()
    torch.testing.assert_close(out[1:], weighted[1, 0, 0].expand(3, 5))


def test_weights_from_the_centre_are_what_rays_from_there_see():
    raw, rows = random_grid(7, 8, 1).float(), 16
    weights = weights_from_centre(raw, torch.ones(7, 8, 16), 2.0, math.log(OUTER) / 6, rows)
    torch.testing.assert_close(weights[..., 3].sum(0), torch.ones(rows, 2 * rows))
    torch.testing.assert_close(weights[..., 4], weights[..., 3])
    theta = (torch.arange(rows) + 0.5) * math.pi / rows
    phi = (torch.arange(2 * rows) + 0.5) * math.pi / rows - math.pi
    theta, phi = torch.meshgrid(theta, phi, indexing="ij")
    directions = torch.stack([theta.sin() * phi.cos(), theta.sin() * phi.sin(), theta.cos()], -1).reshape(-1, 3)
    n = len(directions)
    # along a ray just beside the centre, from the border outwards
    origins = 1e-3 * torch.linalg.cross(directions, torch.tensor([[0.36, 0.48, 0.8]]).expand(n, 3))
    radiance, _ = render(raw, (origins, directions, torch.ones(n), torch.full((n,), math.inf)), step=0.01)
    seen = weights[..., :3].sum(0).reshape(-1, 3)
    assert ((seen - radiance).abs() / radiance).mean() < 0.02


def test_variation_bodies_agree_and_a_step_costs_its_height():
    results = []
    for body in ("numba", "torch"):
        grid = random_grid(6, 4, 1).requires_grad_()
        value = total_variation(grid, (1.0, 0.5, 0.2, 0.0), 0.05, body)
        (2 * value).backward()
        results.append((value.detach(), grid.grad))
    for ours, reference in zip(*results, strict=True):
        torch.testing.assert_close(ours, reference, rtol=1e-9, atol=1e-12)
    step = torch.zeros(4, 8, 16, 1, dtype=torch.float64)
    step[2:] = 3.0
    assert float(total_variation(step, (1.0,), 1e-9)) == pytest.approx(3.0 / 3)
