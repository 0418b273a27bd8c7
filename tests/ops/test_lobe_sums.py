"""The light of cones, summed in the lobes of surface points."""

import numpy as np
import torch

from blender_nep.ops.materials.lobe_sums import add_to_lobes


def test_it_is_the_sum_over_the_cones_of_each_point():
    random = np.random.default_rng(3)
    n, k, levels = 40, 500, 5
    row = np.sort(random.choice(np.arange(1, n, 2), k))  # every other point has no cone
    weight, fresnel, light = (random.random(shape) for shape in ((k, 1 + levels), (k, 2), (k, 3)))
    diffuse, specular = random.random((n, 3)), random.random((n, levels, 3, 3))
    terms = np.concatenate([np.ones((k, 1)), fresnel], 1)
    into = torch.from_numpy(row)
    expected = [
        torch.from_numpy(diffuse).index_add(0, into, torch.from_numpy(weight[:, :1] * light)),
        torch.from_numpy(specular).index_add(
            0, into, torch.from_numpy(np.einsum("kl,km,kc->klmc", weight[:, 1:], terms, light))
        ),
    ]
    add_to_lobes(np.searchsorted(row, np.arange(n + 1)), weight, fresnel, light, diffuse, specular)
    np.testing.assert_allclose(diffuse, expected[0].numpy(), rtol=1e-12)
    np.testing.assert_allclose(specular, expected[1].numpy(), rtol=1e-12)
