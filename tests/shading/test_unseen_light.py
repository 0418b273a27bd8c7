"""Light that no photo shows: its map against brute force, its transport's adjoint, and that reflections reveal a lamp."""

import math
from dataclasses import FrozenInstanceError, replace
from types import SimpleNamespace

import numba
import numpy as np
import pytest
import torch
import trimesh

from blender_nep.geometry.ray_tracing import RayTracer
from blender_nep.materials.palette.palette import Palette
from blender_nep.materials.unseen_light_training import UnseenLightProblem, learn_unseen_light
from blender_nep.presets import MaterialPreset
from blender_nep.shading.incoming_light import IncomingLight
from blender_nep.shading.plenoptic import PlenopticFunction, PlenopticSettings, SpecularMoments, TerminalRadiance, reflected
from blender_nep.shading.unseen_light import UncoveredCones, UnseenLight, level_sizes, pyramid
from blender_nep.shading.unseen_transport import UnseenTransport
from blender_nep.tone_mapping import tone_map


def directions(n: int, seed: int) -> torch.Tensor:
    return torch.nn.functional.normalize(torch.randn(n, 3, generator=torch.Generator().manual_seed(seed)), dim=-1)


def centers(rows: int) -> torch.Tensor:
    """Directions [rows, 2 rows, 3] of an equirectangular map's texels, in Blender's orientation."""
    polar = (torch.arange(rows) + 0.5) * math.pi / rows
    around = (0.5 - (torch.arange(2 * rows) + 0.5) / (2 * rows)) * 2 * math.pi
    polar, around = torch.meshgrid(polar, around, indexing="ij")
    return torch.stack([polar.sin() * around.cos(), polar.sin() * around.sin(), polar.cos()], -1)


def map_of(radiance: torch.Tensor, radius: float = math.inf) -> UnseenLight:
    return replace(UnseenLight.uniform(len(radiance), radius, "cpu"), radiance=radiance)


def smooth(d: torch.Tensor) -> torch.Tensor:
    """A radiance that varies slowly over directions."""
    return 2 + d + 0.5 * d[..., :1] * d[..., 1:2]


def test_levels_keep_the_flux_of_the_map():
    radiance = torch.rand(32, 64, 3, generator=torch.Generator().manual_seed(0))
    levels, start = pyramid(radiance, torch.ones(32, 64)), 0
    flux = []
    for rows in level_sizes(32):
        level = levels[start : start + 2 * rows * rows].reshape(rows, 2 * rows, 3)
        edge = torch.cos(torch.arange(rows + 1) * math.pi / rows)
        area = (edge[:-1] - edge[1:]) * math.pi / rows
        flux.append((level * area[:, None, None]).sum((0, 1)))
        start += 2 * rows * rows
    assert start == len(levels) and level_sizes(32)[-1] == 8
    for other in flux[1:]:
        torch.testing.assert_close(other, flux[0], rtol=5e-3, atol=0)


@pytest.mark.parametrize("half_angle", [0.02, 0.2, 0.5])
def test_a_cone_returns_the_mean_over_its_directions(half_angle):
    light = map_of(smooth(centers(32)))
    axis = directions(200, 1)
    found = light(torch.zeros(200, 3), axis, torch.full((200,), half_angle))
    generator = torch.Generator().manual_seed(2)
    u = torch.rand(2000, 2, generator=generator)
    cosine, turn = 1 - u[:, 0] * (1 - math.cos(half_angle)), 2 * math.pi * u[:, 1]
    first = torch.nn.functional.normalize(torch.linalg.cross(axis, directions(200, 3)), dim=-1)
    second = torch.linalg.cross(axis, first)
    flat = (1 - cosine**2).sqrt()
    inside = (
        cosine[:, None, None] * axis
        + (flat * turn.cos())[:, None, None] * first
        + (flat * turn.sin())[:, None, None] * second
    )
    truth = smooth(inside).mean(0)
    assert ((found - truth).abs() / truth).mean() < 0.03


def test_a_near_lamp_is_seen_where_it_is_from_off_the_center():
    rows, radius = 64, 4.0
    lamp = torch.tensor([0.6, 0.64, 0.48])
    light = map_of(torch.exp((centers(rows) @ lamp - 1) * 200)[..., None].expand(-1, -1, 3).contiguous(), radius)
    origin = 0.8 * directions(50, 4)
    towards = torch.nn.functional.normalize(radius * lamp - origin, dim=-1)
    angle = torch.full((50,), 0.01)
    assert (light(origin, towards, angle) > 0.9).all()
    assert (light(origin, -towards, angle) < 0.1).all()
    far = replace(light, radius=math.inf)
    assert (far(origin, lamp.expand(50, 3), angle) > 0.9).all()


