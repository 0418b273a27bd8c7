"""The roughness of materials from their reflections: photos made with known materials, under light that is known wrongly."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from blender_nep.materials.evidence.decision import place_by_both, place_of_metal, place_where_equal, share_roughness
from blender_nep.materials.evidence.residual import residual_of_reflections
from blender_nep.materials.evidence.spread import spread
from blender_nep.materials.fitting import between, fit_groups, place_of_least, roughness_scan
from blender_nep.materials.palette.palette import Palette
from blender_nep.presets import MaterialPreset
from blender_nep.shading.light_moments import LightMoments
from blender_nep.shading.plenoptic import Material, reflected

PRESET = replace(MaterialPreset(), roughness_levels=(0.05, 0.1, 0.2, 0.4, 1.0), least_roughness=0.05, region=0.5)
SCAN = roughness_scan(PRESET.least_roughness, torch.device("cpu"))


def lit(n: int) -> LightMoments:
    """The light of n samples: a random lamp beside the reflected direction, which wider lobes see more and more of."""
    generator = torch.Generator().manual_seed(3)
    sharp, soft = 3 * torch.rand(2, n, 1, 3, generator=generator) ** 3
    full = torch.lerp(sharp, soft.mean(0), torch.tensor([0.0, 0.25, 0.5, 0.75, 1.0])[None, :, None])
    specular = torch.stack([full, 0.15 * full, 0.06 * full], 2)
    diffuse = 0.3 + torch.rand(n, 3, generator=generator)
    cos_v = 0.3 + 0.7 * torch.rand(n, generator=generator)
    levels = torch.tensor(PRESET.roughness_levels)
    return LightMoments(specular, diffuse, torch.ones(n, len(levels)), cos_v, levels)


def photos(light: LightMoments, palette: Palette, label: torch.Tensor) -> torch.Tensor:
    material = palette.at(label)
    return reflected(material, light.moments(material.roughness), light.diffuse, light.cos_v)


def minimum(residual: torch.Tensor) -> torch.Tensor:
    place = place_of_least(residual)
    return between(SCAN.sqrt()[:, None].expand(-1, len(place)), place) ** 2


def test_reflections_tell_the_roughness_in_wrong_irradiance():
    n = 4000
    light, random = lit(n), np.random.default_rng(1)
    palette = Palette(torch.tensor([[0.8, 0.8, 0.7], [0.9, 0.6, 0.3]]), torch.tensor([0.12, 0.3]), torch.zeros(2))
    label = torch.from_numpy(random.integers(2, size=n))
    position = random.random((n, 3)).astype(np.float32) * 2
    photo = photos(light, palette, label)
    region = np.floor(position / PRESET.region).astype(int) @ [1, 4, 16]
    wrong = light.diffuse * torch.from_numpy(random.uniform(0.6, 1.4, 64)[region]).float()[:, None]
    light = replace(light, diffuse=wrong)
    residual, weight = residual_of_reflections(light, photo, position, label, len(palette), PRESET)
    torch.testing.assert_close(minimum(residual), palette.roughness, rtol=0, atol=0.02)
    torch.testing.assert_close(weight, 1.05 * torch.bincount(label).float(), rtol=0.02, atol=0)
    of_all, _ = fit_groups(light, photo, torch.ones(n), label, 2, least_roughness=0.05, clip=0.25, hypotheses=(0.0, 1.0))
    assert of_all[0, :, 0].min() > 5 * residual[:, 0].min(), "one albedo cannot explain the photos"


def test_samples_without_known_light_hardly_count():
    n = 2000
    light, random = lit(n), np.random.default_rng(2)
    palette = Palette(torch.tensor([[0.8, 0.8, 0.7]]), torch.tensor([0.12]), torch.tensor([0.0]))
    position, label = random.random((n, 3)).astype(np.float32), torch.zeros(n, dtype=torch.int64)
    photo = photos(light, palette, label)
    unknown = torch.from_numpy(random.random(n) < 0.5)
    rough = Palette(palette.albedo, torch.tensor([0.6]), palette.metallic)
    photo[unknown] = photos(light, rough, label)[unknown]
    light.coverage[unknown] = 0
    residual, _ = residual_of_reflections(light, photo, position, label, len(palette), PRESET)
    assert float(minimum(residual)) == pytest.approx(0.12, abs=0.02)


def test_too_few_samples_tell_nothing():
    light = lit(4)
    label = torch.zeros(4, dtype=torch.int64)
    residual, weight = residual_of_reflections(light, torch.ones(4, 3), np.zeros((4, 3)), label, 1, PRESET)
    assert float(weight) == 0 and (residual == 0).all()


def bowls(*shapes: tuple[float, float]) -> torch.Tensor:
    """Residuals [28, K] that are least at a row and rise quadratically: (row, rise in 10 rows as a share)."""
    row = torch.arange(28.0)
    return torch.stack([0.02 * (1 + rise * ((row - least) / 10) ** 2) for least, rise in shapes], 1)


def test_a_flat_residual_borrows_the_roughness_of_a_curved_one():
    residual, weight = bowls((4, 1.0), (9, 0.02)), torch.tensor([1.0, 1.0])
    chosen = share_roughness(residual, weight, 0.03)
    # the minimum of the sum of two parabolas: (1.0 * 4 + 0.02 * 9) / 1.02
    torch.testing.assert_close(place_of_least(chosen), torch.full((2,), 4.18 / 1.02), rtol=0, atol=0.02)


def test_two_roughnesses_stay_apart_and_a_third_joins_the_nearer():
    residual, weight = bowls((2, 1.0), (20, 1.0), (5, 0.02)), torch.tensor([3.0, 1.0, 1.0])
    place = place_of_least(share_roughness(residual, weight, 0.03))
    assert float(place[1]) == pytest.approx(20, abs=0.01)
    assert float(place[0]) == float(place[2]) == pytest.approx((3 * 2 + 0.02 * 5) / 3.02, abs=0.02)


def test_materials_without_samples_do_not_take_part():
    residual, weight = bowls((4, 1.0), (12, 0.02)), torch.tensor([1.0, 0.0])
    assert torch.equal(share_roughness(residual, weight, 0.03), residual)


def test_samples_of_no_material_do_not_count():
    light, random = lit(900), np.random.default_rng(3)
    palette = Palette(torch.tensor([[0.8, 0.8, 0.7]]), torch.tensor([0.12]), torch.zeros(1))
    position, label = random.random((900, 3)).astype(np.float32), torch.zeros(900, dtype=torch.int64)
    photo = photos(light, palette, label)
    photo[::2] = 3.0
    label[::2] = -1
    residual, _ = residual_of_reflections(light, photo, position, label, 1, PRESET)
    assert float(minimum(residual)) == pytest.approx(0.12, abs=0.02) and residual.min() < 2e-3


def test_spread_is_the_deviation_of_the_logarithm_within_regions():
    random = np.random.default_rng(4)
    region = torch.from_numpy(random.integers(5, size=500))
    values = torch.from_numpy(random.normal(size=500)).float()
    weight = torch.from_numpy(random.uniform(0.5, 1, 500)).float()
    brightness = torch.tensor([0.1, 1.0, 3.0, 10.0, 0.5])[region]
    found = spread(torch.exp(values) * brightness, weight, region)
    deviation = values.clone()
    for k in range(5):
        deviation[region == k] -= torch.from_numpy(np.array(np.average(values[region == k], weights=weight[region == k])))
    assert found == pytest.approx(np.average(deviation.abs(), weights=weight), rel=1e-4)
    alone = torch.arange(500)  # a region a sample
    assert spread(torch.exp(values), weight, alone) == 0


@pytest.mark.parametrize(
    ("zero", "expected"),
    [(4.25, 4.25), (-3.0, 2.0), (20.0, 8.0)],  # the residual allows the rows 2 to 8
)
def test_the_spread_decides_within_what_the_residual_allows(zero, expected):
    row = torch.arange(28.0)
    residual = 0.05 * (1 + 0.03 * ((row - 5) / 3) ** 2)
    assert place_where_equal(residual, 0.0301, lambda r: 0.1 * (zero - r)) == pytest.approx(expected, abs=1e-4)


@pytest.mark.parametrize(
    ("fall", "of_mirror", "expected"),
    [
        (0.005, -0.03, 4.0),  # the rows 0 to 4 are as sharp as a mirror, and the residual falls until row 5
        (0.05, -0.03, 0.375),  # only the first 0.4 rows are (in steps of an eighth of a row)
        (0.05, 0.3, 6.0),  # no mirror: the measure is that of the photos at row 6
    ],
)
def test_among_lobes_as_sharp_as_a_mirror_the_residual_decides(fall, of_mirror, expected):
    row = torch.arange(28.0)
    residual = 0.05 * (1 + 0.03 * ((row - 5) / 5) ** 2)
    log_ratio = (of_mirror - fall * row).tolist()
    assert place_by_both(residual, 0.0301, log_ratio.__getitem__, 0.02) == pytest.approx(expected, abs=0.01)


def test_a_mirror_whose_reflections_are_misplaced_stays_sharp():
    n = 4000
    light, random = lit(n), np.random.default_rng(5)
    albedo, rough = torch.tensor([0.8, 0.7, 0.6]), torch.full((n,), 0.1)
    region = torch.from_numpy(random.integers(40, size=n))
    photo = reflected(Material(albedo.expand(n, 3), rough, torch.ones(n)), light.moments(rough), light.diffuse, light.cos_v)
    moved = torch.from_numpy(np.lexsort([random.random(n), region.numpy()]))  # each region's reflections, shuffled
    photo[region.argsort(stable=True)] = photo[moved].clone()
    group = torch.zeros(n, dtype=torch.int64)
    cost, _ = fit_groups(light, photo, torch.ones(n), group, 1, least_roughness=0.05, clip=0.25, hypotheses=(1.0,))
    assert float(SCAN[cost[0, :, 0].argmin()]) > 0.3, "a blur agrees best with what is misplaced"

    def of_prediction(r: torch.Tensor) -> float:
        r = r.expand(n)
        shown = reflected(Material(albedo.expand(n, 3), r, torch.ones(n)), light.moments(r), light.diffuse, light.cos_v)
        return spread(shown.mean(-1), torch.ones(n), region)

    of_photo = spread(photo.mean(-1), torch.ones(n), region)
    log_ratio = [math.log(of_prediction(r) / of_photo) for r in SCAN]
    place = place_by_both(cost[0, :, 0], 10.0, log_ratio.__getitem__, 0.02)
    assert float(between(SCAN.sqrt()[:, None], torch.tensor([place])) ** 2) == pytest.approx(0.1, abs=0.01)


@pytest.mark.parametrize(
    ("fall", "of_mirror", "expected"),
    [
        (0.05, -0.2, 4.0),  # the photos vary more than a mirror, so the spreads of the rows 0 to 4 are not told apart
        (0.05, -0.01, 0.375),  # a mirror varies nearly as much as they do: spreads differ from the first row on
        (0.05, 0.3, 6.0),  # no mirror: the spread is that of the photos at row 6
    ],
)
def test_the_spread_tells_less_where_photos_outvary_a_mirror(fall, of_mirror, expected):
    row = torch.arange(28.0)
    residual = 0.05 * (1 + 0.03 * ((row - 5) / 5) ** 2)
    assert place_of_metal(residual, 0.0301, lambda r: of_mirror - fall * r) == pytest.approx(expected, abs=0.01)
