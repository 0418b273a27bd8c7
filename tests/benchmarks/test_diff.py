"""What got better or worse between made-up rows, whose differences and spreads are known."""

import numpy as np
import pytest

pytest.importorskip("fcntl", reason="the suite runs on POSIX systems")
from benchmarks.__main__ import main
from benchmarks.reports.diff import compare
from benchmarks.reports.tables import FOUR
from benchmarks.suite.kept_rows import write_lines


def rows(scores: list[float], capture: str = "box", name: str = "cd_visible", preset: str = "preview", **more) -> list[dict]:
    """A row for each seed, with one score."""
    run = {"commit": "a", "capture": capture, "preset": preset} | more
    return [run | {"seed": seed, "scores": {name: score}} for seed, score in enumerate(scores)]


def names(found) -> list[tuple[str, str]]:
    return [(name, one.name) for name, one in found]


def test_more_than_the_spread_of_seeds_counts():
    before = rows([0.0020, 0.0021, 0.0022])
    assert names(compare(before, rows([0.0040, 0.0041, 0.0042])).worse) == [("box preview", "cd_visible")]
    assert names(compare(before, rows([0.0010, 0.0011, 0.0012])).better) == [("box preview", "cd_visible")]


def test_within_the_spread_of_seeds_nothing_counts():
    found = compare(rows([0.0010, 0.0030, 0.0050]), rows([0.0020, 0.0050, 0.0060]))
    assert not found.better and not found.worse and not found.got_worse


@pytest.mark.parametrize("name", ["psnr_mean", "ssim_mean", "mask_iou", "background_psnr", "fscore_005"])
def test_of_some_scores_more_is_better(name):
    assert names(compare(rows([0.1, 0.1], name=name), rows([0.9, 0.9], name=name)).better) == [("box preview", name)]


def test_a_difference_that_no_table_shows_does_not_count():
    found = compare(rows([0.00200] * 3), rows([0.00205] * 3))
    assert not found.worse
    assert compare(rows([0.0020] * 3), rows([0.0021] * 3)).worse


def test_of_one_seed_each_nothing_can_be_said():
    found = compare(rows([0.001]), rows([0.1]))
    assert not found.worse and not found.got_worse
    assert "One seed on each side, so nothing can be said of box preview." in found.text("a", "b")
    assert "nothing can be said of one seed" in found.text("a", "b") and "beyond the spread" not in found.text("a", "b")


def test_the_seeds_of_either_side_tell_the_spread():
    assert compare(rows([0.0020, 0.0021, 0.0022]), rows([0.1])).worse


def test_the_mean_of_captures_tells_what_one_does_not():
    noise = np.random.default_rng(0).normal(0, 1e-4, (2, 4, 3))
    sides = [
        [row for k, name in enumerate(FOUR) for row in rows(list(0.002 + shift + noise[side, k]), name)]
        for side, shift in enumerate((0.0, 3e-4))
    ]
    assert ("preview, mean", "cd_visible") in names(compare(*sides).worse)
    equal = [[row for k, name in enumerate(FOUR) for row in rows(list(0.002 + noise[side, k]), name)] for side in range(2)]
    assert not compare(*equal).worse and not compare(*equal).better


def test_equal_code_seldom_differs():
    chance, wrong = np.random.default_rng(1), 0
    for _ in range(40):
        sides = [[row for name in FOUR for row in rows(list(chance.normal(0.01, 1e-3, 3)), name)] for _ in range(2)]
        found = compare(*sides)
        wrong += bool(found.better or found.worse)
    assert wrong <= 6, "two of forty are expected"


def test_pairs_agree_in_all_but_the_seed():
    before = rows([0.1, 0.1]) + rows([0.1, 0.1], "bunny") + rows([0.1, 0.1], ablation="no cones")
    after = rows([0.1, 0.1]) + rows([0.1, 0.1], preset="quality") + rows([0.1, 0.1], ablation="no cones", views=8)
    found = compare(before, after)
    assert [pair.name for pair in found.pairs] == ["box preview"]
    assert found.alone == (["bunny preview", "box preview no cones"], ["box quality", "box preview no cones 8 views"])


def test_seconds_are_ratios_and_decide_nothing():
    sides = [[row | {"seconds": {"cpu_seconds": seconds}} for row in rows([0.1, 0.1])] for seconds in (100.0, 250.0)]
    found = compare(*sides)
    assert found.pairs[0].ratios == {"cpu_seconds": 2.5} and not found.got_worse
    assert "| box preview | 2.50 | - |" in found.text("a", "b")


def test_a_run_that_fails_now_is_worse():
    failed = [{"commit": "b", "capture": "box", "preset": "preview", "seed": 1, "error": "learn: no surface was found"}]
    found = compare(rows([0.1, 0.1]), rows([0.1]) + failed)
    assert found.got_worse and not compare(rows([0.1]) + failed, rows([0.1]) + failed).got_worse
    assert "box preview: more runs fail" in found.text("a", "b") and "no surface was found" in found.text("a", "b")


def test_what_acts_no_longer_is_noted():
    def acted(**what):
        return [row | {"refinements": what} for row in rows([0.1, 0.1])]

    found = compare(
        acted(relief={"acted": [0.8]}, carve={"skipped": "a convex object"}, hull={"acted": [0.0]}),
        acted(relief={"skipped": "coarse photos"}, carve={"acted": [0.5]}, hull={"acted": [0.0]}),
    )
    assert found.pairs[0].notes == ["carve did not act before", "relief does not act any more"]


def test_other_photos_are_noted():
    sides = [[row | {"photos": photos} for row in rows([0.1, 0.1])] for photos in ("aa", "bb")]
    assert compare(*sides).pairs[0].notes == ["other photos than before"]


@pytest.mark.parametrize(("after", "code"), [([0.1, 0.1], 0), ([0.2, 0.2], 1), ([0.05, 0.05], 0)])
def test_the_command_ends_with_1_where_anything_is_worse(after, code, tmp_path, capsys):
    for name, scores in (("aaaaaaa", [0.1, 0.1]), ("bbbbbbb", after)):
        write_lines(tmp_path / f"{name}.jsonl", rows(scores))
    assert main(["diff", "aaaaaaa", "bbbbbbb", "--rows", str(tmp_path)]) == code
    assert "Worse from aaaaaaa to bbbbbbb" in capsys.readouterr().out


def test_an_ablation_is_compared_with_whole_jobs(tmp_path, capsys):
    whole, ablated = rows([0.1, 0.1]), rows([0.2, 0.2], ablation="without relief") + rows([0.3, 0.3], ablation="no cones")
    write_lines(tmp_path / "aaaaaaa.jsonl", whole + ablated)
    assert main(["diff", "aaaaaaa", "aaaaaaa", "--ablation", "without relief", "--rows", str(tmp_path)]) == 1
    assert "box preview: cd visible 0.10000 -> 0.20000" in capsys.readouterr().out


def test_the_command_refuses_what_cannot_be_compared(tmp_path, capsys):
    write_lines(tmp_path / "aaaaaaa.jsonl", rows([0.1]))
    write_lines(tmp_path / "bbbbbbb.jsonl", rows([0.1], "bunny"))
    assert main(["diff", "aaaaaaa", "ccccccc", "--rows", str(tmp_path)]) == 2
    assert "ccccccc: " in capsys.readouterr().err
    assert main(["diff", "aaaaaaa", "bbbbbbb", "--rows", str(tmp_path)]) == 2
    assert "share no capture and preset" in capsys.readouterr().out
