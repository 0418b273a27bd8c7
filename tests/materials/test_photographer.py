"""The photographer takes light from the object: how much is found in the photos, and does not become a darker material."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from blender_nep.materials import training
from blender_nep.materials.evidence.held_out import standard_errors
from blender_nep.materials.palette.photographer import found_strength
from blender_nep.shading.photographer import Photographer
from support.lit_ball import PRESET, constant, learn, make_photos

BRONZE = (0.7, 0.5, 0.3), 0.35, 1.0
STRENGTH = 1.2
UP = torch.tensor([0.0, 0.0, 1.0])


@pytest.fixture(scope="module")
def photos():
    return make_photos(constant(*BRONZE), views=16, photographer=Photographer(STRENGTH, UP))


def test_the_strength_is_found_and_the_albedo_is_right(ball, photos, monkeypatch):
    asked = []

    def noted(*given):
        asked.append(given)
        return found_strength(*given)

    monkeypatch.setattr(training, "found_strength", noted)
    found = learn(ball, photos)
    assert found.report["photographer"] == pytest.approx(STRENGTH, abs=0.3)
    np.testing.assert_allclose(found.albedo.reshape(-1, 3).mean(0), BRONZE[0], rtol=0.05)
    samples, light, preset = asked[0]
    strength, errors = found_strength(samples, light, preset)
    too_strong, same = found_strength(samples, light.behind(3.0), preset)
    assert too_strong == pytest.approx(strength, abs=0.01) and same == pytest.approx(errors, rel=0.02)


@pytest.mark.slow
def test_without_it_the_material_is_too_dark(ball, photos):
    found = learn(ball, photos, replace(PRESET, photographer=False))
    assert found.report["skipped"]["photographer"]["code"] == "reason.preset" and "photographer" not in found.report
    assert found.albedo.reshape(-1, 3).mean() < 0.93 * np.mean(BRONZE[0])


def test_nobody_is_found_where_nobody_stood(ball):
    found = learn(ball, make_photos(constant(*BRONZE), views=16))
    assert found.report["skipped"]["photographer"]["code"] == "reason.no_photographer"
    errors = found.report["photographer_errors"]
    assert min(errors, key=errors.get) == "0" and len(errors) == 2, "the others were not tried"


def test_a_gain_of_one_photo_is_not_sure():
    """A photo of many samples gains as much as all others lose, or a little more."""
    shown = torch.tensor([0, 100, 100, 100, 400])
    assert standard_errors(torch.tensor([0.0, 1.0, 0.9, 1.1, 4.2]), shown) > 5
    assert 0 < standard_errors(torch.tensor([0.0, -1.0, -0.9, -1.1, 6.0]), shown) < 2
    assert standard_errors(torch.tensor([0.0, -1.0, -0.9, -1.1, -4.2]), shown) < -5
    assert standard_errors(torch.tensor([1.0, 0.0]), torch.tensor([50, 0])) == 0
