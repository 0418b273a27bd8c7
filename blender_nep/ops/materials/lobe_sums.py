"""A Numba kernel on the CPU that sums the light of cones in the lobes of surface points.

The points are independent, so results do not depend on the number of threads.
"""

from __future__ import annotations

from numba import prange

from blender_nep.ops.compilation import kernel


@kernel(parallel=True)
def add_to_lobes(starts, weight, fresnel, light, diffuse, specular):
    """Add the light of k cones to diffuse [n, 3] and specular [n, R, 3, 3] (three moments with three colors each).

    Point i has the cones starts[i] to starts[i + 1] - 1, starts [n + 1]. weight [k, 1 + R] are the weights of the cones in
    the diffuse lobe and in the specular lobes; fresnel [k, 2] multiplies these for the second and the third moment; light
    [k, 3].
    """
    for i in prange(len(diffuse)):
        for c in range(starts[i], starts[i + 1]):
            for color in range(3):
                full = light[c, color]
                edge, dielectric = fresnel[c, 0] * full, fresnel[c, 1] * full
                diffuse[i, color] += weight[c, 0] * full
                for level in range(specular.shape[1]):
                    share = weight[c, 1 + level]
                    specular[i, level, 0, color] += share * full
                    specular[i, level, 1, color] += share * edge
                    specular[i, level, 2, color] += share * dielectric
