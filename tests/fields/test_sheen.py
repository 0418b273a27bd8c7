"""The sheen of a table: a known one is found again, and none where there is none."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from blender_nep.support.light import SupportLight
from blender_nep.support.plane import Support
from blender_nep.support.sheen import MOST, Sheen
from blender_nep.support.texture import PlaneTexture

SLOPE = torch.tensor([[0.4, 0.2, -0.1], [-0.3, 0.3, 0.5], [-0.5, -0.2, -0.4]])
"""Change of the logarithm along x, y, z (rows) of red, green, blue"""


@pytest.fixture
def carpet():
    """Colors [12, 200, 3] of 200 places in 12 photos, without sheen, and the directions [12, 200, 3] to the cameras."""
    generator = torch.Generator().manual_seed(3)
    towards = torch.randn(12, 200, 3, generator=generator)
    towards[..., 2] = towards[..., 2].abs() + 0.1
    color = 0.05 + 0.5 * torch.rand(200, 3, generator=generator)
    noise = torch.exp(0.02 * torch.randn(12, 200, 3, generator=generator))
    return color * noise, torch.nn.functional.normalize(towards, dim=-1)


def hidden(colors: torch.Tensor) -> torch.Tensor:
    """The same colors; each photo shows two of three places."""
    shown = (torch.arange(colors.shape[1]) + torch.arange(len(colors))[:, None]) % 3 > 0
    return torch.where(shown[..., None], colors, torch.nan)


def test_a_known_sheen_is_found_again(carpet):
    colors, towards = carpet
    found = Sheen.of(hidden(colors * (towards @ SLOPE).exp()), towards)
    torch.testing.assert_close(found.slope, SLOPE, atol=0.03, rtol=0)
    torch.testing.assert_close(found.factor(towards), (towards @ SLOPE).exp(), rtol=0.05, atol=0)


def test_highlights_and_shadows_in_some_photos_hardly_count(carpet):
    colors, towards = carpet
    spoiled = colors * (towards @ SLOPE).exp()
    spoiled[2:4, :60] *= 6
    spoiled[7, 100:] *= 0.2
    torch.testing.assert_close(Sheen.of(spoiled, towards).slope, SLOPE, atol=0.12, rtol=0)


@pytest.mark.parametrize("photos", [12, 3])
def test_a_dull_table_and_few_photos_have_no_sheen(carpet, photos):
    colors, towards = (values[:photos] for values in carpet)
    assert Sheen.of(hidden(colors), towards) is None


def test_what_differs_from_photo_to_photo_is_no_sheen(carpet):
    colors, towards = carpet
    gain = torch.exp(0.4 * torch.randn(12, 1, 1, generator=torch.Generator().manual_seed(5)))
    assert Sheen.of(hidden(colors * gain), towards) is None


def test_no_direction_is_beyond_the_largest_factor():
    steep = Sheen(10 * SLOPE)
    factor = steep.factor(torch.nn.functional.normalize(torch.randn(50, 3), dim=-1))
    assert float(factor.log().abs().max()) <= MOST + 1e-5


def test_a_cone_sees_the_table_with_its_sheen():
    support = Support(np.array([0.0, 0.0, 1.0]), -0.5)
    color = torch.tensor([0.2, 0.3, 0.4]).expand(8, 8, 3)
    plain = SupportLight(PlaneTexture(support, 1.0, color, torch.ones(8, 8, dtype=torch.bool)))
    light = SupportLight(plain.texture, Sheen(SLOPE))
    direction = torch.nn.functional.normalize(torch.tensor([[0.3, 0.1, -0.6], [-0.5, 0.2, -0.4]]), dim=-1)
    origin, angle = torch.zeros(2, 3), torch.full((2,), 0.05)
    seen, meets = light.query_cone(origin, direction, angle)
    assert meets.all()
    torch.testing.assert_close(seen, color[0, :2] * (-direction @ SLOPE).exp())

    root = light.with_colors(torch.sqrt)
    torch.testing.assert_close(root.query_cone(origin, direction, angle)[0], seen.sqrt(), rtol=1e-4, atol=0)
    same = replace(plain.texture, color=plain.texture.color.sqrt())
    torch.testing.assert_close(plain.with_colors(torch.sqrt).texture.color, same.color)
