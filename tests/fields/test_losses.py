"""The losses of stage 1: what highlights count, what each weight does."""

import math
from dataclasses import replace

import pytest
import torch

from blender_nep.capture import PixelRays, load_capture
from blender_nep.fields.losses import FieldsLosses, highlight_threshold
from blender_nep.fields.rendering import Rendering
from blender_nep.presets import EnvironmentPreset, FieldsPreset
from blender_nep.tone_mapping import HIGHLIGHT, tone_map, tone_map_without_highlights
from support.paths import SUZANNE_SMALL

PRESET, ENVIRONMENT = FieldsPreset(), EnvironmentPreset()


@pytest.fixture(scope="module")
def rays():
    return PixelRays.from_capture(load_capture(SUZANNE_SMALL), 10_000, False)


@pytest.fixture(scope="module")
def masked_rays():
    return PixelRays.from_capture(load_capture(SUZANNE_SMALL), 10_000, True)


def rendering(radiance: torch.Tensor, opacity: list[float], weight: float = 1.0) -> Rendering:
    """With an eikonal loss of 2, a curvature of 3, a foreground opacity of 0.5 and a distortion of 0.25."""
    opacities = torch.tensor(opacity)
    scalars = (torch.tensor(2.0), torch.tensor(3.0), torch.tensor(0.5), torch.tensor(0.25))
    return Rendering(radiance, opacities, torch.full((len(opacities), 1), weight), *scalars)


@pytest.mark.parametrize("white", [0.4, 3.0])
def test_highlights_count_little_but_never_nothing(white):
    radiance = torch.cat([torch.linspace(0, white, 200), torch.logspace(0, 5, 200)[1:] * white]).double().requires_grad_()
    mapped = tone_map_without_highlights(radiance, white)
    torch.testing.assert_close(mapped[:200], tone_map(radiance[:200]))
    assert (mapped.diff() > 0).all()
    (slope,) = torch.autograd.grad(mapped.sum(), radiance)
    relative = slope * radiance.detach()  # what a highlight e times as bright adds
    torch.testing.assert_close(relative[200:], torch.full_like(relative[200:], HIGHLIGHT))
    assert float(relative[198]) > 5 * HIGHLIGHT
    torch.testing.assert_close(tone_map_without_highlights(radiance, math.inf), tone_map(radiance))


def test_lamps_count_in_full_where_the_object_does_not_hide_them():
    losses = FieldsLosses(PRESET, ENVIRONMENT, highlight_threshold=2.0)
    lamp = torch.full((3, 3), 100.0)
    compared = losses.difference(rendering(lamp, [0.0, 0.5, 1.0]), 0.5 * lamp)[:, 0]
    full, dull = float((tone_map(lamp) - tone_map(0.5 * lamp))[0, 0]), HIGHLIGHT * math.log(2)
    torch.testing.assert_close(compared, torch.tensor([full, (full + dull) / 2, dull]))


def test_the_photometric_loss_is_weighted():
    losses = FieldsLosses(PRESET, ENVIRONMENT, highlight_threshold=2.0)
    radiance, photo = torch.full((2, 3), 0.4), torch.full((2, 3), 0.1)
    once, thrice = (losses.photometric(rendering(radiance, [0.0, 0.7], weight), photo) for weight in (1.0, 3.0))
    torch.testing.assert_close(once, (tone_map(radiance) - tone_map(photo)).mean())
    torch.testing.assert_close(thrice, 3 * once)


def test_each_prior_counts_by_its_weight():
    out, photometric = rendering(torch.zeros(2, 3), [0.2, 0.9]), torch.tensor(0.1)
    mask = torch.tensor([0.0, 1.0])

    def total(preset=PRESET, curvature=5e-4, distortion=0.03, mask=None, **changed) -> float:
        losses = FieldsLosses(preset, replace(ENVIRONMENT, **changed), 2.0)
        return float(losses.total(photometric, out, curvature, distortion, mask))

    plain = total()
    assert plain == pytest.approx(0.1 + 2 * PRESET.eikonal + 3 * 5e-4 + 0.5 * ENVIRONMENT.foreground_opacity + 0.25 * 0.03)
    assert plain - total(replace(PRESET, eikonal=0.0)) == pytest.approx(2 * PRESET.eikonal, rel=1e-4)
    assert plain - total(curvature=0.0) == pytest.approx(3 * 5e-4, rel=1e-3)
    assert plain - total(foreground_opacity=0.0) == pytest.approx(0.5 * ENVIRONMENT.foreground_opacity, rel=1e-4)
    assert plain - total(distortion=0.0) == pytest.approx(0.25 * 0.03, rel=1e-4)
    entropy = -(math.log(0.8) + math.log(0.9)) / 2
    assert total(mask=mask) - plain == pytest.approx(PRESET.mask * entropy, rel=1e-4)
    assert total(replace(PRESET, mask=0.0), mask=mask) == plain


@pytest.mark.parametrize("cut", [False, True])
def test_a_highlight_stands_out_of_what_is_shown_not_of_black(rays, masked_rays, cut):
    black = replace(rays, radiance=rays.radiance * (masked_rays.mask > 127)[:, None], mask=masked_rays.mask if cut else None)
    shown = masked_rays.radiance[(masked_rays.mask > 127) & masked_rays.valid]
    found = highlight_threshold(black, PRESET) / PRESET.highlight_threshold
    assert found == pytest.approx(float(shown.clamp(min=1e-6).log().mean().exp()), rel=0.15)
    bright = replace(rays, radiance=1000 * rays.radiance)
    assert highlight_threshold(bright, PRESET) == pytest.approx(1000 * highlight_threshold(rays, PRESET), rel=1e-3)
