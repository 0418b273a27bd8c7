"""The environment field as its users see it: cones against brute force, orientation, coverage, saving, learning."""

import dataclasses
import math
from types import SimpleNamespace

import pytest
import torch

from blender_nep.capture.rays.ray_bundle import RayBundle
from blender_nep.checkpoints import NoCheckpoint
from blender_nep.errors import LearningError
from blender_nep.fields.environment.field import EnvironmentField
from blender_nep.fields.environment.grid import resample
from blender_nep.fields.environment.training import learn_environment, learn_step, optimizer, refine, skipped_detail
from blender_nep.ops.environment.segments import contracted_length
from blender_nep.ops.environment.smoothness import total_variation
from blender_nep.presets import EnvironmentPreset
from blender_nep.tone_mapping import tone_map

PRESET = EnvironmentPreset(resolutions=((24, 32), (28, 48)), refine_at=(0.5,), contraction_radius=20.0)


def box_field(size: float = 6.0) -> EnvironmentField:
    """The inside of a cube |x|, |y|, |z| <= size as a field: smooth colored walls with a bright window."""
    field = EnvironmentField(PRESET)
    shells, rows = field.raw.shape[:2]
    length = contracted_length(PRESET.contraction_radius)
    at_shell = torch.linspace(0, length, shells)[:, None, None, None]
    theta = (torch.arange(rows) + 0.5) * math.pi / rows
    phi = (torch.arange(2 * rows) + 0.5) * math.pi / rows - math.pi
    theta, phi = torch.meshgrid(theta, phi, indexing="ij")
    direction = torch.stack([theta.sin() * phi.cos(), theta.sin() * phi.sin(), theta.cos()], -1)
    wall = size / direction.abs().amax(-1)
    at = direction * wall[..., None]
    color = 0.5 + 0.4 * torch.sin(at * torch.tensor([0.7, 0.5, 0.9]))
    color = color + 8.0 * ((at[..., :1] > 0.99 * size) & (at[..., 1:].abs().amax(-1, keepdim=True) < 2.5))
    with torch.no_grad():
        inside = (wall[None, ..., None].log() - at_shell) / length * (shells - 1)
        field.raw[..., :1] = (-10 * inside).clamp(-12, 4)
        field.raw[..., 1:] = color.log()
    field.coverage.fill_(1)
    return field


def random_directions(n: int, seed: int) -> torch.Tensor:
    return torch.nn.functional.normalize(torch.randn(n, 3, generator=torch.Generator().manual_seed(seed)), dim=-1)


def from_border(origins: torch.Tensor, directions: torch.Tensor) -> torch.Tensor:
    along = (origins * directions).sum(-1)
    return -along + (along**2 - origins.square().sum(-1) + 1).sqrt()


def brute_force(field, origin, direction, half_angle, count=2000):
    """The mean of many narrow rays on a spiral that is uniform in the cone's solid angle."""
    k = torch.arange(count)[:, None] + 0.5
    cosine = 1 - k / count * (1 - math.cos(half_angle))
    turn = math.pi * (1 + math.sqrt(5)) * k
    a = torch.nn.functional.normalize(torch.linalg.cross(direction, torch.tensor([0.3, 0.5, 0.8])), dim=0)
    b = torch.linalg.cross(direction, a)
    rays = cosine * direction + (1 - cosine**2).sqrt() * (turn.cos() * a + turn.sin() * b)
    origins = origin.expand(count, 3)
    with torch.no_grad():
        radiance, *_ = field.render(origins, rays, from_border(origins, rays), torch.full((count,), math.inf))
    return radiance.mean(0)


@pytest.fixture(scope="module")
def room():
    return box_field()


@pytest.mark.parametrize("degrees", [0.3, 5.0, 12.0, 17.0, 30.0, 50.0, 60.0])
@pytest.mark.parametrize("distance", [0.0, 0.8])
def test_cones_are_means_of_rays(room, degrees, distance):
    """12, 17 and 50 degrees lie between two levels, whose mixture must not blur the edge of the cone much."""
    n, half_angle = 40, math.radians(degrees)
    origins, directions = random_directions(n, 2) * distance, random_directions(n, 3)
    radiance, _ = room.query_cone(origins, directions, half_angle)
    truth = torch.stack([brute_force(room, origins[i], directions[i], half_angle) for i in range(n)])
    error = (radiance - truth).abs().sum(-1) / truth.sum(-1)
    assert error.mean() < 0.03
    assert radiance.sum() / truth.sum() == pytest.approx(1, abs=0.03)