@pytest.mark.parametrize("half_angle", [0.02, 0.3, 0.9])
def test_what_photos_show_does_not_count_in_the_mean_over_a_cone(half_angle):
    shown = centers(32)[..., 2] < 0
    light = map_of(torch.where(shown, 7.0, 2.0)[..., None].expand(-1, -1, 3).contiguous())
    light = replace(light, missing=torch.where(shown, 1e-3, 1.0))
    axis = directions(300, 9)
    axis = axis[axis[:, 2] > 0.1]
    found = light(torch.zeros_like(axis), axis, torch.full((len(axis),), half_angle))
    torch.testing.assert_close(found, torch.full_like(found, 2.0), atol=0.05, rtol=0)
    again = UnseenLight.from_state(light.state())
    torch.testing.assert_close(again.equirect(64)[:31], torch.full((31, 128, 3), 2.0), atol=0.05, rtol=0)


def test_seen_from_the_center_it_is_the_map():
    light = map_of(smooth(centers(16)), 3.0)
    torch.testing.assert_close(light.equirect(16), light.radiance)
    fine = light.equirect(64)
    assert fine.shape == (64, 128, 3)
    assert ((fine - smooth(centers(64))).abs()[4:-4] < 0.15).all()


class DarkCeiling:
    """An environment of gray walls whose upper part no photo shows: there it is black and not covered."""

    def query_cone(self, origins, direction, half_angle):
        seen = (direction[:, 2] < 0.3).float()
        return 0.3 * seen[:, None].expand(-1, 3).contiguous(), seen


class NothingShown:
    """An environment of which no photo shows anything."""

    def query_cone(self, origins, direction, half_angle):
        return torch.zeros_like(direction), torch.zeros(len(direction))


@pytest.fixture(scope="module")
def ball():
    """4000 points of a sphere under the dark ceiling, and their light without the lamp."""
    return ball_in(DarkCeiling())


def ball_in(environment):
    mesh = trimesh.creation.icosphere(subdivisions=4, radius=0.7)
    vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces)
    normals = vertices / 0.7
    f_p = PlenopticFunction(
        RayTracer(vertices, faces),
        normals,
        environment,
        TerminalRadiance(),
        PlenopticSettings(levels=1, diffuse=8, specular=4, use_cones=True),
        "cpu",
    )
    rng = np.random.default_rng(0)
    face = rng.integers(0, len(faces), 4000)
    barycentric = rng.dirichlet([1, 1, 1], 4000).astype(np.float32)
    normal = torch.from_numpy(f_p.tracer.face_normals[face])
    view = torch.nn.functional.normalize(normal + 0.5 * directions(4000, 5), dim=-1)
    points = f_p.points(face, barycentric, view)
    roughness_levels = (0.1, 0.2, 0.4, 1.0)
    light = IncomingLight.gathered(
        f_p, points, roughness_levels, 32, torch.zeros(len(points)), torch.Generator().manual_seed(6), lambda _: None
    )
    return light.updated(None, torch.Generator())


def lamp(rows: int) -> UnseenLight:
    return map_of(10 * (centers(rows) @ torch.tensor([0.48, 0.0, 0.877]) > 0.95)[..., None].expand(-1, -1, 3).float(), 4.0)


def unlit(ball: IncomingLight) -> IncomingLight:
    """The ball with a black map, from which the learning of the unseen light goes on."""
    return ball.with_unseen(UnseenLight.uniform(16, 4.0, "cpu"))


def photographed_under_a_lamp(ball, material):
    """What 4000 samples of this material send to the eye under lamp(16), which no photo shows."""
    lit = ball.with_unseen(lamp(16))
    return reflected(material, lit.moments(material.roughness), lit.diffuse, lit.cos_v)


