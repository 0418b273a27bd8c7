"""How long a job takes, before the first job on a computer and after it."""

import json
from pathlib import Path

import pytest

from backend.engine.timings import EXPECTED_SECONDS, GUESS, THESE_PHOTOS, THIS_COMPUTER, expected_seconds, remember
from blender_nep.presets import PRESETS


def test_the_first_guesses_are_those_of_the_presets():
    """backend/engine/timings.py repeats them, because Blender's Python does not import the library."""
    assert EXPECTED_SECONDS == {
        name: preset.fields_seconds + preset.surface_seconds + preset.material_seconds for name, preset in PRESETS.items()
    }


@pytest.fixture
def asset(tmp_path):
    """asset(preset, seconds, reading, photos, capture): a folder whose report says so."""
    folder = tmp_path / "asset"
    folder.mkdir()

    def report(preset, seconds, reading=0.0, photos=60, capture="/photos"):
        facts = {"capture": {"folder": capture, "views": photos}, "seconds": {"capture": reading}}
        (folder / "report.json").write_text(json.dumps(facts | {"preset": preset, "seconds_total": seconds}))
        return folder

    return report


def test_the_expected_time_is_the_median_of_the_last_five_jobs(tmp_path, asset):
    file = tmp_path / "new folder" / "timings.json"
    assert expected_seconds(file, "balanced") == (EXPECTED_SECONDS["balanced"], GUESS)
    for seconds in (9000, 9000, 9000, 100, 300, 200, 400, 500):
        remember(file, asset("balanced", seconds))
    assert expected_seconds(file, "balanced") == (300.0, THIS_COMPUTER), "of the last five"
    assert expected_seconds(file, "preview") == (EXPECTED_SECONDS["preview"], GUESS)


def test_jobs_with_these_photos_count_before_all_others(tmp_path, asset):
    file = tmp_path / "timings.json"
    remember(file, asset("balanced", 400, reading=60, photos=60, capture="/other"))
    assert expected_seconds(file, "balanced", Path("/mine"), 20) == (340 + 20, THIS_COMPUTER)
    assert expected_seconds(file, "balanced", Path("/mine"), 600) == (340 + 600, THIS_COMPUTER)
    remember(file, asset("balanced", 900, reading=60, photos=60, capture="/mine"))
    assert expected_seconds(file, "balanced", Path("/mine/../mine"), 61) == (900, THESE_PHOTOS)
    assert expected_seconds(file, "balanced", Path("/other"), 60) == (400, THESE_PHOTOS)


def test_a_report_without_a_valid_time_is_not_remembered(tmp_path, asset):
    file = tmp_path / "timings.json"
    remember(file, tmp_path / "missing")
    for preset, seconds in (("balanced", -1), ("balanced", "soon"), ("another", 100)):
        remember(file, asset(preset, seconds))
    remember(file, asset("balanced", 100, photos=0))
    assert not file.exists()


@pytest.mark.parametrize("content", ["torn", '{"balanced": [200.0]}', '{"balanced": [["/a", 1]]}', '{"balanced": 3}'])
def test_a_damaged_file_counts_as_none_and_is_replaced(tmp_path, asset, content):
    file = tmp_path / "timings.json"
    file.write_text(content)
    assert expected_seconds(file, "balanced") == (EXPECTED_SECONDS["balanced"], GUESS)
    remember(file, asset("balanced", 200))
    assert expected_seconds(file, "balanced") == (200.0, THIS_COMPUTER)
