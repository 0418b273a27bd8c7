"""A job knows how the object of a turntable stood in each photo: as the file says, as photos look, or as is asked for."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
import torch

from blender_nep.job import preparation
from blender_nep.presets import preset
from support.ball_stages import BallStages
from support.captures import look_at


class Looked(BallStages):
    """Keeps the pixels that the first stage gets."""

    def learn_fields(self, given, *how):
        self.rays = given.scene.rays
        return super().learn_fields(given, *how)


@pytest.fixture
def ring(start):
    """ring(by_hand, **top) changes the capture of `start`: cameras on a ring around its object, one of them by hand."""
    path = start.folder / "transforms.json"
    meta = json.loads(path.read_text())

    def change(by_hand: int | None = None, **top) -> None:
        center = np.array(meta["object_center"])
        for k, frame in enumerate(meta["frames"]):
            angle, rise = np.radians(60 * k), 1.5 if k == by_hand else 0.5
            place = center + 2.5 * np.array([np.cos(angle), np.sin(angle), rise])
            frame["transform_matrix"] = look_at(place, center).tolist()
        path.write_text(json.dumps(meta | top))

    return change


def codes(start) -> list[str]:
    report = json.loads((start.out / "report.json").read_text())
    return [warning["code"] for warning in report["warnings"] if "turntable" in warning["code"]]


def assert_the_camera_stands_still(rays) -> None:
    origins, rotations = rays.cameras()
    places = rays.turntable.points(origins)
    assert torch.allclose(places, places[:1], atol=1e-5)
    turns = rays.turntable.rotation @ rotations
    assert torch.allclose(turns, turns[:1], atol=1e-5)
    assert torch.allclose(rays.turntable.rotation[0], torch.eye(3), atol=1e-6)


@pytest.mark.parametrize(
    ("said", "asked", "share", "used", "warned"),
    [
        (True, None, None, True, False),
        (None, True, None, True, False),
        (None, None, 1.0, True, True),
        (None, None, 0.2, False, False),
        (None, None, None, False, False),
        (True, False, 1.0, False, False),
        (False, None, 1.0, False, False),
        (None, False, 1.0, False, False),
    ],
)
def test_what_decides_whether_it_is_a_turntable(start, ring, monkeypatch, said, asked, share, used, warned):
    ring(**({} if said is None else {"turntable": said}))
    monkeypatch.setattr(preparation, "still_share", lambda rays: share)
    stages = Looked()
    code, _ = start(stages, turntable=asked)
    assert code == 0 and (stages.rays.turntable is not None) == used
    assert codes(start) == (["capture.on_turntable"] if warned else [])
    if used:
        assert_the_camera_stands_still(stages.rays)


def test_the_preset_may_leave_the_turns_out(start, ring):
    ring(turntable=True)
    stages = Looked()
    start(stages, preset=replace(preset("preview"), turntable=False))
    assert stages.rays.turntable is None


def test_a_photo_by_hand_is_left_out_and_told(start, ring):
    ring(by_hand=2, turntable=True)
    stages = Looked()
    code, _ = start(stages, all_photos=True)
    assert code == 0 and stages.rays.views == 5 and codes(start) == ["capture.turntable_left_out"]
    assert json.loads((start.out / "report.json").read_text())["capture"]["photos_left_out"] == [2]
    assert_the_camera_stands_still(stages.rays)


def test_held_out_photos_stand_in_the_same_room(start, ring, monkeypatch):
    found = {}
    original = preparation.Preparation._read_held_out

    def kept(self, *given):
        found["rays"] = original(self, *given)
        return found["rays"]

    monkeypatch.setattr(preparation.Preparation, "_read_held_out", kept)
    ring(turntable=True)
    stages = Looked()
    start(stages, hold_out=3)
    held = found["rays"]
    assert held.views == 2 and stages.rays.views == 4
    assert_the_camera_stands_still(stages.rays)
    place = held.turntable.points(held.cameras()[0])
    assert torch.allclose(place, stages.rays.cameras()[0][:1].expand_as(place), atol=1e-5)


def test_a_resume_with_another_choice_is_refused(start, ring):
    ring(turntable=True)
    start(BallStages())
    code, events = start(BallStages(), resume=True, turntable=False)
    assert code == 2 and events[-1]["name"] == "usage.other_run"
