"""What a job says of how well its asset explains the photos, and of photos that are held out."""

import json
from dataclasses import replace

import pytest

from backend.engine.words import EngineMessage
from blender_nep.asset.photo_score import PhotoScore
from blender_nep.capture import load_capture
from blender_nep.capture.held_out import split
from blender_nep.errors import UsageError
from blender_nep.job.explained import LEAST_OF_OBJECT, LEAST_OF_SURROUNDINGS, MOST_HUE, ExplainedReport
from blender_nep.materials.explained_photos import Explained
from support.ball_stages import BallStages

GOOD = PhotoScore(psnr=24.4, hue_deg=3.2, gains={0: 1.0}, psnr_of_photos={0: 24.4}, pixels=1500)


def report(of_object: float, beside: float, hold_out: int | None = None) -> ExplainedReport:
    return ExplainedReport(Explained(replace(GOOD, psnr=of_object), replace(GOOD, psnr=beside)), hold_out)


def test_a_good_asset_is_told_in_a_sentence_without_warning():
    found = report(24.4, 27.0)
    assert [str(line) for line in found.sentences()] == ["The asset explains its photos to 24 dB; hues differ by 3 degrees."]
    assert found.warnings() == []
    assert [str(line) for line in report(24.4, 27.0, 8).sentences()] == [
        "The asset explains held-out photos to 24 dB; hues differ by 3 degrees.",
        "The recovered light explains what they show beside the object to 27 dB.",
    ]


@pytest.mark.parametrize(
    ("of_object", "beside", "codes"),
    [
        (LEAST_OF_OBJECT, LEAST_OF_SURROUNDINGS, []),
        (LEAST_OF_OBJECT - 0.1, 27.0, ["job.photos_not_explained"]),
        (24.0, LEAST_OF_SURROUNDINGS - 0.1, ["job.surroundings_not_explained"]),
        (12.0, 12.0, ["job.photos_not_explained", "job.surroundings_not_explained"]),
    ],
)
def test_what_explains_too_little_is_a_warning(of_object, beside, codes):
    warnings = report(of_object, beside).warnings()
    assert [warning.code for warning in warnings] == codes
    for warning in warnings:
        words = EngineMessage.of(warning.to_dict()).words(str)
        found, least = warning.values["decibels"], warning.values["least"]
        assert f"{found:.1f} dB" in words and f"{least:.0f} dB" in words and "one light" in words
        assert f"{found:.1f}" != f"{least:.1f}", "a figure that misses the bar does not look like the bar"
        assert words != str(warning)  # the panel has words of its own


def test_a_wrong_hue_alone_is_a_warning():
    wrong = ExplainedReport(Explained(replace(GOOD, hue_deg=MOST_HUE + 0.1), GOOD), None)
    assert [warning.code for warning in wrong.warnings()] == ["job.photos_not_explained"]
    assert ExplainedReport(Explained(None, None), None).warnings() == []


def test_a_job_scores_the_photos_that_it_held_out(start):
    code, events = start(BallStages(), hold_out=3)
    assert code == 0
    written = json.loads((start.out / "report.json").read_text())
    assert written["capture"]["views"] == 4 and written["explained"]["hold_out"] == 3
    assert written["explained"]["object"]["pixels"] > 100
    told = [line["code"] for line in written["scene"]["sentences"]]
    assert "scene.explains_held_out" in told
    found = written["explained"]["object"]
    wrong = found["psnr"] < LEAST_OF_OBJECT or found["hue_deg"] > MOST_HUE
    assert ("job.photos_not_explained" in [e["code"] for e in events if e["event"] == "warning"]) == wrong
    code, events = start(BallStages(), hold_out=2, resume=True)
    assert code == 2 and events[-1]["values"]["different"] == ["photos held out"]


def test_too_few_photos_to_learn_from_are_refused(make_capture):
    capture = load_capture(make_capture().folder)
    learned, held = split(capture, 3)
    names = [view.name for view in capture.views]
    assert [view.name for view in held.views] == names[::3] and len(learned.views) == 4
    with pytest.raises(UsageError, match="--hold-out 2 leaves 2 of 4 photos"):
        split(learned, 2)
