"""The robust fit of one albedo to a pixel and its neighbors, against known albedos and a search over a grid."""

import numpy as np
import pytest
import torch

from blender_nep.ops.materials.local_albedo import fit_local_albedos
from blender_nep.tone_mapping import tone_map

CLIP = np.float32(0.25)
ALBEDO = np.array([0.8, 0.3, 0.05], np.float32)


def tone(light):
    return tone_map(torch.from_numpy(np.asarray(light, np.float32))).numpy()


def scene(metallic, n=12, seed=0):
    random = np.random.default_rng(seed)
    offset = random.uniform(0, 0.1, (n, 3)).astype(np.float32)
    slope = random.uniform(0.2, 1.5, (n, 3)).astype(np.float32)
    return offset, slope, np.full(n, metallic, np.float32), (offset + slope * ALBEDO).astype(np.float32)


def fitted(offset, slope, metallic, goal, weight=None, iterations=20):
    n = len(goal)
    index = np.arange(n)[None]
    weight = np.ones((1, n), np.float32) if weight is None else weight
    albedo, residual = np.empty((1, 3), np.float32), np.empty(1, np.float32)
    fit_local_albedos(index, weight, offset, slope, metallic, goal, CLIP, iterations, albedo, residual)
    return albedo[0], residual[0]


@pytest.mark.parametrize("metallic", [0.0, 1.0])
def test_exact_photos_give_the_exact_albedo(metallic):
    albedo, residual = fitted(*scene(metallic))
    assert albedo == pytest.approx(ALBEDO, abs=1e-4)
    assert residual < 1e-5


@pytest.mark.parametrize("metallic", [0.0, 1.0])
def test_highlights_in_a_third_of_the_photos_do_not_matter(metallic):
    offset, slope, m, goal = scene(metallic)
    goal[::3] += 4
    assert fitted(offset, slope, m, goal)[0] == pytest.approx(ALBEDO, abs=0.01)


def test_the_fit_is_the_least_absolute_tone_mapped_residual():
    offset, slope, metallic, goal = scene(0.0, n=40, seed=1)
    goal *= np.random.default_rng(2).uniform(0.7, 1.4, goal.shape).astype(np.float32)
    weight = np.random.default_rng(3).uniform(0.1, 1, (1, 40)).astype(np.float32)
    grid = np.linspace(0, 1, 2001, dtype=np.float32)
    left = np.abs(tone(offset[:, None] + slope[:, None] * grid[:, None]) - tone(goal)[:, None]).clip(max=2 * CLIP)
    least = np.tensordot(weight[0], left, (0, 0))  # [grid, 3]
    albedo, residual = fitted(offset, slope, metallic, goal, weight)
    at = np.abs(grid[:, None] - albedo).argmin(0)
    assert (least[at, range(3)] < 1.01 * least.min(0)).all()
    own = np.abs(tone(offset + slope * albedo) - tone(goal)).mean(1).clip(max=CLIP)
    assert residual == pytest.approx((own * weight[0]).sum() / weight.sum(), rel=1e-3)


def test_no_weights_and_black_slopes_give_finite_albedos():
    offset, slope, metallic, goal = scene(0.0)
    albedo, residual = fitted(offset, 0 * slope, metallic, goal)
    assert np.isfinite(albedo).all() and np.isfinite(residual)
    albedo, residual = fitted(offset, slope, metallic, goal, np.zeros((1, 12), np.float32))
    assert np.isfinite(albedo).all() and residual == 0
