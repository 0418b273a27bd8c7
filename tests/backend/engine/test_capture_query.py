"""The engine's answers about a capture: the object's sphere, the check of the photos, failures; and their words."""

import json

import pytest

from backend.engine.command import NoEngineError, info_arguments
from backend.engine.commands.capture_query import CaptureQuery
from backend.engine.results import capture_facts
from blender_nep import command_line
from blender_nep.capture.doctor import coverage_picture
from support import info_engine
from support.waiting import wait_until

BOUNDS = ("--object-center", "-1.0", "2.0", "3.0", "--object-radius", "0.5")


@pytest.fixture
def engine(tmp_path, monkeypatch):
    """engine(mode): the path of an engine that behaves so."""
    monkeypatch.delenv("NEP_ENGINE_PYTHON", raising=False)

    def make(mode: str) -> str:
        (tmp_path / "info_mode").write_text(mode)
        return info_engine.make(tmp_path)

    return make


def asked(python: str, tmp_path, **options) -> CaptureQuery:
    """The query after its end."""
    query = CaptureQuery(tmp_path / "photos", python, **options)
    wait_until(query.poll)
    return query


def test_the_library_understands_the_arguments(tmp_path):
    found = command_line.parser().parse_args(info_arguments("/photos", picture=tmp_path / "a.png", bounds=BOUNDS))
    assert (found.command, str(found.capture), found.json, found.picture) == ("info", "/photos", True, tmp_path / "a.png")
    assert command_line.sphere(found) == ((-1.0, 2.0, 3.0), 0.5)
    assert info_arguments("/photos") == ["info", "/photos", "--json"]


def test_a_query_gives_the_sphere_the_facts_and_the_picture(engine, tmp_path):
    query = asked(engine("well"), tmp_path, picture=True, bounds=BOUNDS)
    assert query.error is None and query.found == info_engine.FOUND and query.sphere == ([0.1, 0.2, 0.3], 0.7)
    given = json.loads((tmp_path / "info_arguments.json").read_text())
    assert given == [str(tmp_path / "photos"), "--json", "--picture", str(query.picture), *BOUNDS]
    assert query.picture.is_file()
    query.close()
    assert not query.picture.parent.exists()
    assert asked(engine("well"), tmp_path).picture is None


@pytest.mark.parametrize(
    ("mode", "message", "hint", "log"),
    [
        ("fail", "Photo_3.jpg is torn", "Take photo_3.jpg out of the folder", ""),
        ("silent", "The engine could not look at the capture.", "", "the last words"),
        ("old", "The installed engine is older than this add-on", "Install the engine", ""),
    ],
)
def test_a_failure_is_told_in_the_words_of_the_panel(engine, tmp_path, mode, message, hint, log):
    query = asked(engine(mode), tmp_path, picture=True)
    said, advice = query.error.words()
    assert query.found is None and query.sphere is None
    assert said.startswith(message) and advice.startswith(hint) and query.error.log == log


def test_a_python_that_cannot_be_started(tmp_path, monkeypatch):
    monkeypatch.delenv("NEP_ENGINE_PYTHON", raising=False)
    assert isinstance(asked(str(tmp_path / "none"), tmp_path).error, NoEngineError)


def test_a_closed_query_ends_its_engine(engine, tmp_path):
    query = CaptureQuery(tmp_path, engine("slow"), picture=True)
    wait_until((tmp_path / "info_arguments.json").exists)
    query.close()
    wait_until(query.poll)
    assert query.found is None and not query.picture.parent.exists()


def test_facts_and_warnings_in_words():
    found = info_engine.FOUND
    assert capture_facts.facts_of(found) == [
        "6 photos of 48 x 32 pixels",
        "41 % of all directions are near a photo",
        "No photo was taken within 70 degrees of straight below",
        "The object's sphere is about 31 pixels wide in the photos",
        "Exposure: up to 1.3 stops apart, which is evened out",
    ]
    blurred, unknown = (said.words() for said in capture_facts.warnings_of(found))
    assert blurred.startswith("1 photo is clearly more blurred") and unknown == "Too many moons"
    told = capture_facts.facts_of(found | {"warnings": [found["largest_hole"]]})
    assert not [line for line in told if "straight below" in line], "it is told once"
    exposures = [capture_facts.facts_of({"exposure_stops": stops})[-1] for stops in (None, 0.0)]
    assert exposures == ["Exposure: not known", "Exposure: no clear difference between the photos"]
    assert capture_facts.facts_of({"photos": 5, "sizes": {"a": 2, "b": 3}}) == ["5 photos of 2 sizes"]
    assert capture_facts.facts_of({}) == [] and capture_facts.warnings_of({}) == []
    assert capture_facts.facts_of(found, "<{}>".format)[0] == "<6 photos of 48 x 32 pixels>"


def test_the_panel_shows_the_discs_and_not_the_legend():
    """The panel halves the picture: a disc must lie in each half, and in the part of the height that is shown."""
    (width, height), radius = coverage_picture.SIZE, coverage_picture.RADIUS
    for number, (column, row) in enumerate(coverage_picture.MIDDLES):
        assert number * width / 2 < column - radius and column + radius < (number + 1) * width / 2
        first, last = (part * height for part in capture_facts.DISCS_ROWS)
        assert first < row - radius and row + radius < last
