"""F_e as light, where photos have a camera's response curve."""

import math

import torch

from blender_nep.capture.rays.response_curve import ResponseCurve
from blender_nep.shading.light_of_photos import LightOfPhotos

CURVE = ResponseCurve.of(1.0, white=1.0, middle=0.2)
LIGHT, COVERAGE = torch.tensor([0.7, 0.2, 0.05]), torch.tensor([1.0, 0.25, 0.0])


class HalfShown:
    """Photos that show the same light in all directions, as far as COVERAGE says."""

    def query_cone(self, origins, directions, half_angle):
        return COVERAGE[:, None] * CURVE.photo(LIGHT), COVERAGE

    def equirect(self, height):
        radiance, coverage = self.query_cone(None, None, None)
        return radiance.expand(height, 2 * height, 3, 3)[..., 0, :], coverage[0].expand(height, 2 * height)

    def extrapolated(self, height):
        return CURVE.photo(LIGHT).expand(height, 2 * height, 3)

    def typical_distance(self):
        return math.inf


def test_light_counts_as_far_as_photos_show_it():
    radiance, coverage = LightOfPhotos(HalfShown(), CURVE).query_cone(None, None, None)
    torch.testing.assert_close(radiance, COVERAGE[:, None] * LIGHT)
    assert coverage is COVERAGE


def test_maps_hold_light():
    light = LightOfPhotos(HalfShown(), CURVE)
    torch.testing.assert_close(light.equirect(4)[0], LIGHT.expand(4, 8, 3))
    torch.testing.assert_close(light.extrapolated(4), LIGHT.expand(4, 8, 3))
    assert light.typical_distance() == math.inf
