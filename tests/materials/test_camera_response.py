"""The strength of the camera's response curve, found from what a ball reflects of analytic light."""

import copy
import functools
from dataclasses import replace

import numpy as np
import pytest
import torch

from blender_nep.capture.rays.response_curve import MOST_STRENGTH, ResponseCurve
from blender_nep.materials.camera_response import TriedStrengths, found_curve
from blender_nep.materials.samples.light_gathering import Observations
from blender_nep.materials.training import learn_materials
from blender_nep.scene.scene import Scene
from support.lit_ball import PRESET, AnalyticEnvironment, HalfSeen, MemoryCheckpoint, constant, make_photos

WHITE = 4.0
"""Radiance of white. The lamps of the analytic light have up to 4.2."""
COPPER, PAINT, BRONZE = ((0.6, 0.3, 0.15), 0.2, 1.0), ((0.5, 0.1, 0.1), 0.15, 0.0), ((0.35, 0.2, 0.08), 0.2, 1.0)


class Photographed(AnalyticEnvironment):
    """The analytic light as photos with this curve show it."""

    def __init__(self, curve, environment=None):
        super().__init__()
        self.curve, self.light = curve, environment or AnalyticEnvironment()

    def query_cone(self, origins, directions, half_angle):
        radiance, coverage = self.light.query_cone(origins, directions, half_angle)
        return coverage[:, None] * self.curve.photo(radiance / coverage.clamp_min(1e-6)[:, None]), coverage


@pytest.fixture(scope="module")
def linear():
    """linear(material) -> photos before any curve, which are made once. No test may change them."""
    return functools.cache(lambda material: make_photos(constant(*material)))


def developed(photos, curve):
    photos = copy.copy(photos)
    photos.radiance = curve.photo(photos.radiance)
    photos.exposure = WHITE
    return photos


def curve_of(strength):
    return ResponseCurve.of(strength, WHITE, 0.5)


def observed(ball, photos, environment):
    return Observations.of(ball, environment, Scene(photos, photos=None), PRESET, 0)


@pytest.mark.parametrize("material", [COPPER, PAINT])
@pytest.mark.parametrize("strength", [0.0, pytest.param(0.5, marks=pytest.mark.slow), 1.0])
def test_the_strength_is_found_whatever_is_expected(ball, linear, material, strength):
    curve = curve_of(strength)
    seen = observed(ball, developed(linear(material), curve), Photographed(curve))
    for expected in (0.0, 1.0):
        found, tried = found_curve(seen, expected, PRESET, 0)
        assert (0 if found is None else found.strength) == pytest.approx(strength, abs=0.25)
        assert len(tried.errors) == len(tried.strengths)


@pytest.mark.slow
def test_the_albedo_is_that_of_the_light_before_the_curve(ball, linear):
    albedo, *_ = BRONZE
    curve = curve_of(1.0)
    photos, environment = developed(linear(BRONZE), curve), Photographed(curve)

    def learned(expected, preset=PRESET):
        scene = Scene(photos, photos=None, expected_response=expected)
        return learn_materials(
            ball, environment, scene, preset, seed=0, progress=lambda *_, **__: None, checkpoint=MemoryCheckpoint()
        )

    found = learned(1.0)
    assert np.abs(found.albedo - albedo).max() < 0.01
    assert found.response.strength == pytest.approx(1, abs=0.25) and found.report["response"]["strength"] > 0.7
    for ignored, why in ((learned(None), "linear_photos"), (learned(1.0, replace(PRESET, camera_response=False)), "preset")):
        assert np.abs(ignored.albedo - albedo).max() > 0.025 and ignored.response is None
        assert ignored.report["skipped"]["camera response"]["code"] == f"reason.{why}"


def test_without_shown_light_no_curve_is_looked_for(ball):
    class Unseen(HalfSeen):
        def query_cone(self, origins, directions, half_angle):
            return torch.zeros_like(directions), torch.zeros(len(directions))

    seen = observed(ball, developed(make_photos(constant(*COPPER), rays=4), curve_of(1.0)), Unseen())
    assert found_curve(seen, 1.0, PRESET, 0) == (None, None)


def test_equal_errors_leave_what_is_expected():
    flat = TriedStrengths((0.0, 0.5, 1.0, 1.5, MOST_STRENGTH), (0.1,) * 5)
    for expected in (0.0, 0.7, 1.0, MOST_STRENGTH):
        assert flat.best(expected, 0.01) == pytest.approx(expected, abs=1e-9)
    bent = replace(flat, errors=tuple(0.1 * (1 + 0.02 * (s - 1.2) ** 2) for s in flat.strengths))
    assert bent.best(0.0, 0.0) == pytest.approx(1.2)
    assert bent.best(0.0, 0.02) == pytest.approx(0.6, abs=1e-3), "half way, because both count alike"
