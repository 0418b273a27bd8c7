"""The roughness of a colored paint, from the channel in which its diffuse light does not show."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from blender_nep.materials.evidence.decision import places_of_colored
from blender_nep.materials.evidence.third_moment import _LEAST_MOMENT, _DiffuseFree, evidence_of_colored
from blender_nep.materials.fitting import place_in_scan, roughness_at, roughness_scan
from blender_nep.presets import MaterialPreset
from blender_nep.shading.light_moments import LightMoments
from blender_nep.shading.plenoptic import Material, reflected

PRESET = MaterialPreset()
LEVELS = torch.tensor(PRESET.roughness_levels)
N, DIRECTIONS = 6000, 720
RED = torch.tensor([0.6, 0.2, 0.1])
ALL = torch.arange(N)
Told = tuple[torch.Tensor, list[float]]
"""The residual [R] of a paint, and the logs [R] of the ratios of its third moments"""


def lamps() -> torch.Tensor:
    """Light from directions on a circle: some lamps and a dim, uneven room, [DIRECTIONS]."""
    generator = np.random.default_rng(0)
    room = 0.3 + 0.2 * np.sin(np.linspace(0, 6 * np.pi, DIRECTIONS))
    for at in generator.integers(0, DIRECTIONS, 9):
        room[at : at + 12] += 12
    return torch.from_numpy(room.astype(np.float32))


def light(angle: torch.Tensor, noise: torch.Tensor) -> LightMoments:
    """The light of samples that mirror the direction `angle` [n]; a lobe blurs by a Gaussian that widens with the roughness.

    noise [n] are factors of the irradiance.
    """
    across = torch.arange(DIRECTIONS) * 2 * np.pi / DIRECTIONS
    apart = torch.remainder(across[:, None] - across[None] + np.pi, 2 * np.pi) - np.pi
    levels = []
    for roughness in LEVELS:
        kernel = torch.exp(-0.5 * (apart / (1.2 * roughness**1.5 + 0.02)) ** 2)
        levels.append((kernel / kernel.sum(1, keepdim=True)) @ lamps())
    place = torch.remainder(angle / (2 * np.pi) * DIRECTIONS, DIRECTIONS).long().clamp(0, DIRECTIONS - 1)
    full = torch.stack(levels, 1)[place][:, :, None].expand(-1, -1, 3)
    specular = torch.stack([full, 0.1 * full, 0.045 * full], 2).contiguous()
    diffuse = (0.8 * noise)[:, None].expand(-1, 3).contiguous()
    return LightMoments(specular, diffuse, torch.ones(len(angle), len(LEVELS)), torch.full((len(angle),), 0.8), LEVELS)


def found(roughness: float, *args, preset: MaterialPreset = PRESET, **kwargs) -> float | None:
    """The roughness that is found; the arguments are those of `evidence`."""
    told = evidence(roughness, *args, preset=preset, **kwargs)
    return None if told is None else roughness_of([told], preset.hue_residual_margin)[0]


def evidence(
    roughness: float,
    albedo: torch.Tensor = RED,
    samples: torch.Tensor = ALL,
    paint: torch.Tensor | None = None,
    wrong_by: float = 1.0,
    preset: MaterialPreset = PRESET,
) -> Told | None:
    """What tells the roughness if normals are wrong by `wrong_by` degrees, and the irradiance by 25 %.

    `paint` [N, 3] is the true albedo, if it is not the one that is known.
    """
    generator = torch.Generator().manual_seed(1)
    angle = torch.rand(N, generator=generator) * 2 * np.pi
    wrong = angle + torch.deg2rad(2 * wrong_by * torch.randn(N, generator=generator))
    real, one = light(angle, torch.exp(0.25 * torch.randn(N, generator=generator))), torch.ones(N)
    material = Material((albedo if paint is None else paint).expand(N, 3), roughness * one, 0 * one)
    photos = reflected(material, real.moments(material.roughness), real.diffuse, real.cos_v)
    region = torch.randint(64, (N,), generator=generator)
    told = evidence_of_colored(light(wrong, one), photos, samples, region[samples], albedo, preset)
    return None if told is None else (told.cost, [told.log_ratio(row) for row in range(len(told.cost))])


def roughness_of(evidence: list[Told], margin: float = PRESET.hue_residual_margin) -> list[float]:
    return roughness_at(torch.tensor(places_of_colored(evidence, margin)), PRESET.least_roughness).tolist()


@pytest.mark.parametrize("roughness", [0.03, 0.04, 0.08, 0.15, 0.3, 0.5, 0.7])
def test_a_paints_roughness_is_found_in_misplaced_reflections(roughness):
    assert found(roughness) == pytest.approx(roughness, rel=0.2, abs=0.02)


def test_the_third_moment_takes_back_the_blur_of_misplacement():
    by_residual = replace(PRESET, hue_residual_margin=0.0)
    assert found(0.15, wrong_by=6.0, preset=by_residual) > 0.27
    assert found(0.15, wrong_by=6.0) == pytest.approx(0.15, abs=0.07)


def test_the_residuals_range_is_wider_where_much_is_explained(monkeypatch):
    assert found(0.3, wrong_by=8.0) == pytest.approx(0.3, abs=0.01)
    monkeypatch.setattr("blender_nep.materials.evidence.third_moment._WELL_EXPLAINED", np.inf)
    assert found(0.3, wrong_by=8.0) > 0.32


@pytest.mark.parametrize(
    ("roughness", "wrong_by"), [(0.08, 3.0), (0.15, 3.0), (0.15, 6.0), (0.3, 6.0), (0.5, 6.0), (0.7, 6.0)]
)
def test_the_third_moment_is_the_photos_wherever_reflections_are(roughness, wrong_by):
    place = float(place_in_scan(torch.tensor(roughness), PRESET.least_roughness))
    _, moment = evidence(roughness, wrong_by=wrong_by)
    assert np.interp(place, range(len(moment)), moment) == pytest.approx(0, abs=0.03)


def told(third_moment: float, least_residual_at: float) -> Told:
    """A paint whose third moment is that of the photos at one roughness, and whose residual is least at another.

    The residual allows values up to e times as rough and as sharp.
    """
    scan = roughness_scan(PRESET.least_roughness, torch.device("cpu"))
    log = torch.log(scan)
    residual = 1 + PRESET.hue_residual_margin * (log - np.log(least_residual_at)) ** 2
    return residual, (0.5 * (np.log(third_moment) - log)).tolist()


def test_paints_whose_third_moments_nearly_fit_share_a_roughness():
    first, second = told(0.1, 0.15), told(0.2, 0.15)
    assert roughness_of([first]) == pytest.approx([0.1], rel=0.03)
    assert roughness_of([first, second]) == pytest.approx([0.1414, 0.1414], rel=0.03)


def test_paints_of_other_moments_or_residuals_keep_their_own():
    apart = [told(0.07, 0.1), told(0.3, 0.2)]
    assert roughness_of(apart) == pytest.approx([0.07, 0.3], rel=0.05)
    by_residual = [told(0.15, 0.04), told(0.2, 0.9)]
    assert roughness_of(by_residual) == pytest.approx([0.11, 0.34], rel=0.1)


def test_one_paint_that_is_apart_leaves_the_others_together():
    common = roughness_of([told(0.12, 0.15), told(0.16, 0.15), told(0.6, 0.4)])
    assert common == pytest.approx([0.1386, 0.1386, 0.6], rel=0.05)


def alike_below(sharp: float, rise: float, least_residual_at: float, log_of_mirror: float) -> Told:
    """A paint with the third moment of a mirror below a roughness of `sharp`; a mirror's residual is higher by `rise`."""
    scan = roughness_scan(PRESET.least_roughness, torch.device("cpu"))
    away = torch.log(scan / least_residual_at)
    moment = log_of_mirror - torch.log(scan / sharp).clamp_min(0)
    return 1 + rise * (away / away[0]) ** 2, moment.tolist()


