"""The driver of the refinements, with made-up refinements: when they are due, what they renew, what the report says."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from blender_nep.capture import PixelRays, load_capture
from blender_nep.fields.refinements import cavities
from blender_nep.fields.refinements.catalog import refinements_of
from blender_nep.fields.refinements.driver import RefinementDriver
from blender_nep.fields.refinements.refinement import Change
from blender_nep.fields.training import FieldsLearning
from blender_nep.messages import Message, Part
from blender_nep.presets import FieldsPreset
from blender_nep.scene.scene import Scene
from support.brief_preset import brief_preset
from support.paths import SUZANNE_SMALL


class Stage:
    """A stage 1 of which only the fraction is known, and which optimizers were made anew."""

    def __init__(self):
        self.schedule, self.optimizers = self, self
        self.fraction, self.restarted = 0.0, []

    def restart(self, name):
        self.restarted.append(name)


class Played:
    """A refinement that notes when it is applied."""

    def __init__(self, name, at, change=None, why=None):
        self.name, self.at, self.applied = name, at, []
        self._change, self._why = change or Change(True), why

    def skipped(self, stage):
        return self._why

    def apply(self, stage):
        self.applied.append(stage.fraction)
        return self._change


def run(driver, fractions, stage=None):
    stage = stage or Stage()
    for fraction in fractions:
        stage.fraction = fraction
        driver.apply_due(stage)
    return stage


def test_each_is_applied_once_at_each_fraction():
    carve, relief = Played(Part.CARVE, (0.5, 0.75)), Played(Part.RELIEF, (0.8,))
    run(RefinementDriver([carve, relief]), [k / 10 for k in range(11)])
    assert carve.applied == [0.5, 0.8] and relief.applied == [0.8]


def test_fractions_that_are_passed_in_one_step_count_once():
    carve = Played(Part.CARVE, (0.5, 0.75))
    run(RefinementDriver([carve]), [0.4, 0.9, 1.0])
    assert carve.applied == [0.9]


def test_they_are_applied_in_their_order():
    order = []
    hull, paint = Played(Part.HULL, (0.0,)), Played(Part.FINE_PAINT, (0.0,))
    for one in (hull, paint):
        one.skipped = lambda stage, one=one: order.append(one.name)
    run(RefinementDriver([hull, paint]), [0.0])
    assert order == [Part.HULL, Part.FINE_PAINT]


def test_optimizers_of_renewed_parameters_are_made_anew():
    levels = Played(Part.LEVELS, (0.5,), Change(True, {}, ("sdf", "heads")))
    nothing = Played(Part.RELIEF, (0.5,), Change(False))
    assert run(RefinementDriver([levels, nothing]), [0.0, 0.5, 1.0]).restarted == ["sdf", "heads"]


def test_the_report_says_what_was_found_or_why_not():
    masks = Message("reason.no_masks")
    driver = RefinementDriver(
        [
            Played(Part.HULL, (0.0, 0.5), Change(True, {"volume": 0.123456789})),
            Played(Part.CAVITIES, (0.5,), Change(False, {"parts_tried": 2})),
            Played(Part.HIDDEN_PIXELS, (0.0,), why=masks),
            Played(Part.CARVE, ()),
            Played(Part.RELIEF, (math.inf,)),
        ]
    )
    run(driver, [0.0, 0.5, 1.0])
    report = driver.report()
    assert report["hull"] == {"acted": [0.0, 0.5], "volume": 0.1235}
    assert report["cavities"] == {"skipped": Message("reason.found_nothing").to_dict(), "parts_tried": 2}
    assert report["hidden_pixels"] == {"skipped": masks.to_dict()}
    assert report["carve"] == report["relief"] == {"skipped": Message("reason.preset").to_dict()}


def test_what_is_switched_off_is_not_applied():
    hull, carve = Played(Part.HULL, (0.0,)), Played(Part.CARVE, (0.5,))
    driver = RefinementDriver([hull, carve], without=("hull",))
    run(driver, [0.0, 0.5])
    assert not hull.applied and carve.applied == [0.5]
    assert driver.report()["hull"] == {"skipped": Message("reason.preset").to_dict()}


def test_an_unknown_name_is_an_error():
    with pytest.raises(ValueError, match="no refinement named dust"):
        FieldsPreset(without=("dust",))


def test_a_resumed_driver_goes_on():
    first, second = (RefinementDriver([Played(Part.CARVE, (0.5, 0.75), Change(True, {"share": 0.25}))]) for _ in range(2))
    run(first, [0.0, 0.5])
    second.load(first.state())
    assert second.report() == first.report()
    refinement = Played(Part.CARVE, (0.5, 0.75))
    resumed = RefinementDriver([refinement])
    resumed.load(first.state())
    run(resumed, [0.6, 0.75])
    assert refinement.applied == [0.75]
    assert resumed.report()["carve"]["acted"] == [0.5, 0.75]


def test_each_refinement_can_be_switched_off_alone(monkeypatch):
    """A search for cavities takes longer than all others together; here it finds none."""
    monkeypatch.setattr(cavities, "find_cavities", lambda rays, sdf, background: cavities.Cavities(np.zeros_like(sdf), 0))
    rays = PixelRays.from_capture(load_capture(SUZANNE_SMALL), 500, False, torch.device("cpu"))
    names = [refinement.name for refinement in refinements_of(FieldsPreset())]
    assert len(set(names)) == len(names)
    for name in names:
        once = {"carve_again_at": (0.5,), "open_cavities_at": 0.5, "object_pixels_at": (0.0,)}
        preset = brief_preset(background_steps=1, steps=4, without=(str(name),), **once)
        learning = FieldsLearning(Scene.of(rays), replace(preset), 0)
        while learning.fraction < 1:
            learning.learn_step()
        report = learning.refinements.report()
        assert report[name] == {"skipped": Message("reason.preset").to_dict()}
        others = [entry for other, entry in report.items() if other != name and "skipped" in entry]
        assert all(entry["skipped"]["code"] != "reason.preset" for entry in others)
