"""The schedule of stage 1, by hand-made states: it needs no fields and no photos."""

from dataclasses import replace

import pytest

from blender_nep.fields.schedule import Schedule, geometric_decay
from blender_nep.presets import FieldsPreset

PRESET = FieldsPreset(background_steps=10, steps=200)
FELL, STOPPED_FALLING = [0.073, 0.071, 0.067, 0.066], [0.073, 0.06, 0.06, 0.06, 0.0599]
COARSE = [0.09, 0.085, 0.08, 0.075, 0.064]
"""Errors up to the refinement: by the preset's fractions the finer grid comes with the fifth measurement."""


def schedule(fraction: float = 0.0, preset: FieldsPreset = PRESET, **changes) -> Schedule:
    """At a fraction of the learning of both fields, as it is without a plateau."""
    learned = round(fraction * preset.steps)
    at = {"step": preset.background_steps + learned, "learned": learned, **changes}
    return replace(Schedule.at_start(preset, outside=50, pixels=100), **at)


def test_a_geometric_decay_is_1_then_falls_by_equal_factors():
    assert [geometric_decay(f, 0.4, 0.01) for f in (0.0, 0.2, 0.4)] == [1, 1, 1]
    assert geometric_decay(0.7, 0.4, 0.01) == pytest.approx(0.1)
    assert geometric_decay(1.0, 0.4, 0.01) == pytest.approx(0.01)
    assert geometric_decay(1.0, 1.0, 0.01) == 1, "a decay that starts at the end never starts"


@pytest.mark.parametrize(("outside", "steps"), [(0, 0), (4, 0), (5, 10), (100, 10)])
def test_without_surroundings_there_are_no_steps_of_f_e_alone(outside, steps):
    assert Schedule.at_start(PRESET, outside, 100).background_steps == steps


def test_steps_of_f_e_alone_come_first_and_learn_no_f_o():
    now, joint = Schedule.at_start(PRESET, 50, 100), []
    while now.fraction < 1:
        joint.append(not now.learns_background)
        assert now.total_steps == (210 if now.step > 10 else 210 + PRESET.colors_first_steps), "a hull is expected at first"
        now.advance()
    assert joint == [False] * 10 + [True] * 200
    assert now.step == 210 == now.total_steps and now.environment_fraction == 1


def test_the_sharpness_rises_geometrically_and_then_stays():
    p = PRESET
    half = (p.first_sharpness * p.last_sharpness) ** 0.5
    assert schedule(0).sharpness == p.first_sharpness
    assert schedule(p.sharpness_until / 2).sharpness == pytest.approx(half)
    assert schedule(p.sharpness_until).sharpness == pytest.approx(p.last_sharpness)
    assert schedule(1).sharpness == pytest.approx(p.last_sharpness)
    from_hull = schedule(0)
    from_hull.start_from_hull()
    assert from_hull.sharpness == p.hull_sharpness
    assert replace(from_hull, learned=p.steps).sharpness == pytest.approx(p.last_sharpness)


def test_samples_and_gradient_scale_change_at_their_fractions():
    p = PRESET
    cases = (
        ("samples", p.first_samples_until, p.first_samples, p.samples),
        ("environment_gradient_scale", p.environment_gradient_scale_until, p.environment_gradient_scale, 1.0),
    )
    for name, at, before, after in cases:
        assert before != after
        assert [getattr(schedule(f), name) for f in (0, at - 0.01, at, 1)] == [before, before, after, after], name


def test_the_curvature_weight_holds_and_then_falls():
    p = PRESET
    assert schedule(0).curvature_weight == schedule(p.curvature_decay_from).curvature_weight == p.curvature
    assert schedule(0.75).curvature_weight == pytest.approx((p.curvature * p.last_curvature) ** 0.5)
    assert schedule(1).curvature_weight == pytest.approx(p.last_curvature)
    off = replace(p, curvature=0.0)
    assert [schedule(f, off).curvature_weight for f in (0, 0.75, 1)] == [0, 0, 0]