@pytest.mark.parametrize("rise", [0.04, 0.11])  # the mirror is in the residual's range, and it is not
@pytest.mark.parametrize("log_of_mirror", [-1.2, -0.3, 0.0])  # of the third moment: larger in the photos, and alike
def test_mirror_sharp_lobes_are_told_apart_by_the_residual(log_of_mirror, rise):
    kink = 0.1065  # a value of the scan
    beyond = alike_below(kink, rise, 0.2, log_of_mirror)  # so the roughest of them is taken
    assert roughness_of([beyond]) == pytest.approx([kink * np.exp(0.05)], abs=0.002)
    among = alike_below(0.25, rise, 0.15, log_of_mirror)
    assert roughness_of([among]) == pytest.approx([0.15], abs=0.003)
    assert roughness_of([among] * 2) == pytest.approx([0.15] * 2, abs=0.003)


def test_what_the_residual_says_fades_out():
    """So that a small change of the third moment cannot change the roughness by much."""
    scan = roughness_scan(PRESET.least_roughness, torch.device("cpu"))
    log_ratio = torch.log(scan / scan[0])
    residual = (1 + 0.02 * (1 - log_ratio / log_ratio[-1])).flip(0)  # least for a mirror
    found = [roughness_of([(residual, (high - 0.04 * log_ratio).tolist())])[0] for high in np.linspace(0, 0.08, 33)]
    assert found[0] == pytest.approx(0.03, abs=0.001) and found[-1] > 0.2
    assert np.abs(np.diff(found)).max() < 0.04


def test_third_moments_of_a_rougher_paint_are_not_alike():
    scan = roughness_scan(PRESET.least_roughness, torch.device("cpu"))
    residual = 1 + PRESET.hue_residual_margin * torch.log(scan / 0.08) ** 2
    dull = residual, (-1.2 * torch.log(scan / 0.7)).tolist()
    assert roughness_of([dull]) == pytest.approx([0.201], abs=0.003)  # the rough end of the residual's range


def test_third_moments_that_are_told_apart_are_not_overruled():
    assert roughness_of([alike_below(0.06, 0.04, 0.25, 0.5)]) == pytest.approx([0.06 * np.exp(0.5)], rel=0.03)


def test_a_least_residual_at_the_mirror_gives_the_mirror():
    rising = torch.linspace(1, 2, 32), [-0.3] * 32
    assert roughness_of([rising]) == pytest.approx([0.03])
    assert roughness_of([rising], margin=0.0) == pytest.approx([0.03])


def test_a_gray_paint_and_few_samples_say_nothing():
    assert found(0.3, torch.tensor([0.5, 0.48, 0.46])) is None
    assert found(0.3, samples=ALL[:90]) is None


def test_reflections_that_are_elsewhere_say_nothing():
    assert found(0.2, wrong_by=90.0) is None


def test_photos_without_bright_reflections_say_nothing(monkeypatch):
    monkeypatch.setattr(_DiffuseFree, "third_moment", lambda self, values: _LEAST_MOMENT if values is self.shown else 0.1)
    assert found(0.3) is None


def test_many_paints_that_were_taken_for_one_say_nothing():
    generator = torch.Generator().manual_seed(3)
    paints = RED * torch.exp(0.8 * torch.randn(N, 3, generator=generator))
    assert found(0.2) is not None and found(0.2, paint=paints.clamp(0, 1)) is None