@pytest.mark.parametrize("degrees", [0.3, 5.0, 15.0, 30.0, 60.0, 90.0])
def test_constant_environment_gives_the_constant(degrees):
    field = EnvironmentField(PRESET, mean_radiance=3.0)
    field.coverage.fill_(1)
    with torch.no_grad():
        field.raw[..., 0] = torch.randn(field.raw.shape[:3], generator=torch.Generator().manual_seed(0))
    origins, directions = 0.7 * random_directions(50, 4), random_directions(50, 5)
    radiance, _ = field.query_cone(origins, directions, math.radians(degrees))
    torch.testing.assert_close(radiance, torch.full_like(radiance, 3.0), rtol=1e-3, atol=0)
    radiance, transmittance, _ = field.render(
        origins, directions, from_border(origins, directions), torch.full((50,), math.inf)
    )
    torch.testing.assert_close(radiance, torch.full_like(radiance, 3.0), rtol=2e-3, atol=0)
    assert (transmittance <= 1e-3).all()


def test_a_cone_does_not_depend_on_the_others(room):
    """Cones are composited in another order than they are given, so that neighbors follow each other."""
    origins, directions = 0.8 * random_directions(60, 7), random_directions(60, 8)
    half_angle = torch.logspace(-2, 0.1, 60)[torch.randperm(60, generator=torch.Generator().manual_seed(0))]
    together = room.query_cone(origins, directions, half_angle)
    each = [room.query_cone(origins[i, None], directions[i, None], half_angle[i, None]) for i in range(60)]
    for part, alone in zip(together, zip(*each, strict=True), strict=True):
        torch.testing.assert_close(part, torch.cat(alone), rtol=0, atol=0)


def test_cone_starts_at_the_border_for_points_on_it(room):
    """From the border outwards nothing is skipped; from a point on it inwards the far side begins after the sphere."""
    directions = random_directions(30, 6)
    outwards, _ = room.query_cone(directions, directions, 0.005)
    across, _ = room.query_cone(-directions, directions, 0.005)
    torch.testing.assert_close(outwards, across, rtol=0.2, atol=0.05)


def test_equirect_is_oriented_as_blenders_world():
    """Checked in Cycles: u = 0.5 - atan2(y, x) / (2 pi), v = 0.5 + elevation / pi, row 0 at the top (+z)."""
    field = EnvironmentField(PRESET, mean_radiance=0.1)
    field.coverage.fill_(1)
    rows = field.raw.shape[1]
    elevation, azimuth = math.radians(36), math.radians(70)
    with torch.no_grad():
        field.raw[..., 0] = -12
        row, column = int((math.pi / 2 - elevation) / math.pi * rows), int((azimuth / math.pi + 1) * rows)
        field.raw[-1, row, column, 1:] = 3.0
    height = 48
    radiance, _ = field.equirect(height)
    assert radiance.shape == (height, 2 * height, 3)
    brightest = int(radiance.sum(-1).argmax())
    top, left = divmod(brightest, 2 * height)
    assert top == pytest.approx((0.5 - elevation / math.pi) * height - 0.5, abs=2)
    assert left == pytest.approx((0.5 - azimuth / (2 * math.pi)) * 2 * height - 0.5, abs=2)


def test_coverage_is_high_only_where_cameras_looked():
    field = box_field()
    directions = random_directions(40_000, 7)
    directions = directions[directions[:, 2] < 0.2]
    field.freeze(-3.0 * torch.nn.functional.normalize(directions + 0.1, dim=-1), directions)
    below = torch.tensor([[0.0, 0.3, -1.0], [0.5, 0.5, -0.4], [-1.0, 0.2, -0.3]])
    above = torch.tensor([[0.0, 0.1, 1.0], [0.3, 0.3, 1.0], [-0.4, 0.2, 0.9]])
    for directions, seen in ((below, True), (above, False)):
        directions = torch.nn.functional.normalize(directions, dim=-1)
        _, coverage = field.query_cone(torch.zeros_like(directions), directions, math.radians(5))
        assert ((coverage >= 0) & (coverage <= 1)).all()
        assert (coverage > 0.6).all() if seen else (coverage < 0.1).all()


