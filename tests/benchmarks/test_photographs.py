"""The benchmark of photographs: what it renders and develops, with steps that learn nothing, and its table."""

from pathlib import Path

import pytest

pytest.importorskip("fcntl", reason="the suite runs on POSIX systems")
import benchmarks.__main__ as command
from benchmarks.reports.photograph_tables import photograph_table
from benchmarks.reports.random_tables import scenes_of
from benchmarks.row_files import write_row
from benchmarks.scoring.environment import exposures_differ
from benchmarks.suite.harness import Ended
from benchmarks.suite.render import photograph_options
from benchmarks.suite.runner import Suite

ERRORS = {"clean": 0.002, "room": 0.003, "noise": 0.0}


def row_of(capture: str, error: float | None, **more: object) -> dict:
    run = {"commit": "1234abc", "date": "2026-11-28", "capture": capture, "preset": "preview", "seed": 0}
    scores = {name: error for name in ("cd_visible", "mse_albedo", "mse_roughness", "mse_metallic", "normal_deg")}
    return run | ({"error": "learn: no surface"} if error is None else {"scores": scores}) | more


def lines_of(table: str) -> list[list[str]]:
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in table.splitlines()]


def test_each_effect_is_compared_with_the_clean_render():
    rows = [row_of("box+all", None), row_of("box+room", 0.003), row_of("box+clean", 0.002), row_of("box", 0.9)]
    rows += [row_of("pot+noise", 0.004), row_of("box+room", 0.5, ablation="no cones")]
    header, _, *lines = lines_of(photograph_table(rows))
    at = header.index("cd visible")
    assert [(line[0], line[2], line[at], line[-1]) for line in lines] == [
        ("box", "clean", "0.0020", ""),
        ("box", "all", "-", "learn: no surface"),
        ("box", "room", "0.0030 (1.5 x)", ""),
        ("pot", "clean", "-", ""),
        ("pot", "noise", "0.0040", ""),
    ]
    assert lines[2][header.index("normals, °")] == "0.0"


def test_photographs_of_a_random_scene_are_no_random_scene():
    assert [scene.seed for scene in scenes_of([row_of("random_3", 0.1), row_of("random_3+room", 0.1)])] == [3]


def test_development_alone_does_not_render_again(tmp_path):
    (tmp_path / "pot+clean").mkdir()

    def options(effect: str, thing: str = "/meshes/pot.obj") -> list[str]:
        return photograph_options(thing, effect, tmp_path / f"pot+{effect}", 40, 64, 4, 1)

    assert options("noise")[:2] == ["--scene", "/meshes/pot.obj"], "without the clean capture it is rendered"
    for color_space, first in (("srgb", "--scene"), ("linear", "--develop")):
        write_row(tmp_path / "pot+clean" / "transforms.json", {"color_space": color_space})
        assert options("noise")[0] == first and options("camera")[0] == first
        assert options("noise")[-2:] == ["--photograph", "noise"]
        assert options("room")[0] == options("all")[0] == "--scene" and "--photograph" not in options("clean")
    assert options("room", "random_3")[:2] == ["--random", "3"] and "--views" not in options("room", "random_3")


def test_the_command_renders_the_clean_object_first(tmp_path, monkeypatch, capsys):
    out, document, rendered = tmp_path / "out", tmp_path / "photographs.md", []
    document.write_text("<!-- photographs -->\nold\n<!-- end of photographs -->\n")

    class FakeChildren:
        def run(self, arguments, log, threads, limit):
            rendered.append(arguments[-6])
            write_row(Path(arguments[-5]) / "transforms.json", {"w": 256})
            return Ended(0, 1.0, 1.0, 1.0, False)

    def run_step(suite, step, run, asset):
        if step == "learn":
            return {"seconds_total": 1.0, "cpu_seconds": 1.0}
        return {"cd_visible": ERRORS[run.capture.name.rpartition("+")[2]]}

    monkeypatch.setattr(command, "Children", FakeChildren)
    monkeypatch.setattr(Suite, "run_step", run_step)
    monkeypatch.setattr(Suite, "identify", lambda suite, runs: {})
    arguments = ["photographs", "--objects", "box", "--effects", "room", "noise", "--out", str(out)]
    arguments += ["--write", str(document), "--rows", str(tmp_path / "rows")]
    assert command.main(arguments) == 0
    assert rendered == ["box+clean", "box+room", "box+noise"]
    table = document.read_text()
    assert "0.0030 (1.5 x)" in table and "0.0000 (0.0 x)" in table and "old" not in table
    assert "0.0030 (1.5 x)" in capsys.readouterr().out


def test_developed_photos_leave_test_photos_another_exposure(tmp_path):
    for photos, expected in (([], False), ([{"gain": 0.4}], True)):
        write_row(tmp_path / "photographs.json", {"effects": ["noise"], "photos": photos})
        assert exposures_differ(tmp_path) == expected
