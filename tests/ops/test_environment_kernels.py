"""The environment's kernels: Numba against torch, both against closed forms and quadrature."""

import math

import numba
import numpy as np
import pytest
import torch

from blender_nep.fields.environment.prefilter import disc_mean
from blender_nep.ops.environment.rendering import EnvironmentVolume, render_environment
from blender_nep.ops.environment.rendering_torch import interpolate
from blender_nep.ops.environment.segments import RaySegments, contract_segments, contracted_length, contracted_radius
from blender_nep.ops.environment.smoothness import add_total_variation_gradient, total_variation
from blender_nep.ops.environment.spherical_grid import arc_tangent
from blender_nep.ops.environment.weights import from_weights, weights_from_center

RADIUS = 2.5
"""The contraction radius. Rays of `random_rays` begin inside and outside it."""
LENGTH = contracted_length(RADIUS)
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


def random_detail(rows: int, seed: int) -> torch.Tensor:
    return torch.randn(rows, 2 * rows, 3, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def render(raw, rays, body="numba", step=0.1, **more):
    jitter, detail = more.pop("jitter", None), more.pop("detail", None)
    if detail is None:
        detail = torch.zeros(2 * raw.shape[1], 4 * raw.shape[1], 3, dtype=raw.dtype)
    volume = EnvironmentVolume(contraction_radius=RADIUS, density_gain=2.0, longest_step=step, **(EXACT | more))
    return render_environment(raw, detail, RaySegments(*rays), volume, jitter=jitter, body=body)


@pytest.mark.parametrize(("gradient_near", "depth_limit"), [(0.0, 0.0), (1.5, 0.0), (1.5, 0.1)])
def test_numba_and_torch_agree(gradient_near, depth_limit):
    rays = random_rays(60, 0)
    jitter = torch.rand(60, generator=torch.Generator().manual_seed(5), dtype=torch.float64)
    weights = torch.randn(60, 5, generator=torch.Generator().manual_seed(6), dtype=torch.float64)
    results = []
    for body in ("numba", "torch"):
        raw, detail = random_grid(6, 8, 1).requires_grad_(), random_detail(16, 2).requires_grad_()
        more = {"jitter": jitter, "gradient_near": gradient_near, "depth_limit": depth_limit, "detail": detail}
        shown = render(raw, rays, body, **more)
        (torch.column_stack(shown) * weights).sum().backward()
        assert detail.grad.abs().max() > 1e-3  # some rays see far shells
        results.append((*(part.detach() for part in shown), raw.grad, detail.grad))
    for ours, reference in zip(*results, strict=True):
        torch.testing.assert_close(ours, reference, rtol=1e-9, atol=1e-11)


@pytest.mark.parametrize("body", ["numba", "torch"])
def test_no_color_detail_is_a_color_detail_of_zeros(body):
    rays, results = random_rays(60, 0), []
    for detail in (torch.zeros(0, 0, 3, dtype=torch.float64), torch.zeros(16, 32, 3, dtype=torch.float64)):
        raw = random_grid(6, 8, 1).requires_grad_()
        shown = render(raw, rays, body, detail=detail)
        sum(part.sum() for part in shown).backward()
        results.append((*(part.detach() for part in shown), raw.grad))
    for without, zeros in zip(*results, strict=True):
        torch.testing.assert_close(without, zeros, rtol=1e-12, atol=1e-14)


def test_gradient_by_finite_differences():
    rays = random_rays(6, 2)
    grids = random_grid(3, 4, 3).requires_grad_(), random_detail(8, 4).requires_grad_()
    assert torch.autograd.gradcheck(
        lambda raw, detail: render(raw, rays, step=0.4, detail=detail), grids, eps=1e-6, atol=1e-7
    )


def test_gradient_does_not_depend_on_the_number_of_threads():
    rays = random_rays(300, 4, torch.float32)
    gradients = []
    threads = numba.get_num_threads()
    try:
        for count in (1, 4):
            numba.set_num_threads(count)
            raw, detail = random_grid(6, 8, 1).float().requires_grad_(), random_detail(16, 2).float().requires_grad_()
            render(raw, rays, detail=detail)[0].sum().backward()
            gradients.append(torch.cat([raw.grad.flatten(), detail.grad.flatten()]))
    finally:
        numba.set_num_threads(threads)
    assert all(torch.equal(gradients[0], other) for other in gradients)


def test_neglecting_little_changes_little():
    raw, rays = random_grid(6, 8, 1) * 3, random_rays(200, 7)
    exact, rough = render(raw, rays)[0], render(raw, rays, transmittance_limit=1e-3, depth_limit=1e-3)[0]
    assert ((exact - rough).abs() / (1 + exact)).max() < 0.02


def along_ray(origin, direction, near, far, steps=40_001):
    """Brute force: (distances |x| from the center [m], contracted lengths [m]) of m short pieces of a ray. Far may be inf.

    The pieces have equal steps of 1 / (1 + t - near), so that they also reach infinity.
    """
    edges = 1 / np.linspace(1, 1 / (1 + far - near), steps).clip(1e-9) - 1 + near
    t, dt = 0.5 * (edges[1:] + edges[:-1]), np.diff(edges)
    distance = np.linalg.norm(origin.numpy() + t[:, None] * direction.numpy(), axis=1)
    return distance, dt / distance * np.minimum(1, RADIUS / distance)


@pytest.mark.parametrize("body", ["numba", "torch"])
def test_uniform_medium_absorbs_by_its_contracted_length(body):
    """Optical depth is density times the contracted length of the segment."""
    origins, directions, near, far = random_rays(40, 8)
    far = torch.where(torch.isinf(far), 9.0, far)
    raw = torch.zeros(4, 6, 12, 4, dtype=torch.float64)
    raw[..., 0], raw[..., 1:] = 0.3, torch.tensor([0.1, -1.0, 2.0])
    radiance, transmittance, _ = render(raw, (origins, directions, near, far), body)
    pieces = [along_ray(*ray)[1].sum() for ray in zip(origins, directions, near.tolist(), far.tolist(), strict=True)]
    expected = torch.exp(-2.0 * math.log1p(math.exp(0.3)) * torch.tensor(pieces, dtype=torch.float64))
    torch.testing.assert_close(transmittance, expected, rtol=1e-6, atol=1e-9)
    torch.testing.assert_close(
        radiance, (1 - expected)[:, None] * torch.tensor([0.1, -1.0, 2.0]).double().exp(), rtol=1e-6, atol=1e-8
    )


@pytest.mark.parametrize("body", ["numba", "torch"])
def test_radial_medium_against_quadrature(body):
    """Raw values linear in the contracted distance are exact on the grid; the emission integral by brute force."""
    shells = torch.linspace(0, LENGTH, 9, dtype=torch.float64)
    raw = torch.zeros(9, 6, 12, 4, dtype=torch.float64)
    raw[..., 0] = (1.5 * shells - 2.0)[:, None, None]
    raw[..., 1:] = (0.4 * shells - 1.0)[:, None, None, None]
    origins, directions, near, far = random_rays(6, 9)
    origins, far = origins * 2, torch.where(torch.isinf(far), 60.0, 4.0 * far)
    radiance, transmittance, _ = render(raw, (origins, directions, near, far), body, step=0.002)
    for i in range(6):
        distance, length = along_ray(origins[i], directions[i], 0.6, float(far[i]))
        distance = distance.clip(1)
        u = np.where(distance <= RADIUS, np.log(distance), math.log(RADIUS) + 1 - RADIUS / distance)
        depth = 2.0 * np.log1p(np.exp(1.5 * u - 2.0)) * length
        before = np.exp(-np.cumsum(depth) + 0.5 * depth)
        assert float(radiance[i, 0]) == pytest.approx(np.sum(before * depth * np.exp(0.4 * u - 1.0)), rel=1e-3)
        assert float(transmittance[i]) == pytest.approx(np.exp(-np.sum(depth)), rel=1e-3)


@pytest.mark.parametrize("body", ["numba", "torch"])
def test_distortion_of_a_fog_before_the_sky_is_its_integral(body):
    """The distortion is the mean distance between two random bits of a ray's light. A fog's light falls exponentially."""
    raw = torch.full((4, 6, 12, 4), 0.3, dtype=torch.float64)
    origins, directions, near, _ = random_rays(20, 15)
    infinity = torch.full_like(near, math.inf)
    found = render(raw, (origins, directions, near, infinity), body, step=0.002).distortion
    length = contract_segments(RaySegments(origins, directions, near, infinity), RADIUS).w_length
    density = 2.0 * math.log1p(math.exp(0.3))
    for i in range(20):
        # the mean distance of two numbers is 2 times the integral of F (1 - F), with F the share that lies before a place
        clear = np.exp(-density * (np.arange(100_000) + 0.5) / 100_000 * float(length[i]))
        expected = 2 * np.mean((1 - clear) * clear) * float(length[i]) / LENGTH
        assert float(found[i]) == pytest.approx(expected, rel=2e-3)


@pytest.mark.parametrize("body", ["numba", "torch"])
def test_the_sky_has_no_parallax_and_a_near_shell_has_all_of_it(body):
    """A bright half sphere of directions: at infinity, all cameras see it in the same directions; nearby, they do not."""
    rows = 32
    origins, directions, near, far = (part[1::3] for part in random_rays(60, 13))
    for shell, radius in ((8, math.inf), (3, float(contracted_radius(torch.tensor(3 * LENGTH / 8), RADIUS)))):
        raw = torch.full((9, rows, 2 * rows, 4), -30.0, dtype=torch.float64)
        raw[shell, ..., 0] = 60.0  # opaque within a small part of the gap between two shells
        raw[:, : rows // 2, :, 1:] = 0.0
        start = near if shell == 8 else torch.full_like(near, 0.01)
        at = origins if shell == 8 else 0.3 * origins
        radiance, *_ = render(raw, (at, directions, start, far), body, step=0.002)
        along = (at * directions).sum(-1)
        t = 1e6 if radius == math.inf else -along + (along**2 - at.square().sum(-1) + radius**2).sqrt()
        height = (at + torch.as_tensor(t, dtype=torch.float64).expand(len(at))[:, None] * directions)[:, 2]
        height = height / (1e6 if radius == math.inf else radius)
        clear = height.abs() > 0.15  # beside the border between the halves, values are interpolated
        assert clear.sum() > 10
        torch.testing.assert_close(radiance[clear, 0] > 0.5, height[clear] > 0)


@pytest.mark.parametrize("body", ["numba", "torch"])
def test_two_segments_compose_to_one(body):
    raw, (origins, directions, near, _) = random_grid(6, 8, 1), random_rays(20, 10)
    middle, infinity = torch.full_like(near, 2.3), torch.full_like(near, math.inf)
    front, through, _ = render(raw, (origins, directions, near, middle), body, step=0.002)
    back, closed, _ = render(raw, (origins, directions, middle, infinity), body, step=0.002)
    whole, *_ = render(raw, (origins, directions, near, infinity), body, step=0.002)
    torch.testing.assert_close(front + through[:, None] * back, whole, rtol=2e-2, atol=1e-3)
    assert (closed == 0).all()


@pytest.mark.parametrize("body", ["numba", "torch"])
def test_empty_segment_is_clear(body):
    origins, directions, near, _ = random_rays(5, 11)
    radiance, transmittance, distortion = render(random_grid(4, 4, 1), (origins, directions, near, near - 0.1), body)
    assert (radiance == 0).all() and (transmittance == 1).all() and (distortion == 0).all()


def test_no_rays():
    none = torch.zeros(0, 3, dtype=torch.float64)
    ends = torch.zeros(0, dtype=torch.float64)
    assert render(random_grid(4, 4, 1), (none, none, ends, ends))[0].shape == (0, 3)


def test_segment_length_is_its_integral():
    origins, directions, near, far = random_rays(10, 12)
    length = contract_segments(RaySegments(origins, directions, near, far), RADIUS).w_length
    for i in range(10):
        pieces = along_ray(origins[i], directions[i], 0.6, float(far[i]), 400_001)[1]
        assert float(length[i]) == pytest.approx(pieces.sum(), rel=1e-4)


def test_contracted_distance_of_a_radial_ray_and_its_inverse():
    radius = torch.tensor([1.0, 1.7, RADIUS, 4.0, 80.0, math.inf], dtype=torch.float64)
    origins, directions = torch.zeros(6, 3).double(), torch.tensor([[0.0, 0.0, 1.0]]).double().expand(6, 3)
    u = contract_segments(RaySegments(origins, directions, torch.ones(6).double(), radius), RADIUS).w_length
    assert float(u[-1]) == pytest.approx(LENGTH, abs=1e-5)
    torch.testing.assert_close(contracted_radius(u, RADIUS)[:-1], radius[:-1], rtol=1e-4, atol=0)
    assert contracted_radius(torch.tensor([LENGTH]), RADIUS).isinf().all()


@pytest.mark.parametrize("body", ["numba", "torch"])
def test_color_detail_multiplies_what_is_far_and_nothing_near(body):
    """Opaque shells of one color: at infinity, the detail multiplies the color of the ray's direction; at 1.5 radii, not."""
    rows = 16
    origins, directions, near, far = (part[1::3] for part in random_rays(60, 14))
    detail = torch.zeros(rows, 2 * rows, 3, dtype=torch.float64)
    detail[: rows // 2] = math.log(3)  # what is above the horizon is three times as bright
    above, clear = directions[:, 2] > 0, directions[:, 2].abs() > 0.15
    raw = torch.zeros(9, rows // 2, rows, 4, dtype=torch.float64)
    raw[..., 0] = -40.0
    sky, *_ = render(raw, (origins, directions, near, far), body, detail=detail)
    expected = torch.where(above, 3.0, 1.0).double()
    torch.testing.assert_close(sky[clear, 0], expected[clear], rtol=1e-9, atol=0)
    raw[1:3, ..., 0] = 60.0
    inside = 0.1 * torch.nn.functional.normalize(origins, dim=-1)
    wall, *_ = render(raw, (inside, directions, 0 * near + 0.95, far), body, step=0.01, detail=detail)
    torch.testing.assert_close(wall, torch.ones_like(wall), rtol=1e-6, atol=0)


def test_what_is_not_a_number_has_no_value_and_ends_nothing():
    points = torch.tensor([[0.1, 0.2, 0.3], [0.1, math.nan, 0.3], [0.1, 0.2, 0.3]], dtype=torch.float64)
    found = interpolate(random_grid(4, 8, 1), points, torch.tensor([math.nan, 1.0, 1.0], dtype=torch.float64))
    assert found[:2].isnan().all() and found[2].isfinite().all()


@numba.njit(fastmath=True, error_model="numpy")  # as the kernels
def arc_tangents(y, x, angles):
    for i in range(len(angles)):
        angles[i] = arc_tangent(y[i], x[i])


def test_arc_tangent_is_that_of_the_library():
    y, x = np.random.default_rng(0).standard_normal((2, 100_000))
    ends = np.array([(a, b) for a in (-1, 0, 1e-300, 1, 1e300) for b in (-1, 0, 1e-300, 1, 1e300)])
    y, x = np.concatenate([y, ends[:, 0]]), np.concatenate([x, ends[:, 1]])
    angles = np.empty_like(x)
    arc_tangents(y, x, angles)
    np.testing.assert_allclose(angles, np.arctan2(y, x), rtol=0, atol=1e-14)


def test_interpolation_is_smooth_over_pole_and_seam():
    """z is smooth on the sphere: a cell-centered grid of it interpolates to z everywhere, also across pole and seam."""
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
    torch.testing.assert_close(interpolate(raw, points * 3, torch.full_like(points[:, 0], 1.3)), points, rtol=0, atol=2e-3)


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


def test_weights_from_the_center_are_what_rays_from_there_see():
    raw, rows = random_grid(7, 8, 1).float(), 16
    weights = weights_from_center(raw, torch.ones(7, 8, 16), 2.0, LENGTH / 6, rows)
    torch.testing.assert_close(weights[..., 3].sum(0), torch.ones(rows, 2 * rows))
    torch.testing.assert_close(weights[..., 4], weights[..., 3])
    theta = (torch.arange(rows) + 0.5) * math.pi / rows
    phi = (torch.arange(2 * rows) + 0.5) * math.pi / rows - math.pi
    theta, phi = torch.meshgrid(theta, phi, indexing="ij")
    directions = torch.stack([theta.sin() * phi.cos(), theta.sin() * phi.sin(), theta.cos()], -1).reshape(-1, 3)
    n = len(directions)
    # along a ray just beside the center, from the border outwards
    origins = 1e-3 * torch.linalg.cross(directions, torch.tensor([[0.36, 0.48, 0.8]]).expand(n, 3))
    radiance, *_ = render(raw, (origins, directions, torch.ones(n), torch.full((n,), math.inf)), step=0.01)
    seen = weights[..., :3].sum(0).reshape(-1, 3)
    assert ((seen - radiance).abs() / radiance).mean() < 0.02


def test_variation_bodies_agree_and_a_step_costs_its_height():
    grid = random_grid(6, 4, 1).requires_grad_()
    expected = total_variation(grid, (1.0, 0.5, 0.2, 0.0), 0.05)
    expected.backward()
    side_by_side = torch.full((6, 4, 8, 4), 3.0, dtype=torch.float64)
    apart = torch.full((6, 4, 4, 8), 3.0, dtype=torch.float64).transpose(2, 3)
    for gradient in (side_by_side, apart):
        value = add_total_variation_gradient(random_grid(6, 4, 1), (1.0, 0.5, 0.2, 0.0), 0.05, gradient)
        torch.testing.assert_close(value, expected.detach(), rtol=1e-9, atol=1e-12)
        torch.testing.assert_close(gradient, 3 + grid.grad, rtol=1e-9, atol=1e-12)
    step = torch.zeros(4, 8, 16, 1, dtype=torch.float64)
    step[2:] = 3.0
    for value in (total_variation(step, (1.0,), 1e-9), add_total_variation_gradient(step, (1.0,), 1e-9, step.clone())):
        assert float(value) == pytest.approx(3.0 / 3)
