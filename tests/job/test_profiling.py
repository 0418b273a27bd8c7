"""Where the time goes: sections add up, by a clock that the test turns; off means off; the file and the report."""

import io
import json
import os

import pytest

from blender_nep.cli import main
from blender_nep.errors import OutputError
from blender_nep.job import runner as job
from blender_nep.job.reporting.events import Events
from blender_nep.job.stage_names import StageName
from blender_nep.presets import preset
from blender_nep.profiling import Profile, profiled, section
from blender_nep.stop_request import StopRequest
from support.ball_stages import BallStages


class Clock:
    """Wall and CPU seconds that pass when the test says so."""

    wall = cpu = 0.0

    def work(self, wall, cpu):
        self.wall, self.cpu = self.wall + wall, self.cpu + cpu


@pytest.fixture
def recorded():
    """A job of 17 wall and 21 CPU seconds: a (twice, with b within), and c, which fails."""
    clock = Clock()
    found = Profile(wall=lambda: clock.wall, cpu=lambda: clock.cpu)

    @profiled("b")
    def inner():
        clock.work(3, 6)

    with found.recording():
        for _ in range(2):
            with section("a"):
                clock.work(1, 0.5)
                inner()
        clock.work(4, 4)
        with pytest.raises(ValueError), section("c"):
            clock.work(5, 4)
            raise ValueError
    with section("after"):
        clock.work(100, 100)
    return found


def test_sections_within_sections_add_up(recorded):
    rows = {r["section"]: (r["calls"], r["wall_s"], r["cpu_s"]) for r in recorded.report()}
    assert rows == {"job": (1, 17, 21), "job / a": (2, 8, 13), "job / a / b": (2, 6, 12), "job / c": (1, 5, 4)}
    lines = recorded.table().splitlines()
    assert [line.split()[0] for line in lines] == ["section", "job", "a", "b", "c"]
    assert lines[2].split()[1:] == ["2", "8.00", "13.00", "61.9"]


def test_a_section_that_is_still_open_counts_what_it_took_so_far():
    clock = Clock()
    found = Profile(wall=lambda: clock.wall, cpu=lambda: clock.cpu)
    with found.recording(), section("a"):
        clock.work(2, 1)
        assert found.report()[1] == {"section": "job / a", "calls": 1, "wall_s": 2, "cpu_s": 1}
        clock.work(3, 1)
    assert found.report()[1]["wall_s"] == 5


def test_the_flame_graph_holds_every_second_once(recorded, tmp_path):
    path = tmp_path / "profile.json"
    recorded.write(path)
    found = json.loads(path.read_text())
    names = [frame["name"] for frame in found["shared"]["frames"]]
    for graph, whole, expected in zip(found["profiles"], (17, 21), ([4, 2, 6, 5], [4, 1, 12, 4]), strict=True):
        assert graph["weights"] == expected and graph["endValue"] == whole == sum(graph["weights"])
        assert [[names[k] for k in stack] for stack in graph["samples"]] == [
            ["job"],
            ["job", "a"],
            ["job", "a", "b"],
            ["job", "c"],
        ]
    assert os.listdir(tmp_path) == ["profile.json"]


def nothing_is_recorded() -> bool:
    """Then there is one context that does nothing, whatever the name of the section."""
    return section("a") is section("b")


def test_nothing_is_recorded_when_nobody_asks():
    assert nothing_is_recorded()


@pytest.mark.parametrize("asked", [False, True])
def test_a_job_says_where_its_time_went(make_capture, tmp_path, asked):
    out, human = tmp_path / "asset", io.StringIO()
    settings = job.Settings(make_capture().folder, out, preset("preview"), profile=asked)
    assert job.run(settings, Events(None, human), StopRequest(), BallStages()) == 0
    report = json.loads((out / "report.json").read_text())
    assert (out / "profile.json").exists() == ("profile" in report) == ("CPU %" in human.getvalue()) == asked
    assert nothing_is_recorded()
    if asked:
        rows = {row["section"]: row["wall_s"] for row in report["profile"]}
        stages = [name for name in rows if name.count(" / ") == 1]
        first, *others = StageName
        assert stages == [f"job / {name}" for name in (first, "scene analysis", *others)]
        assert 0 < sum(rows[stage] for stage in stages) <= rows["job"] + 0.01
        assert rows["job / capture / decode photos"] <= rows["job / capture"]
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr("blender_nep.files.os.replace", _full_disk)
            with pytest.raises(OutputError, match="disk is full"):
                Profile().write(out / "profile.json")
        assert json.loads((out / "profile.json").read_text())["profiles"], "the old file stays whole"


def test_the_command_line_asks_for_it(tmp_path, monkeypatch):
    asked = []
    monkeypatch.setattr(job, "run", lambda settings, *_: asked.append(settings.profile) or 0)
    for extra in ([], ["--profile"]):
        monkeypatch.setattr("blender_nep.job.reporting.events.open_protocol", lambda: None)
        assert main(["reconstruct", str(tmp_path), "--out", str(tmp_path / "x"), *extra]) == 0
    assert asked == [False, True]


def _full_disk(*_):
    raise OSError(28, "No space left on device")
