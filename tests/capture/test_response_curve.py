"""The camera's response curve: its inverse, its limits, and what it makes of the pixels of photos."""

import pytest
import torch

from blender_nep.capture import PixelRays, load_capture
from blender_nep.capture.rays.response_curve import MOST_STRENGTH, ResponseCurve

STRENGTHS = (0.0, 0.3, 1.0, MOST_STRENGTH)
VALUES = torch.cat([torch.zeros(1), torch.logspace(-4, 0.5, 200)]).double()


@pytest.mark.parametrize("strength", STRENGTHS)
def test_light_and_photo_are_inverse(strength):
    curve = ResponseCurve.of(strength, white=1.7, middle=0.2)
    torch.testing.assert_close(curve.photo(curve.light(VALUES)), VALUES, rtol=1e-9, atol=1e-12)


def test_without_strength_photos_are_light():
    torch.testing.assert_close(ResponseCurve.of(0.0, 1.7, 0.2).light(VALUES), VALUES, rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("strength", STRENGTHS)
def test_the_middle_stays_and_brighter_stays_brighter(strength):
    curve = ResponseCurve.of(strength, white=1.7, middle=0.2)
    assert float(curve.light(torch.tensor(0.2))) == pytest.approx(0.2, rel=1e-5)
    assert (curve.light(VALUES).diff() > 0).all()


def test_a_typical_camera_is_as_iso_12232_says():
    curve = ResponseCurve(1.0, white=1.0, scale=1.0)
    assert float(curve.photo(torch.tensor(0.127))) == pytest.approx(0.18, abs=0.01)
    gray = torch.tensor([0.127, 0.127 * 1.01]).double()
    slope = curve.photo(gray).log().diff() / gray.log().diff()
    assert 1.1 < float(slope) < 1.2


@pytest.mark.parametrize("strength", STRENGTHS)
def test_beyond_white_light_grows_in_proportion(strength):
    curve = ResponseCurve.of(strength, white=1.7, middle=0.2)
    white, twice, five = curve.light(1.7 * torch.tensor([1.0, 2.0, 5.0]).double()).tolist()
    assert twice == pytest.approx(2 * white, rel=1e-9) and five == pytest.approx(5 * white, rel=1e-9)
    below = float(curve.light(torch.tensor(1.7 * (1 - 1e-9)).double()))
    assert below == pytest.approx(white, rel=1e-6), "the curve does not jump at white"


@pytest.mark.parametrize("strength", [-0.1, MOST_STRENGTH + 0.1, float("nan")])
def test_a_strength_out_of_range_is_refused(strength):
    with pytest.raises(ValueError, match="strength"):
        ResponseCurve.of(strength, 1.0, 0.2)


def test_pixels_are_the_light_before_the_curve(make_capture):
    rays = PixelRays.from_capture(load_capture(make_capture(views=4, size=16).folder), 1000, False).with_exposure(2.0)
    index = torch.arange(rays.count)
    curve = ResponseCurve.of(1.0, rays.exposure, 0.3)
    lit = rays.with_response(curve)
    torch.testing.assert_close(curve.photo(lit.photo(index)), rays.photo(index))
    assert not torch.allclose(lit.photo(index), rays.photo(index))


def test_a_damaged_curve_of_a_checkpoint_is_refused():
    curve = ResponseCurve.of(1.0, white=1.7, middle=0.2)
    assert ResponseCurve.from_state(curve.state()) == curve
    for wrong in ({"strength": -4.0}, {"white": 0.0}, {"scale": float("nan")}):
        with pytest.raises(ValueError, match="response curve"):
            ResponseCurve.from_state(curve.state() | wrong)
