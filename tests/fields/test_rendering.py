"""Rays through both fields: what each field adds, the weight of eq. 4, and where gradients go."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from blender_nep.capture.rays.ray_bundle import RayBundle
from blender_nep.fields.environment.field import EnvironmentField
from blender_nep.fields.fields import new_object_field
from blender_nep.fields.object.field import Appearance
from blender_nep.fields.rendering import FieldsRenderer, RenderSettings, dynamic_weight
from blender_nep.presets import Preset
from blender_nep.support.plane import Support
from support.brief_preset import brief_preset

CPU = torch.device("cpu")
SHARP = RenderSettings(sharpness=200.0, samples=16)


def renderer(preset: Preset) -> FieldsRenderer:
    """Fields as they are at the start: a sphere in thin fog."""
    torch.manual_seed(0)
    return FieldsRenderer(new_object_field(preset, CPU), EnvironmentField(preset.environment), preset.fields)


def rays(off_axis: list[float]) -> RayBundle:
    """Parallel rays along -z from a plane at z = 3, so far from the axis."""
    origins = torch.tensor([[x, 0.0, 3.0] for x in off_axis])
    return RayBundle(origins, torch.tensor([[0.0, 0.0, -1.0]]).expand(len(off_axis), 3), torch.full((len(off_axis),), 1e-3))


def test_dynamic_weight_is_equation_4_and_passes_no_gradient():
    albedo = torch.tensor([[0.2, 0.5, 0.9], [0.1, 0.1, 0.1]], requires_grad=True)
    light = torch.tensor([[1.0, 1.0, 1.0], [30.0, 30.0, 30.0]], requires_grad=True)
    appearance = Appearance(albedo, light, torch.zeros(2, 1))
    weight = dynamic_weight(appearance, cap=1.5, epsilon=1e-3)
    assert not weight.requires_grad
    torch.testing.assert_close(weight[:, 0], torch.tensor([1.5, 1 / (2.9**2 + 1e-3)]))


def test_a_support_ends_rays_and_hides_the_sdf_below_it():
    fields, seen = renderer(brief_preset()), rays([0.0, 0.8, 1.5])
    above = fields.render(seen, SHARP, None)
    fields.object_field.stand_on(Support(np.array([0.0, 0.0, 1.0]), -0.3))
    out = fields.render(seen, SHARP, None)
    torch.testing.assert_close(out.radiance[[0, 2]], above.radiance[[0, 2]])
    color = fields.object_field.appearance(
        torch.tensor([[0.8, 0.0, -0.3]]), torch.tensor([[0.0, 0.0, 1.0]]), seen.directions[:1]
    ).color
    before, clear, _ = fields.environment.render(
        seen.origins[1:2], seen.directions[1:2], torch.tensor([0.6]), torch.tensor([2.4])
    )
    torch.testing.assert_close(out.radiance[1:2], before + clear[:, None] * color)
    torch.testing.assert_close(out.opacity[1], torch.tensor(0.0), atol=1e-3, rtol=0)
    fields.object_field.stand_on(Support(np.array([0.0, 0.0, 1.0]), 0.7))
    hidden = fields.render(seen, SHARP, None)
    torch.testing.assert_close(hidden.opacity, torch.zeros(3), atol=1e-3, rtol=0)


@pytest.mark.parametrize("support", [None, Support(np.array([0.0, 0.0, 1.0]), -0.3)])
def test_the_background_is_rendered_where_the_object_is_empty(support):
    fields, seen = renderer(brief_preset()), rays([0.0, 0.4, 0.8, 1.5])
    fields.object_field.stand_on(support)
    background = fields.background(seen)
    assert (background - fields.render(seen, SHARP, None).radiance)[:2].abs().max() > 1e-3, "here the object is in front"
    with torch.no_grad():
        fields.object_field.levels[0] += 2
    torch.testing.assert_close(background, fields.render(seen, SHARP, None).radiance)


def test_a_ray_sees_the_environment_the_object_or_both():
    fields, seen = renderer(brief_preset()), rays([0.0, 0.8, 1.5])
    out = fields.render(seen, SHARP, None)
    torch.testing.assert_close(out.opacity, torch.tensor([1.0, 0.0, 0.0]), atol=1e-3, rtol=0)
    near, far = torch.full((3,), 0.6), torch.full((3,), math.inf)
    alone, *_ = fields.environment.render(seen.origins, seen.directions, near, far)
    torch.testing.assert_close(out.radiance[2], alone[2])
    before, clear, _ = fields.environment.render(seen.origins, seen.directions, near, torch.tensor([2.0, 2.4, 9.0]))
    color = fields.object_field.appearance(
        torch.tensor([[0.0, 0.0, 0.6]]), torch.tensor([[0.0, 0.0, 1.0]]), seen.directions[:1]
    ).color
    torch.testing.assert_close(out.radiance[0], before[0] + clear[0] * color[0], rtol=0.02, atol=0)
    leave = torch.tensor([4.0, 3.6, 9.0])
    behind, *_ = fields.environment.render(seen.origins, seen.directions, leave, far)
    torch.testing.assert_close(out.radiance[1], before[1] + clear[1] * behind[1])
    # the mean over the rays that meet the sphere
    torch.testing.assert_close(out.foreground_opacity, (1 - clear[:2]).mean())


def test_rays_for_the_object_alone_do_not_count_beside_it():
    fields, seen = renderer(brief_preset()), rays([0.0, 0.8, 1.5, 0.0, 0.8])
    full, out = fields.render(seen, SHARP, None), fields.render(seen, SHARP, None, clear_rays=3)
    color = fields.object_field.appearance(
        torch.tensor([[0.0, 0.0, 0.6]]), torch.tensor([[0.0, 0.0, 1.0]]), seen.directions[:1]
    ).color
    torch.testing.assert_close(out.radiance[0], color[0], rtol=0.02, atol=0)
    assert out.weight[:, 0].tolist() == [1, 0, 0, 1, 1], "the second ray passes the object, the third one its sphere"
    torch.testing.assert_close(out.radiance[3:], full.radiance[3:])
    torch.testing.assert_close(out.opacity, full.opacity)
    opacity = 1 - fields.front(fields.object_field.shape())(seen)
    torch.testing.assert_close(full.foreground_opacity, opacity[[0, 1, 3, 4]].mean())
    torch.testing.assert_close(out.foreground_opacity, opacity[[3, 4]].sum() / 4)


def test_behind_the_objects_border_the_environment_is_rendered():
    fields, seen = renderer(brief_preset(coarsest_cells=16)), rays([0.601])
    out = fields.render(seen, SHARP, None, clear_rays=1)
    assert 0.1 < out.opacity < 0.9 and out.weight == 1
    full = fields.render(seen, SHARP, None)
    before, clear, _ = fields.environment.render(
        seen.origins, seen.directions, torch.tensor([0.6]), torch.tensor([3 - 0.799])
    )
    torch.testing.assert_close(before + clear[:, None] * out.radiance, full.radiance, rtol=1e-3, atol=0)


def test_distortion_is_that_of_the_segments_that_are_rendered():
    fields, seen = renderer(brief_preset()), rays([0.0, 0.8, 1.5])
    near, far = torch.full((3,), 0.6), torch.full((3,), math.inf)
    before = fields.environment.render(seen.origins, seen.directions, near, torch.tensor([2.0, 2.4, math.inf])).distortion
    behind = fields.environment.render(seen.origins, seen.directions, torch.tensor([4.0, 3.6, 9.0]), far).distortion
    out = fields.render(seen, SHARP, None)
    torch.testing.assert_close(out.distortion, (before.sum() + behind[1]) / 3)  # the object hides what is behind ray 0
    alone = fields.render(seen, SHARP, None, clear_rays=2)
    torch.testing.assert_close(alone.distortion, before[2] / 3)


def test_the_prior_on_opacity_in_front_is_not_scaled_down():
    gradients = []
    for scale in (1.0, 0.1):
        fields = renderer(brief_preset())
        settings = replace(SHARP, environment_gradient_scale=scale)
        fields.render(rays([0.0, 0.8]), settings, None, clear_rays=1).foreground_opacity.backward()
        gradients.append(fields.environment.raw.grad)
    torch.testing.assert_close(gradients[1], gradients[0])
    assert gradients[0].abs().max() > 0


def test_nothing_is_nearer_to_a_camera_than_camera_near():
    opacity = []
    for near in (0.6, 1.2):
        preset = brief_preset()
        preset = replace(preset, environment=replace(preset.environment, camera_near=near))
        opacity.append(renderer(preset).render(rays([0.0]), SHARP, None).foreground_opacity.item())
    assert 0 < opacity[1] < 0.8 * opacity[0]


@pytest.mark.parametrize("on", [False, True])
def test_the_loss_weight_is_w_s_where_the_object_is(on):
    """Elsewhere, and without w_s, it is 1."""
    fields = renderer(brief_preset(dynamic_weight=on))
    weight = fields.render(rays([0.0, 0.1, 0.8, 1.5]), SHARP, None).weight[:, 0]
    assert (weight[2:] == 1).all() and (weight[:2] == 1).all() == (not on)
    capped = renderer(brief_preset(dynamic_weight=on, dynamic_weight_cap=0.5))
    if on:
        assert (capped.render(rays([0.0, 0.1]), SHARP, None).weight < 0.51).all()


def test_without_decomposition_there_is_no_w_s():
    fields = renderer(brief_preset(dynamic_weight=True, decomposition=False))
    assert (fields.render(rays([0.0, 0.1]), SHARP, None).weight == 1).all()


@pytest.mark.parametrize("known", [False, True])
def test_the_gradient_scale_is_for_rays_that_may_show_the_object(known):
    """The object is a ball of radius 0.6. Radiance is not scaled."""
    found = {}
    for scale in (1.0, 0.25):
        for off_axis in (0.5, 0.8, 1.5):
            fields, settings = renderer(brief_preset()), replace(SHARP, environment_gradient_scale=scale)
            out = fields.render(rays([off_axis]), replace(settings, object_is_known=known), None)
            out.radiance.sum().backward()
            found[scale, off_axis] = out.radiance.detach(), fields.environment.raw.grad
    for off_axis, share in ((0.5, 0.25), (0.8, 1.0 if known else 0.25), (1.5, 1.0)):
        (full, gradient), (scaled, smaller) = found[1.0, off_axis], found[0.25, off_axis]
        torch.testing.assert_close(scaled, full)
        assert gradient.abs().max() > 0
        torch.testing.assert_close(smaller, share * gradient, rtol=1e-4, atol=1e-7)


def test_the_curvature_is_not_computed_without_its_loss():
    # an SDF of a sphere of radius r bends by 2 / r^2 in its squared Hessian
    found = renderer(brief_preset()).render(rays([0.0, 0.1, 0.2]), SHARP, None).curvature.item()
    assert found == pytest.approx(math.sqrt(2 / 0.6**2 + 1), rel=0.05)
    assert renderer(brief_preset(curvature=0.0)).render(rays([0.0]), SHARP, None).curvature.item() == 0


def test_what_lies_behind_counts_as_far_as_the_object_is_clear():
    seen, clear = rays([0.0]), replace(SHARP, sharpness=2.0)

    def radiance(limit: float, settings: RenderSettings) -> torch.Tensor:
        return renderer(brief_preset(transmittance_limit=limit)).render(seen, settings, None).radiance

    always, never, default = 0.0, 1.0, brief_preset().fields.transmittance_limit
    torch.testing.assert_close(radiance(default, SHARP), radiance(always, SHARP), rtol=1e-3, atol=0)
    assert (radiance(default, clear) > 1.01 * radiance(never, clear)).all()
