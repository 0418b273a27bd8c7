"""What a camera makes of light, and what EXIF says of it: pure functions against closed forms."""

import io
from datetime import datetime

import numpy as np
import pytest
from PIL import ExifTags, Image

from backend.scene_io.srgb import linear_to_srgb, srgb_to_linear
from backend.synthetic_capture.files.exif import exif
from backend.synthetic_capture.photograph import effects
from backend.synthetic_capture.photograph.development import (
    FULL_WELL,
    LUMA,
    READ_NOISE,
    Look,
    blurred,
    developed,
    noisy,
    s_curve,
    saturated,
    toned,
    with_detail,
)
from backend.synthetic_capture.photograph.settings import (
    F_NUMBERS,
    ISOS,
    SHARE_OF_BALANCE,
    balance_of_day,
    draw_look,
    draw_settings,
)

ALL = frozenset(effects.EFFECTS)


def tags_of(segment: bytes) -> dict[int, object]:
    """What PIL reads from a JPEG file with this segment."""
    file = io.BytesIO()
    Image.new("RGB", (8, 8)).save(file, "JPEG")
    with Image.open(io.BytesIO(file.getvalue()[:2] + segment + file.getvalue()[2:])) as image:
        return dict(image.getexif().get_ifd(ExifTags.IFD.Exif))


@pytest.mark.parametrize("iso", [100, 6400])
@pytest.mark.parametrize("level", [0.0, 0.02, 0.7])
def test_noise_is_that_of_electrons_and_of_reading(iso, level):
    rng = np.random.default_rng(0)
    pixels = noisy(np.full(400_000, level), iso, rng)
    electrons = FULL_WELL * 100 / iso
    expected = (level * electrons + READ_NOISE**2) / electrons**2
    assert pixels.var() == pytest.approx(expected, rel=0.02)
    assert pixels.mean() == pytest.approx(level, abs=5 * (expected / len(pixels)) ** 0.5)


@pytest.mark.parametrize("seed", range(5))
def test_the_tone_curve_rises_and_can_be_inverted(seed):
    look, x = draw_look(ALL, seed), np.linspace(0, 1, 1001)
    y = toned(x, look)
    assert (y[0], y[-1]) == (0, 1) and (np.diff(y) > 0).all()
    np.testing.assert_allclose(s_curve(y, 1 / look.contrast) ** (1 / look.lift), x, atol=1e-9)
    assert np.abs(y - x).max() > 0.03


def test_a_plain_development_is_the_srgb_curve():
    radiance = np.random.default_rng(0).uniform(0, 3, (6, 5, 3))
    expected = linear_to_srgb(0.5 * radiance)
    np.testing.assert_allclose(developed(radiance, 0.5), expected)
    np.testing.assert_allclose(developed(radiance, 0.5, look=Look()), expected, atol=1e-12)


def test_saturation_keeps_luma_and_grays():
    pixels = np.random.default_rng(0).random((4, 3, 3))
    more = saturated(pixels, 1.3)
    np.testing.assert_allclose(more @ LUMA, pixels @ LUMA)
    np.testing.assert_allclose(more - (pixels @ LUMA)[..., None], 1.3 * (pixels - (pixels @ LUMA)[..., None]))


def test_detail_is_what_a_gaussian_takes_away():
    impulse = np.zeros((41, 41))
    impulse[20, 20] = 1
    places = np.arange(-20, 21)
    spread = 9 - places[:, None] ** 2 - places[None] ** 2
    found = blurred(impulse, 3.0)
    np.testing.assert_allclose(found.sum(), 1)
    np.testing.assert_allclose(found[14:27, 14:27], np.exp((spread - 9) / 18)[14:27, 14:27] / (18 * np.pi), rtol=0.01)
    ramp = np.repeat(np.linspace(0.2, 0.8, 41)[None, :, None], 41, 0) * np.ones(3)
    np.testing.assert_allclose(with_detail(ramp, 0.7, 2.0)[:, 8:-8], ramp[:, 8:-8], atol=1e-12)
    step = np.where(places < 0, 0.3, 0.6)[None, :, None] * np.ones((41, 1, 3))
    sharp = with_detail(step, 0.5, 2.0)[20, :, 0]
    assert sharp[19] < 0.27 and sharp[20] > 0.63 and abs(sharp[0] - 0.3) < 1e-6


def test_exif_ratios_are_the_ratios_of_pixels():
    radiance = np.full((4, 4, 3), 0.11)
    gains = [2.0**stops for stops in (-1.2, -0.4, 0.0, 0.3, 1.1)]
    said = []
    for gain, settings in zip(gains, draw_settings(ALL, 3, len(gains)), strict=True):
        found = tags_of(exif(settings.tags(gain, 41)))
        seconds, f_number = (float(found[tag]) for tag in (ExifTags.Base.ExposureTime, ExifTags.Base.FNumber))
        assert f_number == pytest.approx(settings.f_number) and found[ExifTags.Base.ISOSpeedRatings] == settings.iso
        assert found[ExifTags.Base.FocalLengthIn35mmFilm] == 41
        said.append(seconds * settings.iso / f_number**2)
    pixels = [srgb_to_linear(developed(radiance, gain)).mean() for gain in gains]
    np.testing.assert_allclose(np.array(said) / said[2], np.array(pixels) / pixels[2], rtol=2e-3)
    assert len({(settings.iso, settings.f_number) for settings in draw_settings(ALL, 3, 5)}) > 2


def test_an_effect_draws_the_same_alone_and_among_others():
    together = draw_settings(ALL, 7, 60)
    for effect, name in (("noise", "iso"), ("aperture", "f_number"), ("exposure", "stops"), ("two_days", "day")):
        alone = draw_settings(effects.chosen([effect]), 7, 60)
        assert [getattr(one, name) for one in alone] == [getattr(one, name) for one in together]
        assert len({getattr(one, name) for one in alone}) > 1
    assert draw_look(frozenset({"curve"}), 7) == draw_look(ALL, 7) != draw_look(ALL, 8)
    assert draw_look(frozenset({"noise"}), 7) is None
    assert {settings.iso for settings in together} == set(ISOS)
    assert all(F_NUMBERS[0] <= settings.f_number <= F_NUMBERS[1] for settings in together)


def test_the_second_day_is_the_last_third_and_exif_says_so():
    drawn = draw_settings(effects.chosen(["two_days"]), 0, 9)
    assert [settings.day for settings in drawn] == [0] * 6 + [1] * 3
    said = [tags_of(exif(one.tags(1.0, 40)))[ExifTags.Base.DateTimeOriginal] for one in drawn]
    times = [datetime.strptime(text, "%Y:%m:%d %H:%M:%S") for text in said]
    assert times == sorted(times) and len({time.date() for time in times}) == 2
    assert times[6].date() > times[5].date()


def test_the_white_balance_evens_out_a_part_of_another_light():
    lamp, window = np.array([0.5, 0.25, 0.1]), np.array([0.2, 0.2, 0.22])
    gains = np.array(balance_of_day(lamp, window))
    left = lamp * gains / window
    assert gains[1] == 1
    np.testing.assert_allclose(left / left[1], ((lamp / window) / (lamp / window)[1]) ** (1 - SHARE_OF_BALANCE))


def test_groups_stand_for_their_effects():
    assert effects.chosen(["all"]) == ALL
    assert effects.chosen(["camera", "room"]) == {"room", *effects.DEVELOPMENT}
    assert effects.chosen(["object"]) == {"long", "materials"}
    assert effects.chosen(["two_days"]) == {"two_days", "jpeg"}
    assert not effects.develops(effects.SCENE) and effects.develops(["noise", "room"])
