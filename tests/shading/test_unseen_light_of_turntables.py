"""Light that no photo shows, where the object turned: how far away it is, and who judges its fits."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch
import trimesh

from blender_nep.geometry.ray_tracing import RayTracer
from blender_nep.materials import unseen_light_training
from blender_nep.materials.palette.palette import Palette
from blender_nep.materials.unseen_light_training import (
    UnseenFit,
    UnseenLightProblem,
    judged_problem,
    learn_unseen_light,
    likely_radius,
)
from blender_nep.presets import MaterialPreset
from blender_nep.shading.incoming_light import IncomingLight
from blender_nep.shading.plenoptic import PlenopticFunction, PlenopticSettings, TerminalRadiance, reflected
from blender_nep.shading.unseen_light import UnseenLight
from support.turns import turned_about_z

COUNT = 3000
METAL = Palette(torch.tensor([[0.9, 0.6, 0.3]]), torch.tensor([0.15]), torch.tensor([1.0]))
PRESET = replace(MaterialPreset(), unseen_samples=COUNT, unseen_steps=40)
LABEL = torch.zeros(COUNT, dtype=torch.int64)


class NothingShown:
    """An environment of which no photo shows anything."""

    def query_cone(self, origins, direction, half_angle):
        return torch.zeros_like(direction), torch.zeros(len(direction))


def turning_ball() -> IncomingLight:
    """Points of a ball that turned in a light of which no photo shows anything."""
    mesh = trimesh.creation.icosphere(subdivisions=4, radius=0.8)
    vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces)
    settings = PlenopticSettings(levels=1, diffuse=8, specular=4)
    tracer = RayTracer(vertices, faces)
    f_p = PlenopticFunction(tracer, vertices / 0.8, NothingShown(), TerminalRadiance(), settings, "cpu")
    rng = np.random.default_rng(0)
    face = rng.integers(0, len(faces), COUNT)
    barycentric = rng.dirichlet([1, 1, 1], COUNT).astype(np.float32)
    turned = turned_about_z(rng.uniform(0, 6.28, COUNT).tolist())
    eye = turned.rotation.mT @ torch.tensor([3.0, 0.0, 1.0])
    normal = torch.from_numpy(f_p.tracer.face_normals[face]).float()
    view = torch.nn.functional.normalize(eye - 0.8 * normal, dim=-1)
    seen = torch.nonzero((view * normal).sum(-1) > 0.3)[:, 0]
    again = seen[torch.arange(COUNT) % len(seen)]
    points = f_p.points(face[again], barycentric[again], view[again], turned[again])
    generator = torch.Generator().manual_seed(6)
    light = IncomingLight.gathered(f_p, points, (0.1, 0.2, 0.4), 8, torch.zeros(COUNT), generator, lambda _: None)
    return light.with_unseen(UnseenLight.uniform(32, 1000.0, "cpu", 0.5))


def photographed(light: IncomingLight, radius: float) -> torch.Tensor:
    """What the points send to the eye in a pattern of light on a sphere of that radius."""
    pattern = torch.rand(8, 16, 3, generator=torch.Generator().manual_seed(3)).square() * 3
    pattern = pattern.repeat_interleave(4, 0).repeat_interleave(4, 1)
    lit = light.with_unseen(replace(UnseenLight.uniform(32, radius, "cpu"), radiance=pattern))
    material = METAL.at(LABEL)
    return reflected(material, lit.moments(material.roughness), lit.diffuse, lit.cos_v)


@pytest.mark.slow
def test_parallax_tells_how_far_the_light_is_away() -> None:
    light = turning_ball()
    for radius in (2.5, 1000.0):
        target = photographed(light, radius)
        found = likely_radius(light, METAL, LABEL, target, PRESET, torch.Generator().manual_seed(0), lambda: None)
        assert found == radius


def test_fits_are_judged_by_samples_that_they_have_not_seen() -> None:
    light = turning_ball()
    noise = torch.rand(COUNT, 3, generator=torch.Generator().manual_seed(1))
    assert light.unseen is not None
    problem = judged_problem(light, light.unseen, LABEL, noise, torch.arange(COUNT), PRESET)
    alone = UnseenLightProblem(light, light.unseen, LABEL, noise, problem.samples, PRESET)
    assert problem.judge is not None
    assert not set(problem.samples.tolist()) & set(problem.judge.samples.tolist())
    judged, itself = (each.solve(METAL, light.unseen, 40) for each in (problem, alone))
    assert torch.equal(judged.light.radiance, itself.light.radiance)
    assert judged.error > itself.error, "the map follows the noise of the samples that it sees"


def test_before_anything_is_known_the_light_is_gray() -> None:
    expected = torch.rand(8, 16, 3, generator=torch.Generator().manual_seed(2))
    light = replace(UnseenLight.uniform(8, 3.0, "cpu"), expected=expected, radiance=expected)
    gray = light.grayed()
    assert torch.equal(gray.radiance, expected.mean().expand(8, 16, 3)) and torch.equal(gray.expected, gray.radiance)
    assert gray.radius == light.radius and torch.equal(gray.missing, light.missing)


@pytest.mark.parametrize("turned", [True, False])
@pytest.mark.parametrize("begin", [(0.0, 1.0), (1.0, 1.0), (1.0, 0.0)])
def test_two_paints_are_found_together_on_a_turntable(monkeypatch, turned: bool, begin: tuple[float, float]) -> None:
    errors = {(0.0, 1.0): 0.0499, (1.0, 1.0): 0.0472, (1.0, 0.0): 0.0480, (0.0, 0.0): 0.0353}

    class Measured(UnseenLightProblem):
        """Its errors are given: a light that suits two metals suits neither paint beside a metal."""

        def __init__(self, *_: object) -> None:
            self.label = torch.tensor([0, 1])

        def solve(self, palette: Palette, start: UnseenLight, *_: object) -> UnseenFit:
            first, second = palette.metallic.tolist()
            return UnseenFit(start, palette.albedo, errors[first, second])

    monkeypatch.setattr(unseen_light_training, "UnseenLightProblem", Measured)
    monkeypatch.setattr(unseen_light_training, "_unexplained_samples", lambda *_: torch.arange(8))
    metallic = torch.tensor(begin)
    palette = Palette(torch.full((2, 3), 0.5), torch.full((2,), 0.2), metallic)
    swapped = replace(palette, metallic=1 - metallic, roughness=torch.full((2,), 0.3))
    light = SimpleNamespace(
        unseen=UnseenLight.uniform(8, 3.0, "cpu"), points=SimpleNamespace(motion=object() if turned else None)
    )
    preset = replace(PRESET, unseen_roughness_factors=(), metals_are_bright=0.0)
    told, generator = torch.zeros(2), torch.Generator()
    found = learn_unseen_light(light, palette, swapped, LABEL, LABEL, told, 0, preset, generator, lambda: None)[1]
    both_paints = turned or begin == (1.0, 0.0)
    assert found.metallic.tolist() == ([0.0, 0.0] if both_paints else [1.0, 1.0])
    assert found.roughness.tolist() == pytest.approx(
        [0.3 if b != f else 0.2 for b, f in zip(begin, found.metallic, strict=True)]
    )
