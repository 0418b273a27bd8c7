"""Frames are chosen evenly spaced in view, and the sharpest ones, from films whose motion is known."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter, uniform_filter1d

from blender_nep.cameras.video.frame_choice import FrameSurvey, sharpness
from support.films import pan, texture

WIDTH = 128


def surveyed(frames) -> FrameSurvey:
    survey = FrameSurvey()
    for frame in frames:
        survey.add(frame, frame)
    return survey


def test_the_motion_that_is_measured_is_the_true_one():
    places = np.cumsum(np.random.default_rng(1).uniform(0.2, 3.0, 80))
    survey = surveyed(pan(places))
    np.testing.assert_allclose(survey.moved, (places - places[0]) / WIDTH, atol=0.05 * places[-1] / WIDTH)


def test_a_pause_adds_no_motion_though_frames_are_noisy():
    rng = np.random.default_rng(0)
    frames = [np.clip(frame + rng.normal(0, 6, frame.shape), 0, 255).astype(np.uint8) for frame in pan([5.0] * 100)]
    assert surveyed(frames).moved[-1] < 0.01


@pytest.mark.parametrize("count", [5, 12, 20])
def test_frames_are_evenly_spaced_though_the_speed_varies(count):
    speed = np.concatenate([np.full(60, 0.4), np.zeros(90), np.full(12, 5.0), np.full(40, 1.5)])
    places = np.cumsum(speed)
    chosen = surveyed(pan(places)).choose(count)
    assert len(chosen) == count and chosen == sorted(set(chosen))
    gaps = np.diff(places[chosen])
    step = (places[-1] - places[0]) / count
    assert gaps.max() < 1.9 * step and gaps.min() > 0.2 * step


def test_where_the_view_hardly_changes_frames_are_few():
    assert len(surveyed(pan(np.linspace(0, 12.8, 100))).choose(80)) in (5, 6, 7), "steps of two percent"
    assert len(surveyed(pan([3.0] * 50)).choose(80)) == 1
    assert FrameSurvey().choose(80) == []


def test_a_cut_is_one_step_and_no_more():
    frames = pan([0.0] * 10) + pan([0.0] * 10, seed=9)
    survey = surveyed(frames)
    assert 0.03 < survey.moved[-1] < 0.1 and survey.steps[10] == max(survey.steps)


@pytest.mark.parametrize("blur", [lambda f: gaussian_filter(f, 1.5), lambda f: uniform_filter1d(f, 5, axis=1)])
def test_the_sharpest_frame_of_each_step_is_taken(blur):
    frames = pan(np.linspace(0, 100, 120))
    sharp = set(range(0, 120, 3))
    frames = [frame if n in sharp else blur(frame.astype(float)).astype(np.uint8) for n, frame in enumerate(frames)]
    chosen = surveyed(frames).choose(15)
    assert len(chosen) == 15 and set(chosen) <= sharp


def test_texture_alone_makes_no_frame_sharper():
    picture = texture(96, 128).astype(float)
    pale = 128 + 0.25 * (picture - 128)
    assert sharpness(pale) == pytest.approx(sharpness(picture), rel=0.15)
    assert sharpness(gaussian_filter(picture, 1.5)) < 0.5 * sharpness(pale)
