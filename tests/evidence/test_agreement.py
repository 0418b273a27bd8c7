"""The ways in which photos agree on a color, on colors whose answers are known."""

import numpy as np
import pytest
import torch

from blender_nep.evidence.agreement import difference, majority, median_of_photos, spread, variation, views_that_show
from blender_nep.evidence.observation import Observation

NAN = torch.nan


def gray(*values: float) -> torch.Tensor:
    """Colors [views, 1, 3] of one point."""
    return torch.tensor(values)[:, None, None].expand(-1, 1, 3).clone()


def test_a_majority_is_the_largest_group_of_alike_photos():
    found = majority(gray(0.2, 0.22, 0.21, 0.6, 0.6, NAN))
    torch.testing.assert_close(found.color, torch.full((1, 3), 0.21))
    assert found.share.item() == pytest.approx(3 / 5) and found.views.item() == 5


def test_no_photo_has_no_majority():
    found = majority(gray(NAN, NAN))
    assert (found.color == 0).all() and found.share.item() == 0 and found.views.item() == 0


def test_majorities_of_many_points_are_those_of_each():
    colors = torch.rand(9, 1100, 3, generator=torch.Generator().manual_seed(0)) * 0.1
    colors[torch.rand(9, 1100, generator=torch.Generator().manual_seed(1)) < 0.3] = NAN
    whole = majority(colors)
    for k in (0, 511, 512, 1099):
        for one, same in zip(majority(colors[:, k : k + 1]), whole, strict=True):
            torch.testing.assert_close(one[0], same[k])


def test_spread_is_by_channel_and_difference_by_photo():
    """Each of three photos is wrong in another channel. The median of every channel is right."""
    colors = gray(0.3, 0.3, 0.3)
    for k in range(3):
        colors[k, 0, k] = 0.6
    median = median_of_photos(colors)
    torch.testing.assert_close(median, torch.full((1, 3), 0.3))
    assert spread(colors).item() == 0 and difference(colors, median).item() == pytest.approx(0.1)


def test_photos_that_do_not_show_a_point_do_not_count():
    colors = gray(0.1, 0.2, 0.6, NAN, NAN)
    median = median_of_photos(colors)
    assert median[0, 0].item() == pytest.approx(0.2) and views_that_show(colors).item() == 3
    assert spread(colors).item() == pytest.approx(0.1) and difference(colors, median).item() == pytest.approx(0.1)


def test_variation_is_the_relative_deviation_of_brightness():
    nothing = torch.zeros(0, 3)

    def seen(view: int, index: list[int], values: list[float]) -> Observation:
        color = torch.tensor(values)[:, None] * torch.tensor([0.5, 1.0, 1.5])
        return Observation(view, torch.tensor(index), nothing, nothing, color)

    varies, views = variation([seen(0, [0, 2], [1.0, 0.4]), seen(1, [0, 2], [3.0, 0.4]), seen(2, [2], [0.4])], 3)
    np.testing.assert_allclose(varies, [0.5, 0, 0], atol=1e-6)
    assert views.tolist() == [2, 0, 3]
