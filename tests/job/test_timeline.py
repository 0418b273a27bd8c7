"""The time left, by a clock that the test turns."""

from __future__ import annotations

import pytest

from blender_nep.job.reporting.timeline import Timeline, time_text


def test_time_left_follows_the_measured_pace():
    now = [0.0]
    line = Timeline({"a": 100.0, "b": 300.0}, clock=lambda: now[0])
    line.enter("a")
    assert line.at(0.0) == (0.0, 400.0)
    now[0] = 20.0  # twice as fast as guessed: 60 % of a in 20 s would be 33 s, here 40 %
    fraction, eta = line.at(0.4)
    assert fraction == pytest.approx(0.1) and eta == pytest.approx(30 + 300 * 0.5)
    now[0] = 50.0
    line.leave()
    line.enter("b")
    assert line.at(0.0)[1] == pytest.approx(150)


def test_time_left_of_a_resumed_stage_counts_only_its_own_steps():
    now = [0.0]
    line = Timeline({"a": 100.0}, clock=lambda: now[0])
    line.enter("a")
    line.begin_at(0.5)
    now[0] = 10.0
    assert line.at(0.6)[1] == pytest.approx(40)


def test_a_time_is_told_in_hours_minutes_and_seconds():
    assert [time_text(seconds) for seconds in (-1, 75, 3725)] == ["0:00", "1:15", "1:02:05"]
    assert time_text(float("inf")) == time_text(float("nan")) == "?"