def test_the_transport_is_what_cones_receive_with_its_adjoint(ball):
    palette = Palette(torch.tensor([[0.8, 0.5, 0.2]]), torch.tensor([0.3]), torch.tensor([0.4]))
    material = palette.at(torch.zeros(4000, dtype=torch.int64))
    rows = torch.arange(0, 4000, 3)
    light = lamp(16)
    cones = ball.uncovered_cones(rows)
    offset, slope = ball.uncovered_response(cones, rows, palette.at(torch.zeros(len(rows), dtype=torch.int64)))
    transport = UnseenTransport(light.missing, light.radius, cones, ball.points.position[rows])
    response = torch.stack([offset, slope], 1).numpy()
    lines = transport.sent(response, pyramid(light.radiance, light.missing).numpy())
    sent = lines[:, 0] + lines[:, 1] * palette.albedo.numpy()
    before = reflected(material, ball.moments(material.roughness), ball.diffuse, ball.cos_v)
    lit = ball.updated(None, torch.Generator(), light)
    after = reflected(material, lit.moments(material.roughness), lit.diffuse, lit.cos_v)
    np.testing.assert_allclose(sent, (after - before)[rows].numpy(), rtol=2e-3, atol=2e-4)
    other = np.random.default_rng(1).normal(size=lines.shape).astype(np.float32)
    levels = np.random.default_rng(2).normal(size=(len(pyramid(light.radiance, light.missing)), 3)).astype(np.float32)
    assert (transport.sent(response, levels) * other).sum() == pytest.approx(
        (transport.adjoint(response, other) * levels).sum(), rel=1e-3
    )
    found, threads = [], numba.get_num_threads()
    try:
        for count in (1, 4):
            numba.set_num_threads(count)
            found.append((transport.sent(response, levels), transport.adjoint(response, other)))
    finally:
        numba.set_num_threads(threads)
    assert all(np.array_equal(a, b) for a, b in zip(found[0], found[-1], strict=True)), "whatever the number of threads"
    with pytest.raises(ValueError, match="texels"):
        transport.sent(response, levels[1:])
    answers = np.random.default_rng(3).random(len(cones)) < 0.4
    response[~answers] = 0
    part = transport.of(answers)
    np.testing.assert_allclose(part.sent(response[answers], levels), transport.sent(response, levels), rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(
        part.adjoint(response[answers], other), transport.adjoint(response, other), rtol=1e-4, atol=1e-5
    )


def test_light_is_a_value_and_an_update_returns_a_new_one(ball):
    before = ball.moments_state()
    lit = ball.with_unseen(lamp(16))
    assert ball.unseen is None and all(torch.equal(x, before[name]) for name, x in ball.moments_state().items())
    assert lit.unseen is not None and float((lit.diffuse - ball.diffuse).max()) > 0.1
    assert lit.known_specular is ball.known_specular and lit.traced is ball.traced, "what stays the same is shared"
    again = lit.updated(None, torch.Generator())
    assert again.unseen is lit.unseen and torch.equal(again.specular, lit.specular)
    assert torch.equal(lit.with_unseen(None).diffuse, ball.diffuse)
    with pytest.raises(ValueError, match="with_unseen"):
        IncomingLight.of(lit.plenoptic, lit.points, (0.1, 0.2, 0.4, 1.0), lit.traced)
    with pytest.raises(FrozenInstanceError):
        lit.diffuse = ball.diffuse


def test_a_palette_with_one_material_of_another():
    ours = Palette(torch.tensor([[0.1, 0.2, 0.3], [0.4, 0.5, 0.6]]), torch.tensor([0.2, 0.3]), torch.tensor([0.0, 1.0]))
    other = Palette(1 - ours.albedo, 1 - ours.roughness, 1 - ours.metallic)
    mixed = ours.with_one(1, other)
    assert mixed.metallic.tolist() == [0, 0] and mixed.roughness.tolist() == pytest.approx([0.2, 0.7])
    assert mixed.albedo[0].equal(ours.albedo[0]) and mixed.albedo[1].equal(other.albedo[1])


@pytest.mark.parametrize("truth", [0.0, 1.0])
def test_metal_is_told_from_paint_with_a_lamp_that_is_not_shown(ball, truth):
    label = torch.zeros(4000, dtype=torch.int64)
    painted, gold = (Palette(torch.tensor([[0.8, 0.5, 0.2]]), torch.tensor([0.25]), torch.tensor([m])) for m in (0.0, 1.0))
    real, taken_for = (gold, painted) if truth else (painted, gold)
    target = photographed_under_a_lamp(ball, real.at(label))
    preset = replace(MaterialPreset(), unseen_samples=2000)
    _, found, margins = learn_unseen_light(
        unlit(ball), taken_for, real, label, target, torch.zeros(1), 6, preset, torch.Generator(), lambda: None
    )
    assert found.metallic.tolist() == [truth] and margins[0] > 0.1


def test_a_wrong_roughness_comes_nearer_with_every_trial(ball):
    label = torch.zeros(4000, dtype=torch.int64)
    gold = Palette(torch.tensor([[0.8, 0.5, 0.2]]), torch.tensor([0.25]), torch.ones(1))
    too_rough = replace(gold, roughness=torch.tensor([0.4]))
    target = photographed_under_a_lamp(ball, gold.at(label))
    preset = replace(MaterialPreset(), unseen_samples=2000)
    found = []
    for most_trials in (0, 1, 6):
        fitted = learn_unseen_light(
            unlit(ball), too_rough, None, label, target, torch.zeros(1), most_trials, preset, torch.Generator(), lambda: None
        )[1]
        found.append(float(fitted.roughness))
    assert found[:2] == pytest.approx([0.4, 0.32]), "no trial, and one trial"
    assert found[2] == pytest.approx(0.25, rel=0.2)


def test_a_roughness_at_its_limit_is_not_tried_again(ball):
    label = torch.zeros(4000, dtype=torch.int64)
    preset = replace(MaterialPreset(), unseen_samples=1000, unseen_roughness_factors=(0.8,), metals_are_bright=0.0)
    smoothest = Palette(torch.full((1, 3), 0.5), torch.tensor([preset.least_roughness]), torch.ones(1))
    trials = []
    target = torch.full((4000, 3), 0.3)
    learn_unseen_light(
        unlit(ball), smoothest, None, label, target, torch.zeros(1), 6, preset, torch.Generator(), lambda: trials.append(1)
    )
    assert len(trials) == 1, "only the light of the palette as it is"


def test_in_light_that_no_photo_shows_a_dark_metal_gets_bright():
    ball, label = ball_in(NothingShown()), torch.zeros(4000, dtype=torch.int64)
    dark = Palette(torch.tensor([[0.3, 0.2, 0.08]]), torch.tensor([0.2]), torch.ones(1))
    target = photographed_under_a_lamp(ball, dark.at(label))
    albedos, errors = [], []
    for weight in (0.0, MaterialPreset().metals_are_bright):
        preset = replace(
            MaterialPreset(), unseen_samples=2000, unseen_roughness_factors=(), metals_are_bright=weight, unseen_color=0.0
        )
        light = ball.with_unseen(lamp(16))
        unseen, palette, _ = learn_unseen_light(
            light, dark, None, label, target, torch.zeros(1), 0, preset, torch.Generator(), lambda: None
        )
        lit, material = light.with_unseen(unseen), palette.at(label)
        sent = reflected(material, lit.moments(material.roughness), lit.diffuse, lit.cos_v)
        albedos.append(palette.albedo[0])
        errors.append(float((tone_map(sent) - tone_map(target)).abs().mean()))
    assert albedos[1].amax() > 1.3 * albedos[0].amax() and errors[1] < errors[0] + 0.01
    assert (albedos[1] / albedos[1].amax() - albedos[0] / albedos[0].amax()).abs().max() < 0.05


def test_where_photos_show_half_of_the_light_it_stays_dark(ball):
    label = torch.zeros(4000, dtype=torch.int64)
    dark = Palette(torch.tensor([[0.3, 0.2, 0.08]]), torch.tensor([0.2]), torch.ones(1))
    target = photographed_under_a_lamp(ball, dark.at(label))
    preset = replace(MaterialPreset(), unseen_samples=2000, unseen_roughness_factors=())
    _, palette, _ = learn_unseen_light(
        unlit(ball), dark, None, label, target, torch.zeros(1), 0, preset, torch.Generator(), lambda: None
    )
    assert 0.27 < palette.albedo[0, 0] < 0.4, "it is likely to have 0.85"


@pytest.mark.parametrize("metallic", [0.0, 1.0])
def test_reflections_reveal_a_lamp_that_no_photo_shows(ball, metallic):
    palette = Palette(torch.tensor([[0.7, 0.4, 0.2]]), torch.tensor([0.2]), torch.tensor([metallic]))
    label = torch.zeros(4000, dtype=torch.int64)
    truth = lamp(16)
    target = photographed_under_a_lamp(ball, palette.at(label))
    wrong = replace(palette, albedo=torch.full((1, 3), 0.5))
    start = UnseenLight.uniform(16, 4.0, "cpu")
    fit = UnseenLightProblem(ball, start, label, target, torch.arange(4000), MaterialPreset()).solve(wrong, start, 150)
    area = torch.sin((torch.arange(16) + 0.5) * math.pi / 16)[:, None, None]
    bright = truth.radiance > 1
    flux = [float((light.radiance * area)[bright].sum()) for light in (truth, fit.light)]
    assert flux[1] == pytest.approx(flux[0], rel=0.2)
    assert float((fit.light.radiance * area)[~bright].sum()) < 0.3 * flux[0]
    torch.testing.assert_close(fit.albedo, palette.albedo, rtol=0.1, atol=0.02)


def test_bright_paint_under_a_dark_sky_is_found_in_few_steps(ball):
    palette = Palette(torch.tensor([[0.4, 0.3, 0.2]]), torch.tensor([0.3]), torch.zeros(1))
    label = torch.zeros(4000, dtype=torch.int64)
    lit = ball.with_unseen(UnseenLight.uniform(16, 4.0, "cpu", 4.0))
    material = palette.at(label)
    target = reflected(material, lit.moments(material.roughness), lit.diffuse, lit.cos_v)
    dark = UnseenLight.uniform(16, 4.0, "cpu", 0.2)
    dark = replace(dark, expected=dark.radiance)
    bright = replace(palette, albedo=torch.full((1, 3), 0.98))
    fit = UnseenLightProblem(ball, dark, label, target, torch.arange(4000), MaterialPreset()).solve(bright, dark, 30)
    torch.testing.assert_close(fit.albedo, palette.albedo, rtol=0.2, atol=0.0)


def map_and_problem(ball) -> tuple[torch.Tensor, UnseenLightProblem]:
    """A map that is brighter than expected and rough, and the problem that asks for it."""
    generator = torch.Generator().manual_seed(3)
    start = UnseenLight.uniform(16, 4.0, "cpu", 0.5)
    label = torch.zeros(4000, dtype=torch.int64)
    problem = UnseenLightProblem(ball, start, label, torch.zeros(4000, 3), torch.arange(40), MaterialPreset())
    return (0.8 * torch.randn(16, 32, 3, generator=generator)).exp(), problem


@pytest.mark.parametrize("factor", [0.5, 3.0])
def test_a_map_costs_by_its_form_and_hardly_by_its_brightness(ball, factor):
    radiance, problem = map_and_problem(ball)
    area = torch.sin((torch.arange(16) + 0.5) * math.pi / 16)[:, None].expand(16, 32)
    root = float((area * radiance.mean(-1).sqrt()).sum() / area.sum())
    brighter = [2 * math.log(root) + math.log(f / 0.5) for f in (1, factor)]
    more = problem.cost_of_map(factor * radiance) - problem.cost_of_map(radiance)
    expected = MaterialPreset().unseen_scale * (abs(brighter[1]) - abs(brighter[0]))
    assert float(more) == pytest.approx(expected, abs=2e-6) and abs(expected) > 5e-4


def test_the_cost_of_a_map_makes_it_no_darker_as_a_whole(ball):
    radiance, problem = map_and_problem(ball)
    raw = radiance.log().requires_grad_()
    cost = problem.cost_of_map(raw.exp(), descending=True)
    (gradient,) = torch.autograd.grad(cost, raw)
    assert float(gradient.sum()) == pytest.approx(MaterialPreset().unseen_scale, abs=2e-6), "per unit of the logarithm"
    assert float(gradient.abs().sum()) > 5 * MaterialPreset().unseen_scale, "but it smooths"


def test_many_samples_on_many_threads_are_solved_the_same():
    """From 32,768 numbers on, torch sums the gradient of x[index] with atomic additions of all threads, in any order."""
    n, generator = 40_000, torch.Generator().manual_seed(0)

    def random(*shape):
        return torch.rand(*shape, generator=generator)

    cones = UncoveredCones(
        torch.arange(8), directions(8, 0), torch.full((8,), 0.3), torch.ones(8), torch.ones(8, 3), torch.zeros(8, 2)
    )
    moments = SpecularMoments(random(n, 3), 0.1 * random(n, 3), 0.05 * random(n, 3))
    light = SimpleNamespace(
        points=SimpleNamespace(room_position=random(n, 3) - 0.5, motion=None),
        cos_v=0.2 + 0.8 * random(n),
        known_diffuse=random(n, 3),
        known_moments=lambda *_: moments,
        uncovered_cones=lambda _: cones,
        uncovered_response=lambda *_: (torch.zeros(8, 3), torch.ones(8, 3)),
    )
    palette = Palette(random(2, 3), torch.full((2,), 0.3), torch.tensor([0.0, 1.0]))
    label, target = torch.arange(n) % 2, random(n, 3)
    start = UnseenLight.uniform(8, 4.0, "cpu")
    problem = UnseenLightProblem(light, start, label, target, torch.arange(n), MaterialPreset())
    threads = torch.get_num_threads()
    try:
        torch.set_num_threads(4)
        found = [problem.solve(palette, start, 4) for _ in range(6)]
    finally:
        torch.set_num_threads(threads)
    assert all(torch.equal(found[0].albedo, other.albedo) and found[0].error == other.error for other in found)
