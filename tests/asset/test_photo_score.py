"""The score of pixels of an asset against photos: closed forms of gain, hue and PSNR."""

import math

import numpy as np
import pytest

from blender_nep.asset.photo_score import gain_of, photo_score

RANDOM = np.random.default_rng(3)


def encoded(x: float) -> float:
    return 1.055 * x ** (1 / 2.4) - 0.055


def pixels(count: int = 400) -> np.ndarray:
    return RANDOM.uniform(0.05, 0.9, (count, 3))


def test_a_right_asset_scores_best_at_any_brightness():
    shown = pixels()
    found = photo_score(shown, 0.37 * shown, np.zeros(len(shown), int))
    assert found.psnr == pytest.approx(100) and found.hue_deg == pytest.approx(0, abs=1e-4)
    assert found.gains == {0: pytest.approx(1 / 0.37)} and found.pixels == 400


def test_each_photo_has_its_own_gain():
    shown, photo = pixels(), np.repeat([4, 9], 200)
    found = photo_score(shown, shown / np.where(photo == 4, 2.0, 0.5)[:, None], photo)
    assert found.gains == {4: pytest.approx(2.0), 9: pytest.approx(0.5)} and found.psnr == pytest.approx(100)


def test_the_gain_is_exact_where_few_pixels_are_wrong():
    shown = pixels()
    asset = shown / 1.7
    asset[:60] *= RANDOM.uniform(0, 4, (60, 1))
    assert gain_of(shown, asset) == pytest.approx(1.7, rel=1e-6)


def test_a_wrong_hue_costs_what_the_closed_form_says():
    # gray pixels of one brightness: the exposure makes them 0.8; the asset lacks 30 % of the red
    shown, asset = np.full((50, 3), 0.2), np.tile([0.7, 1.0, 1.0], (50, 1))
    found = photo_score(shown, asset, np.zeros(50, int))
    gain = 0.6 / 2.7
    assert found.gains[0] == pytest.approx(gain)
    assert found.hue_deg == pytest.approx(math.degrees(math.acos(2.7 / math.sqrt(3 * 2.49))))
    values = [min(4 * gain * 0.7, 1), min(4 * gain, 1), min(4 * gain, 1)]
    squared = np.mean([(encoded(value) - encoded(0.8)) ** 2 for value in values])
    assert found.psnr == pytest.approx(-10 * math.log10(squared), abs=1e-3)


def test_a_black_asset_explains_nothing():
    shown = pixels()
    found = photo_score(shown, np.zeros_like(shown), np.zeros(len(shown), int))
    assert found.gains == {0: 1.0} and found.psnr < 8 and found.hue_deg is None


def test_a_photo_of_few_pixels_does_not_count():
    shown, photo = pixels(20), np.array([0] * 15 + [1] * 5)
    asset = shown.copy()
    asset[15:] = 0
    found = photo_score(shown, asset, photo)
    assert list(found.gains) == [0] and found.pixels == 15 and found.psnr == pytest.approx(100)
    assert photo_score(shown[15:], asset[15:], photo[15:]) is None