def test_rates_warm_up_and_decay_and_the_sdfs_with_sharpness():
    p = PRESET
    assert schedule(0).head_rate == pytest.approx(p.head_rate / p.warm_up_steps)
    assert schedule(0).sdf_rate == pytest.approx(p.sdf_rate / p.warm_up_steps)
    assert schedule(p.head_rate_decay_from).head_rate == pytest.approx(p.head_rate)
    assert schedule(1).head_rate == pytest.approx(p.head_rate * p.last_rate)
    softer = (p.first_sharpness / p.last_sharpness) ** 0.5
    assert schedule(1).sdf_rate == pytest.approx(p.sdf_rate * p.last_rate * softer)
    even = replace(p, sdf_rate_sharpness_power=0.0)
    assert schedule(1, even).sdf_rate == pytest.approx(p.sdf_rate * p.last_rate)


def test_from_a_hull_colors_come_first_and_then_the_sdf_warms_up():
    p = replace(PRESET, colors_first_steps=30, warm_up_steps=20)
    now, rates, heads, expected = Schedule.at_start(p, 50, 100), [], [], []
    while now.fraction < 1:
        if now.step == now.background_steps:
            now.start_from_hull()
        if not now.learns_background:
            rates.append(now.sdf_rate / replace(now, step=10**6).sdf_rate)
            heads.append(now.head_rate / replace(now, step=10**6).head_rate)
        assert now.learns_shape == (now.step >= 40)
        assert now.learns_shape or now.fraction == 0, "the sharpness waits, too"
        expected.append(now.total_steps)
        now.advance()
    up = [k / 20 for k in range(1, 21)]
    assert rates == pytest.approx([0] * 30 + up + [1] * 180)
    assert heads == pytest.approx(up + [1] * 210)
    assert now.step == 240 and set(expected) == {240}


def test_a_sphere_does_not_wait_for_the_colors():
    now = schedule(preset=replace(PRESET, colors_first_steps=30))
    assert now.learns_shape and now.sdf_rate > 0
    now.advance()
    assert now.learned == 1 and now.total_steps == 210


def test_validation_errors_are_due_at_their_fractions():
    now, measured = schedule(0), []
    while now.fraction < 1:
        if now.validation_due:
            now.validation_errors.append(1 / (1 + len(measured)))  # falls: no plateau
            measured.append(now.fraction)
            assert not now.validation_due
        now.advance()
    assert measured == pytest.approx([0.25 + 0.05 * k for k in range(15)], abs=1.01 / PRESET.steps)


@pytest.mark.parametrize(("after", "plateaued"), [(FELL, False), (STOPPED_FALLING, True)])
def test_learning_ends_early_only_on_the_finest_grid(after, plateaued):
    now = schedule(0.7, validation_errors=[*COARSE, *after])
    assert now.plateaued == plateaued
    assert now.step_multiplier == (PRESET.plateau_step_multiplier if plateaued else 1)
    assert now.total_steps == 10 + 140 + (15 if plateaued else 60)
    steps = 0
    while now.fraction < 1:
        now.advance()
        steps += 1
    assert now.learned == PRESET.steps and steps == (15 if plateaued else 60)


def test_errors_of_the_coarse_grid_make_no_plateau():
    assert not schedule(0.7, validation_errors=[*COARSE[:2], *[0.01] * 3, *STOPPED_FALLING[:3]]).plateaued


def test_with_a_multiplier_of_1_a_plateau_changes_nothing():
    now = schedule(0.7, replace(PRESET, plateau_step_multiplier=1), validation_errors=[*COARSE, *STOPPED_FALLING])
    assert now.plateaued and now.total_steps == 210


def test_a_schedule_goes_on_from_its_state():
    now = schedule(0.7, validation_errors=[*COARSE, *STOPPED_FALLING])
    now.start_from_hull()
    other = Schedule.at_start(PRESET, 50, 100)
    other.load(now.state())
    assert other == now
    now.validation_errors.append(0.5)
    assert other != now, "nothing is shared"
