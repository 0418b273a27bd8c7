"""Exposures from EXIF, and what of them counts."""

from dataclasses import dataclass

import numpy as np
import pytest
import torch
from PIL import ExifTags
from PIL.TiffImagePlugin import IFDRational

from blender_nep.capture.exposure.from_exif import exif_gains, exposures_from_exif, exposures_of
from blender_nep.capture.exposure.surroundings import Exposures

SECONDS = (IFDRational(1, 100), IFDRational(1, 50), IFDRational(1, 25), IFDRational(1, 100))
ISO_400 = {ExifTags.Base.ISOSpeedRatings: 400, ExifTags.Base.FNumber: IFDRational(8)}
GAINS = np.exp(np.array([-0.5, 0.0, 0.2, 0.3, -0.3, 0.3]))
ONE_SESSION = np.zeros(6, int)
TWO_SESSIONS = np.array([0, 0, 0, 1, 1, 1])


@dataclass
class Surroundings:
    """What surroundings tell: logarithms [views, 3] of gains that fit best. They differ by `least` with these."""

    log: np.ndarray
    least: float = 0.3
    vignetting = None

    def rest(self, log):
        return self.least + np.abs(log - self.log).mean()

    def exposures(self, device):
        return Exposures(torch.from_numpy(self.log).exp().to(device))


def surroundings(gray, balance=0.0, least=0.3):
    log = gray[:, None] + balance + np.zeros(3)
    return Surroundings(log - log.mean(0), least)


def logs(exposures):
    return exposures.gain.double().log().numpy()


def test_gains_come_from_time_iso_and_f_number(taken):
    said = [ISO_400 | {ExifTags.Base.ExposureTime: seconds} for seconds in SECONDS]
    said[3] |= {ExifTags.Base.ISOSpeedRatings: 800, ExifTags.Base.FNumber: IFDRational(4)}
    relative = np.array([1, 2, 4, 8.0])
    np.testing.assert_allclose(exif_gains(taken(".jpg", *said)), relative / relative.prod() ** 0.25, rtol=1e-6)


@pytest.mark.parametrize("missing", [*ISO_400, ExifTags.Base.ExposureTime])
def test_one_photo_without_all_three_is_enough(taken, missing):
    whole = ISO_400 | {ExifTags.Base.ExposureTime: IFDRational(1, 60)}
    less = {tag: value for tag, value in whole.items() if tag != missing}
    assert exif_gains(taken(".jpg", whole, whole, less, whole)) is None


def test_exif_counts_where_the_surroundings_agree():
    near = surroundings(np.log(GAINS) + np.array([0.1, -0.1, 0.05, -0.05, 0, 0]))
    for compared in (None, near):
        found = exposures_from_exif(GAINS, ONE_SESSION, compared, "cpu")
        np.testing.assert_allclose(logs(found), np.log(GAINS)[:, None].repeat(3, 1), atol=1e-6)


def test_exif_does_not_count_with_a_flash():
    assert exposures_from_exif(GAINS, ONE_SESSION, surroundings(np.zeros(6), least=0.1), "cpu") is None


def test_equal_exposures_in_exif_overrule_a_carpet():
    """Surroundings that look brighter from some sides agree only a little better with gains."""
    sheen = surroundings(np.array([-0.3, 0.0, 0.3, 0.3, 0.0, -0.3]), least=1.0)
    found = exposures_from_exif(np.ones(6), ONE_SESSION, sheen, "cpu")
    assert found is not None and found.gain is None


def test_equal_exposures_in_exif_hide_no_changed_photos():
    changed = surroundings(np.array([-0.5, 0.0, 0.5, 0.5, 0.0, -0.5]), least=0.1)
    assert exposures_from_exif(np.ones(6), ONE_SESSION, changed, "cpu") is None


def test_the_surroundings_tell_how_bright_a_session_was():
    day = np.array([0.4, 0.4, 0.4, -0.4, -0.4, -0.4])
    within = np.log(GAINS) - np.repeat([np.log(GAINS)[:3].mean(), np.log(GAINS)[3:].mean()], 3)
    found = exposures_from_exif(GAINS, TWO_SESSIONS, surroundings(within + day), "cpu")
    np.testing.assert_allclose(logs(found), (within + day)[:, None].repeat(3, 1), atol=1e-6)
    alone = exposures_from_exif(GAINS, TWO_SESSIONS, None, "cpu")
    np.testing.assert_allclose(logs(alone), within[:, None].repeat(3, 1), atol=1e-6)


def test_a_white_balance_counts_as_much_as_exif_agrees():
    balance = 0.2 * np.array([[1, 0, -1], [-1, 0, 1], [1, -2, 1], [-1, 2, -1], [1, 0, -1], [-1, 0, 1.0]])
    off = np.array([0.2, -0.2, 0.2, -0.2, 0.2, -0.2])
    for doubt in (0.0, 0.05, 0.2):
        compared = surroundings(np.log(GAINS) + doubt * off / 0.2, balance, least=1.0)
        found = logs(exposures_from_exif(GAINS, ONE_SESSION, compared, "cpu"))
        share = 0.05**2 / (0.05**2 + doubt**2)  # of the deviations from the medians, which are 0 but in one color
        np.testing.assert_allclose((found - found.mean(1, keepdims=True))[:, 0], share * balance[:, 0], atol=1e-6)


def test_the_white_balance_of_a_session_counts():
    lamps = 0.2 * np.array([[1, 0, -1]] * 3 + [[-1, 0, 1]] * 3)
    found = exposures_from_exif(GAINS, TWO_SESSIONS, surroundings(np.log(GAINS), lamps), "cpu")
    np.testing.assert_allclose(logs(found) - np.log(GAINS)[:, None], lamps, atol=1e-6)


def test_without_exif_the_surroundings_count(taken):
    capture = taken(".jpg", {})
    assert exposures_of(capture, None) == Exposures(None)
    compared = surroundings(np.array([0.5, -0.5, 0.25, -0.25]))
    assert torch.equal(exposures_of(capture, compared).gain, compared.exposures("cpu").gain)
