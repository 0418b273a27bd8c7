"""How much brighter the object is in some photos: known gains are found again, and equal photos are left alone."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from blender_nep.materials.photo_gains import LEAST_SPREAD, gains_of_photos
from blender_nep.materials.samples.photo_samples import PhotoSamples
from support.lit_ball import PRESET, constant, learn, make_photos

BRONZE = (0.35, 0.2, 0.08), 0.2, 1.0
PHOTOS, REGIONS, N = 12, 40, 3000


def samples_of(gain, seed=0):
    """Samples with these gains [photos], the radiance that is predicted, and their regions.

    Regions may be brighter than predicted, and noise is a fifth. Each photo shows a part of the regions.
    """
    random = torch.Generator().manual_seed(seed)
    photo = torch.randint(PHOTOS, (N,), generator=random)
    region = (photo * 3 + torch.randint(REGIONS // 2, (N,), generator=random)) % REGIONS
    predicted = 0.1 + torch.rand(N, 3, generator=random)
    patina = torch.exp(0.3 * torch.randn(REGIONS, generator=random))
    noise = torch.exp(0.2 * torch.randn(N, generator=random))
    radiance = predicted * (gain[photo] * patina[region] * noise)[:, None]
    radiance[::25] *= 5  # highlights that nobody predicts
    nothing = np.zeros((N, 3), np.float32)
    return (
        PhotoSamples(np.zeros(N, int), nothing, nothing, torch.zeros(N, 3), photo, radiance, torch.zeros(N), {}),
        predicted,
        region,
    )


def found_for(gain, seed=0):
    samples, predicted, region = samples_of(gain, seed)
    return gains_of_photos(samples, predicted, region, torch.ones(N), PHOTOS)


@pytest.mark.parametrize("seed", range(3))
def test_known_gains_are_found_again(seed):
    log = 0.25 * torch.randn(PHOTOS, generator=torch.Generator().manual_seed(9 + seed))
    found = found_for(log.exp(), seed).log()
    torch.testing.assert_close(found - found.mean(), log - log.mean(), atol=0.08, rtol=0)


def test_equally_bright_photos_are_left_alone():
    assert found_for(torch.ones(PHOTOS)) is None
    assert found_for((torch.arange(PHOTOS) % 2 * 0.8 * LEAST_SPREAD).exp()) is None


def test_a_photo_with_one_sample_keeps_its_gain():
    samples, predicted, region = samples_of(torch.tensor([1.0, 1.6] * (PHOTOS // 2)))
    samples.photo[samples.photo == 3] = 5
    samples.photo[0] = 3
    samples.radiance[0] *= 1.5
    found = gains_of_photos(samples, predicted, region, torch.ones(N), PHOTOS)
    assert abs(float(found[3].log())) < 0.35 < float((found[5] / found[4]).log())


def test_a_photo_without_samples_keeps_its_gain():
    samples, predicted, region = samples_of(torch.tensor([1.0] * (PHOTOS - 2) + [2.0, 2.0]))
    found = gains_of_photos(samples, predicted, region, torch.ones(N), PHOTOS + 1)
    assert float(found[PHOTOS]) == 1


@pytest.mark.slow
def test_the_albedo_is_that_of_evened_photos(ball):
    albedo, *_ = BRONZE
    photos = make_photos(constant(*BRONZE))
    gain = torch.exp(0.4 * torch.randn(photos.views, generator=torch.Generator().manual_seed(2)))
    photos.radiance = photos.radiance * gain[photos.view][:, None]
    for preset, evened in ((PRESET, True), (replace(PRESET, object_gains=False), False)):
        found = learn(ball, photos, preset)
        assert (found.object_gain is not None) == evened == ("object_gains" in found.report)
        if evened:
            log = (found.object_gain / gain).log()
            assert float((log - log.mean()).std()) < 0.06
            ratio = found.albedo.reshape(-1, 3).mean(0) / albedo
            np.testing.assert_allclose(ratio / ratio.mean(), 1, atol=0.03)
        else:
            assert found.report["skipped"]["object gains"]["code"] == "reason.preset"
    plain = learn(ball, make_photos(constant(*BRONZE)))
    assert plain.report["skipped"]["object gains"]["code"] == "reason.equally_bright"
