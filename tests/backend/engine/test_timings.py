"""How long a job takes, before the first job on a computer and after it."""

import json

import pytest

from backend.engine.timings import EXPECTED_SECONDS, expected_seconds, remember
from blender_nep.presets import PRESETS


def test_the_first_guesses_are_those_of_the_presets():
    """backend/engine/timings.py repeats them, because Blender's Python does not import the library."""
    assert EXPECTED_SECONDS == {
        name: preset.fields_seconds + preset.surface_seconds + preset.material_seconds for name, preset in PRESETS.items()
    }


@pytest.fixture
def asset(tmp_path):
    """asset(preset, seconds): a folder whose report says so."""
    folder = tmp_path / "asset"
    folder.mkdir()

    def report(preset, seconds):
        (folder / "report.json").write_text(json.dumps({"preset": preset, "seconds_total": seconds}))
        return folder

    return report


def test_the_expected_time_is_the_median_of_the_last_five_jobs(tmp_path, asset):
    file = tmp_path / "new folder" / "timings.json"
    assert expected_seconds(file, "balanced") == (EXPECTED_SECONDS["balanced"], False)
    for seconds in (9000, 9000, 9000, 100, 300, 200, 400, 500):
        remember(file, asset("balanced", seconds))
    assert expected_seconds(file, "balanced") == (300.0, True), "of the last five"
    assert expected_seconds(file, "preview") == (EXPECTED_SECONDS["preview"], False)


def test_a_report_without_a_valid_time_is_not_remembered(tmp_path, asset):
    file = tmp_path / "timings.json"
    remember(file, tmp_path / "missing")
    for preset, seconds in (("balanced", -1), ("balanced", "soon"), ("another", 100)):
        remember(file, asset(preset, seconds))
    assert not file.exists()


def test_a_damaged_file_counts_as_none_and_is_replaced(tmp_path, asset):
    file = tmp_path / "timings.json"
    file.write_text("torn")
    assert expected_seconds(file, "balanced") == (EXPECTED_SECONDS["balanced"], False)
    remember(file, asset("balanced", 200))
    assert expected_seconds(file, "balanced") == (200.0, True)