def test_what_no_photo_shows_counts_in_no_cone():
    field = EnvironmentField(PRESET, mean_radiance=3.0)
    rows = field.raw.shape[1]
    field.coverage[:, rows // 2 :] = 1  # below the horizon
    across = torch.tensor([[1.0, 0.0, 0.0], [0.6, -0.8, 0.0]])
    directions = torch.cat([across, torch.tensor([[0.0, 0.0, -1.0], [0.0, 0.0, 1.0]])])
    radiance, coverage = field.query_cone(torch.zeros(4, 3), directions, 0.7)
    torch.testing.assert_close(coverage, torch.tensor([0.5, 0.5, 1.0, 0.0]), atol=0.03, rtol=0)
    torch.testing.assert_close(radiance, 3 * coverage[:, None].expand(4, 3), atol=0.1, rtol=0)
    whole = field.extrapolated(8)
    torch.testing.assert_close(whole, torch.full((8, 16, 3), 3.0), atol=0.02, rtol=0)


def test_refining_keeps_the_field():
    coarse = box_field()
    fine = EnvironmentField(PRESET)
    fine.load_state_dict(coarse.state_dict())
    assert not fine.refine(0.4) and fine.refine(0.5) and not fine.refine(0.9)
    assert tuple(fine.raw.shape[:2]) == PRESET.resolutions[1]
    origins, directions = torch.zeros(400, 3), random_directions(400, 8)
    near, far = torch.ones(400), torch.full((400,), math.inf)
    with torch.no_grad():
        a = coarse.render(origins, directions, near, far)[0]
        b = fine.render(origins, directions, near, far)[0]
    assert (tone_map(a) - tone_map(b)).abs().mean() < 0.02


@pytest.mark.parametrize(("size", "far"), [(6.0, False), (60.0, True)])
def test_far_walls_get_a_color_detail_and_near_walls_do_not(size, far):
    """The contraction radius is 20: the walls of the small room lie inside it, those of the large room outside."""
    field, directions = box_field(size), random_directions(500, 8)
    rays = SimpleNamespace(
        rays=lambda index: RayBundle(-2 * directions.flip(0)[index], directions[index], torch.zeros(len(index)))
    )
    before = field.raw.detach().clone()
    assert not refine(field, rays, torch.arange(500), PRESET.detail_step - 1, 0.03) and not field.detail_decided
    assert refine(field, rays, torch.arange(500), PRESET.detail_step, 0.03) == far
    assert field.detail_decided and not refine(field, rays, torch.arange(500), 100, 0.4)
    assert (float(field.far_share) > 0.9) if far else (float(field.far_share) < 0.1)
    assert len(field.detail) == (PRESET.detail_rows if far else 0)
    assert ("color detail of the environment field" in skipped_detail(field)) != far
    assert field.distortion_cost == (0 if far else PRESET.distortion), "far colors are not pulled nearer"
    assert torch.equal(field.raw, before) != far  # with a color detail, F_e begins anew
    restored = EnvironmentField(PRESET)
    restored.load_state_dict(field.state_dict())
    assert restored.detail_decided and restored.detail.shape == field.detail.shape


def test_resampling_a_smooth_grid_keeps_its_values():
    def grid(rows):
        theta = (torch.arange(rows) + 0.5) * math.pi / rows
        phi = (torch.arange(2 * rows) + 0.5) * math.pi / rows - math.pi
        theta, phi = torch.meshgrid(theta, phi, indexing="ij")
        xyz = torch.stack([theta.sin() * phi.cos(), theta.sin() * phi.sin(), theta.cos(), theta.cos()], -1)
        return xyz[None].repeat(4, 1, 1, 1)

    torch.testing.assert_close(resample(grid(32), 6, 48), grid(48)[:1].repeat(6, 1, 1, 1), rtol=0, atol=6e-3)


def test_saving_restores_resolution_and_coverage():
    field = box_field()
    field.refine(1.0)
    field.freeze(torch.tensor([[0.0, -3.0, 0.0]]).expand(100, 3), random_directions(100, 9))
    restored = EnvironmentField(PRESET)
    restored.load_state_dict(field.state_dict())
    assert torch.equal(restored.raw, field.raw) and torch.equal(restored.coverage, field.coverage)
    assert restored.level == field.level


def test_cones_follow_a_changed_field():
    field = box_field()
    directions = random_directions(5, 10)
    before, _ = field.query_cone(torch.zeros(5, 3), directions, 0.3)
    brighter = field.state_dict()
    brighter["raw"] = brighter["raw"] + torch.tensor([0.0, 1.0, 1.0, 1.0])
    field.load_state_dict(brighter)
    after, _ = field.query_cone(torch.zeros(5, 3), directions, 0.3)
    torch.testing.assert_close(after, before * math.e, rtol=1e-3, atol=0)


def test_regularization_prefers_smooth_and_empty_by_its_gradient():
    generator = torch.Generator().manual_seed(0)
    smooth = EnvironmentField(PRESET).regularize(generator)
    rough = EnvironmentField(PRESET)
    with torch.no_grad():
        rough.raw += torch.randn(rough.raw.shape, generator=generator)
    dense = EnvironmentField(PRESET)
    with torch.no_grad():
        dense.raw[..., 0] = 3.0
    assert rough.regularize(generator) > smooth and dense.regularize(generator) > smooth
    rough.raw.grad = torch.ones_like(rough.raw)
    state = generator.get_state()
    before = rough.regularize(generator)
    gradient = rough.raw.grad - 1
    with torch.no_grad():
        rough.raw -= 100.0 * gradient
    after = rough.regularize(generator.set_state(state))
    expected = before - 100.0 * float(gradient.square().sum())
    assert after == pytest.approx(expected, rel=0.02) and after < before


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64, torch.bfloat16], ids=str)
def test_regularization_adds_what_autograd_gives(dtype):
    generator = torch.Generator().manual_seed(0)
    field = EnvironmentField(dataclasses.replace(PRESET, regularized_fraction=1.0))
    with torch.no_grad():
        field.raw += 3 * torch.randn(field.raw.shape, generator=generator)
    field = field.to(dtype)
    raw, p = field.raw.detach().clone().requires_grad_(), field.preset
    weight = (p.density_variation, *[p.color_variation] * 3)
    expected = total_variation(raw, weight, p.variation_softness)
    expected = expected + p.density_penalty * torch.nn.functional.softplus(raw[..., 0].float()).mean()
    expected.backward()
    assert field.regularize(generator) == pytest.approx(float(expected.detach()), rel=1e-4)
    rtol = 1e-4 if dtype != torch.bfloat16 else 0.02
    torch.testing.assert_close(field.raw.grad, raw.grad, rtol=rtol, atol=rtol * float(raw.grad.abs().max()))


