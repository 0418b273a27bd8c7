"""How much the albedo follows the light: correlations that are known."""

from types import SimpleNamespace

import numpy as np
import pytest
import torch

from blender_nep.materials.baked_light import correlations
from blender_nep.materials.baking import LabeledPoints

N = 4000


def points(albedo):
    random = np.random.default_rng(0)
    even = np.zeros(N, np.float32)
    up = np.tile([0.0, 0.0, 1.0], (N, 1))
    position, photo, albedo = random.uniform(-1, 1, (N, 3)), even.astype(int), albedo[:, None].repeat(3, 1)
    return LabeledPoints(position, up, photo, albedo, even, even, even)


def light(irradiance, hidden, mirrored):
    """Light of which half of the points have one cone that meets the object, with the weight `hidden`."""
    hit = torch.arange(0, N, 2)
    weight = torch.zeros(len(hit), 4, 3)
    weight[:, 0, 0] = torch.from_numpy(hidden[::2])
    return SimpleNamespace(
        cos_v=torch.ones(N),
        diffuse=torch.from_numpy(irradiance)[:, None].expand(N, 3),
        traced=SimpleNamespace(hit_index=hit, hit_weight=weight),
        moments=lambda roughness: SimpleNamespace(full=torch.from_numpy(mirrored)[:, None].expand(N, 3)),
    )


@pytest.mark.parametrize(("cause", "sign"), [("irradiance", 1), ("visibility", -1), ("highlights", 1)])
def test_an_albedo_made_of_light_is_found_out(cause, sign):
    random = np.random.default_rng(1)
    values = {name: random.uniform(0.1, 1, N).astype(np.float32) for name in ("irradiance", "visibility", "highlights")}
    values["visibility"][1::2] = 0
    of_light = values[cause].copy()
    found = correlations(points(of_light), light(*values.values()), points(of_light).position)
    assert sign * found[cause] > 0.85
    assert all(abs(found[name]) < 0.05 for name in found if name != cause)


def test_a_uniform_albedo_and_a_uniform_light_follow_nothing():
    random = np.random.default_rng(2)
    even, uneven = np.full(N, 0.5, np.float32), random.uniform(0.1, 1, N).astype(np.float32)
    assert set(correlations(points(even), light(uneven, uneven, uneven), points(even).position).values()) == {0.0}
    assert set(correlations(points(uneven), light(even, 0 * even, even), points(even).position).values()) == {0.0}
