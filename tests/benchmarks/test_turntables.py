"""The benchmark of turntables: what is rendered for it, its ablation, and its table."""

import pytest

pytest.importorskip("fcntl", reason="the suite runs on POSIX systems")
from benchmarks.reports.rows import Results
from benchmarks.reports.tables import main_captures
from benchmarks.reports.turntable_tables import turntable_table
from benchmarks.suite.plan import ABLATIONS, TURNTABLE_OFF, Run
from benchmarks.suite.render import SETS, turntable_options
from blender_nep.presets import PRESETS


def row_of(capture: str, seed: int = 0, error: float = 0.002, **more: object) -> dict:
    run = {"commit": "1234abc", "date": "2026-11-29", "capture": capture, "preset": "balanced", "seed": seed}
    return run | {"scores": {"cd_visible": error, "normal_deg": 5.0}, "seconds": {"cpu_seconds": 300}} | more


def lines_of(table: str) -> list[list[str]]:
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in table.splitlines()]


def test_an_object_is_compared_with_a_walk_and_without_its_turns():
    rows = [row_of("pot_turned", 0, 0.002), row_of("pot_turned", 1, 0.004), row_of("pot_walked", 0, 0.001)]
    rows += [row_of("pot_turned", 0, 0.009, ablation=TURNTABLE_OFF), row_of("box", 0, 0.5)]
    header, _, *lines = lines_of(turntable_table(Results(rows)))
    at = header.index("cd visible")
    assert [(line[0], line[1], line[3], line[at]) for line in lines] == [
        ("pot", "walk", "1", "0.0010"),
        ("pot", "turntable", "2", "0.0030 ± 0.0014"),
        ("pot", "turntable, light turns", "1", "0.0090"),
    ]
    assert main_captures(Results(rows)) == ["box"], "a turntable is no row of the other tables"


def test_each_turntable_has_a_walk_with_the_same_cameras(tmp_path):
    made = {name: turntable_options(name, tmp_path, 40, 256, 16, 1) for name in SETS["turntables"]}
    assert len(made) == 4
    for name in made:
        if name.endswith("_turned"):
            control = made[name.replace("_turned", "_walked")]
            assert control == [*made[name], "--walk"] and made[name][:2] == ["--scene", name.split("_")[0]]


def test_without_turns_the_light_is_learned_as_fixed_to_the_object(tmp_path):
    run = Run(tmp_path, "balanced", TURNTABLE_OFF)
    assert not run.changed_preset.turntable and PRESETS["balanced"].turntable
    assert ABLATIONS[TURNTABLE_OFF] == {"preset": {"turntable": False}} and run.same_stage_1 is None