def pixel_rays(room: EnvironmentField, n: int, seed: int) -> SimpleNamespace:
    """Rays of cameras at 3 radii that look past the sphere into the room: what learning needs of PixelRays."""
    origins = 3 * random_directions(12, seed)[torch.arange(n) % 12]
    directions = torch.nn.functional.normalize(random_directions(n, seed + 1) - 0.5 * origins, dim=-1)
    with torch.no_grad():
        radiance = room.render(origins, directions, torch.full((n,), 0.6), torch.full((n,), math.inf))[0]
    half_angle = torch.full((n,), 1e-3)
    rays = RayBundle(origins, directions, half_angle)
    return SimpleNamespace(
        radiance=radiance,
        count=n,
        rays=lambda i: rays[i],
        photo=lambda i: radiance[i],
        white=lambda i: torch.zeros_like(i) > 0,
    )


def learn_room(seed: int):
    preset = dataclasses.replace(PRESET, steps=120, rays_per_step=1024, coverage_rays=5000, learning_rate=0.1)
    rays = pixel_rays(box_field(), 20_000, 20)
    seen = []
    field, _ = learn_environment(
        rays,
        torch.arange(20_000),
        preset,
        seed=seed,
        device=torch.device("cpu"),
        progress=lambda step, steps, loss: seen.append((step, steps, loss)),
        checkpoint=NoCheckpoint(),
    )
    return field, seen


def test_environment_learning_without_a_finite_loss_is_given_up():
    rays = pixel_rays(box_field(), 500, 20)
    rays.radiance[:] = math.nan
    with pytest.raises(LearningError, match="not finite"):
        learn_environment(
            rays,
            torch.arange(500),
            dataclasses.replace(PRESET, steps=60, rays_per_step=64),
            seed=0,
            device=torch.device("cpu"),
            progress=lambda *_: None,
            checkpoint=NoCheckpoint(),
        )


def test_a_step_whose_loss_is_not_finite_changes_nothing():
    rays = pixel_rays(box_field(), 500, 20)
    rays.radiance[7] = math.nan
    field = EnvironmentField(PRESET)
    before, adam = field.raw.detach().clone(), optimizer(field)
    loss = learn_step(field, adam, rays, torch.arange(500), torch.Generator().manual_seed(0))
    assert math.isnan(loss) and torch.equal(field.raw, before)
    rays.radiance[7] = 1.0
    assert math.isfinite(learn_step(field, adam, rays, torch.arange(500), torch.Generator().manual_seed(0)))
    assert not torch.equal(field.raw, before) and torch.isfinite(field.raw).all()


def test_learning_explains_unseen_rays_and_is_deterministic():
    field, seen = learn_room(0)
    assert [s[0] for s in seen] == list(range(1, 121)) and seen[-1][2] < 0.3 * seen[0][2]
    test = pixel_rays(box_field(), 3000, 50)
    origins, directions, _ = test.rays(torch.arange(3000))
    with torch.no_grad():
        radiance = field.render(origins, directions, torch.full((3000,), 0.6), torch.full((3000,), math.inf))[0]
    error = (tone_map(radiance) - tone_map(test.radiance)).square().mean()
    constant = (tone_map(test.radiance).mean(0) - tone_map(test.radiance)).square().mean()
    assert error < 0.25 * constant
    assert torch.equal(field.raw, learn_room(0)[0].raw)


@pytest.fixture
def sky() -> EnvironmentField:
    """An environment at infinity whose radiance is a smooth function of the direction."""
    field = EnvironmentField(dataclasses.replace(PRESET, model="infinite"))
    shells, rows = field.raw.shape[:2]
    assert shells == 2
    theta = ((torch.arange(rows) + 0.5) * math.pi / rows)[:, None].expand(rows, 2 * rows)
    with torch.no_grad():
        field.raw[..., 1:] = theta.cos()[None, ..., None]
    field.coverage.fill_(1)
    return field


def test_an_infinite_environment_depends_on_the_direction_alone(sky):
    directions = random_directions(200, 3)
    near = torch.full((200,), 0.6)
    far = torch.full_like(near, math.inf)
    for origins in (torch.zeros(200, 3), 2.5 * random_directions(200, 4)):
        radiance, transmittance, _ = sky.render(origins, directions, near, far)
        torch.testing.assert_close(radiance, directions[:, 2:].exp().expand(200, 3), rtol=0.02, atol=0)
        assert (transmittance < 1e-6).all()
        radiance, transmittance, _ = sky.render(origins, directions, near, near + 1)
        assert (radiance == 0).all() and (transmittance == 1).all()
    # the mean of exp(z) over a hemisphere about z is e - 1
    up = torch.tensor([[0.0, 0.0, 1.0]])
    mean, _ = sky.query_cone(0.5 * up, up, math.pi / 2)
    torch.testing.assert_close(mean, torch.full((1, 3), math.e - 1), rtol=0.05, atol=0)


def test_an_unknown_environment_model_is_refused():
    with pytest.raises(ValueError, match="field, infinite or none"):
        EnvironmentField(dataclasses.replace(PRESET, model="cube"))
