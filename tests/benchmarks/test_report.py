"""Tables and plots of made-up rows, whose means are known."""

import re
import shutil
from pathlib import Path

import pytest

pytest.importorskip("igl")
from benchmarks.__main__ import DOCUMENTS
from benchmarks.baselines.peer_mitsuba import our_cells
from benchmarks.reports import tables
from benchmarks.reports.report import fill, head, sources_of, write_report
from benchmarks.reports.rows import Results, failures
from benchmarks.row_files import read_row, write_row
from benchmarks.suite.harness import markdown
from benchmarks.suite.kept_rows import kept, load, write_lines
from benchmarks.suite.plan import Run
from blender_nep.errors import OutputError
from support.paths import ROOT

DOCUMENT = ROOT / "docs" / "benchmarks.md"
NONE = tables.NONE
PRESETS = {"preview": (0.004, 100.0), "balanced": (0.002, 300.0)}


def made_up(out: Path, run: Run, error: float, seconds: float, **learned) -> None:
    """Write a row of the form that the suite writes."""
    stages = {"capture": 1.0, "fields_learning": seconds / 2, "surface": 1.0, "material_learning": seconds / 2, "asset": 1.0}
    row = {
        "run": run.as_row(),
        "machine": {
            "system": "Linux",
            "processor": "a core",
            "cores": 2,
            "memory_gb": 8.0,
            "threads": 1,
            "commit": "1234abcd",
            "date": "2026-11-21",
        },
        "learn": {
            "device": "cpu",
            "threads": 1,
            "versions": {"python": "3.11.7", "torch": "2.13.0"},
            "seconds": stages,
            "seconds_total": seconds,
            "cpu_seconds": seconds,
            "peak_mb": 1000.0,
            "views": run.views or 60,
            "pixels": (run.pixels or 40_000) * (run.views or 60),
            "stage_cpu_seconds": {"fields_learning": seconds / 2, "surface": 1.0},
        }
        | learned,
        "score": {
            "cd_visible": error,
            "cd_full": error,
            "normal_deg": 1000 * error,
            "mse_roughness": error,
            "mse_metallic": 0.0,
            "mse_albedo": error,
            "faces": 10_000,
            "texture_rows": 256,
        },
        "relight": {"psnr_mean": 20.0, "ssim_mean": 0.7},
    }
    write_row(out / "rows" / f"{run.name}.json", row)


@pytest.fixture
def out(tmp_path) -> Path:
    """Two captures at two presets with two seeds, one ablation of each stage, a sweep, and one failure."""
    for number, name in enumerate(("suzanne", "box")):
        for preset, (error, seconds) in PRESETS.items():
            for seed in (0, 1):
                made_up(tmp_path, Run(Path(name), preset, seed=seed), error + 0.001 * seed + 0.002 * number, seconds)
        whole = Run(Path(name), "preview", "no cones")
        made_up(tmp_path, whole, 0.006, 70.0, stage_1_of=Run(Path(name), "preview").name)
        made_up(tmp_path, Run(Path(name), "preview", "plain NeuS color"), 0.02, 90.0)
        for views in (8, 16):
            made_up(tmp_path, Run(Path(name), "balanced", views=views), 0.1 / views, 200.0)
        for pixels in (10_000, 160_000):  # fewer and more than the 40,000 of the whole runs
            made_up(tmp_path, Run(Path(name), "balanced", pixels=pixels), 40 / pixels, 250.0)
    for roughness in ("0.05", "0.2"):
        made_up(tmp_path, Run(Path(f"gold_{roughness}"), "balanced"), 0.01, 300.0)
    made_up(tmp_path, Run(Path("suzanne"), "quality"), 0.001, 900.0)
    failed = Run(Path("box"), "quality")
    write_row(
        tmp_path / "rows" / f"{failed.name}.json",
        {"run": failed.as_row(), "machine": {"date": "2026-11-20"}, "learn": {"error": "killed after 7200 s"}},
    )
    return tmp_path


def line_of(table: str, *cells: str) -> list[str]:
    """The cells of the only line of the table that begins with `cells`."""
    lines = [[cell.strip() for cell in line.strip("|").split("|")] for line in table.splitlines()]
    (found,) = [line for line in lines if line[: len(cells)] == list(cells)]
    return found


def test_means_are_of_seeds_and_then_of_captures(out):
    table = tables.presets(Results(load(out)))
    assert line_of(table, "box", "preview")[2:4] == ["2", "0.0065 ± 0.0007"]
    assert line_of(table, "suzanne", "balanced")[3] == "0.0025 ± 0.0007"
    # the mean of 0.0045 and 0.0065; its deviation is 0.0007 / sqrt 2
    assert line_of(table, "**mean**", "preview")[3] == "**0.0055 ± 0.0005**"
    assert "gold_0.05" not in table


@pytest.fixture
def previews(tmp_path) -> Path:
    """`preview` alone on a box that has an ablation, a real object, captures of special plans, and a capture without any."""
    for name in ("box", "bunny", "gold_0.05", "random_1", "random_2", "real"):
        made_up(tmp_path, Run(Path(name), "preview"), 0.002 if name == "box" else 0.008, 100.0)
    made_up(tmp_path, Run(Path("box"), "preview", "no cones"), 0.004, 100.0)
    for name, score in (("random_2", {"error": "killed after 7200 s"}), ("real", {})):
        file = tmp_path / "rows" / f"{Run(Path(name), 'preview').name}.json"
        write_row(file, read_row(file) | {"score": score})
    return tmp_path


def test_special_plans_are_in_no_mean_of_all_captures(previews):
    results = Results(load(previews))
    assert tables.main_captures(results) == ["box", "bunny"]
    table = tables.presets(results)
    assert {line.split("|")[1].strip() for line in table.splitlines()[2:]} == {"box", "bunny", "real", "**mean**"}
    assert line_of(table, "**mean**", "preview")[3] == "**0.0050**"
    table = tables.table_1(results)
    assert dict(zip(line_of(table, "scene"), line_of(table, "Avg."), strict=True))["preview"] == "0.0050"


def test_runs_without_ablation_are_of_captures_that_have_one(previews):
    table = tables.ablations(Results(load(previews)))
    assert line_of(table, "**full** (preview)")[1:4] == ["1", "1", "0.0020"]
    assert line_of(table, "no cones")[1:4] == ["1", "1", "0.0040"]


def test_a_stage_1_that_was_taken_over_counts_in_the_cpu_seconds(out):
    table = tables.ablations(Results(load(out)))
    assert line_of(table, "no cones")[-2] == "121"  # 70 of its own, 50 of the fields, 1 of the surface
    assert line_of(table, "plain NeuS color")[1:4] == ["2", "2", "0.0200"]
    assert line_of(table, "**full** (preview)")[2:4] == ["4", "0.0055 ± 0.0005"]


def test_table_1_shows_the_papers_figures_beside_ours(out):
    table = tables.table_1(Results(load(out)))
    header = line_of(table, "scene")
    suzanne = dict(zip(header, line_of(table, "Suzanne"), strict=True))
    assert suzanne["*NeP*"] == "*0.00227*" and suzanne["balanced"] == "0.0025 ± 0.0007"
    assert suzanne["plain NeuS color (preview)"] == "0.0200" and suzanne["*NeP* r / m / a"] == "*0.001 / 0.022 / 0.029*"
    bunny = dict(zip(header, line_of(table, "Bunny"), strict=True))
    assert bunny["*NeRO*"] == "*0.00153*" and bunny["balanced"] == "-"
    assert dict(zip(header, line_of(table, "Avg."), strict=True))["preview"] == "0.0055 ± 0.0005"


def test_costs_are_those_of_the_rows(out):
    costs = tables.costs(Results(load(out)))
    line = dict(zip(line_of(costs, "capture"), line_of(costs, "box", "preview"), strict=True))
    assert line["seconds"] == "100" and line["fields, CPU s"] == "50" and line["texels"] == "65536" and line["MB"] == "1000"


def test_a_sweep_has_the_whole_runs_and_is_sorted_by_photos(out):
    table = tables.swept(Results(load(out)), "views", "photos")
    assert [line_of(table, "**mean**", "balanced", views)[3] for views in ("8", "16")] == ["0.0125", "0.0063"]
    assert line_of(table, "**mean**", "balanced", "60")[3] == "0.0035 ± 0.0005"
    sizes = [line.split("|")[3].strip() for line in tables.swept(Results(load(out)), "pixels", "").splitlines()[2:]]
    assert list(dict.fromkeys(sizes)) == ["10000", "40000", "160000"]
    assert [values for _, values, _ in tables.sweeps(Results(load(out)), "pixels")] == [[10_000, None, 160_000]]
    assert line_of(tables.roughness(Results(load(out))), "0.05", "balanced")[2] == "0.0100"


def test_our_rows_on_the_true_mesh_stand_beside_the_peers(tmp_path):
    stages = {"fields_learning": 40.0, "surface": 9.0, "material_learning": 20.0}
    for seed in (0, 1):
        made_up(tmp_path, Run(Path("box"), "preview", geometry="true", seed=seed), 0.003, 70.0, stage_cpu_seconds=stages)
    made_up(tmp_path, Run(Path("box"), "preview"), 0.004, 100.0)
    made_up(tmp_path, Run(Path("box"), "preview", geometry="true", views=8), 0.1, 70.0, stage_cpu_seconds=stages)
    unscored = Run(Path("bunny"), "preview", geometry="true")
    made_up(tmp_path, unscored, 0.003, 70.0, stage_cpu_seconds=stages)
    file = tmp_path / "rows" / f"{unscored.name}.json"
    write_row(file, read_row(file) | {"score": {"error": "killed after 7200 s"}})
    assert our_cells(tmp_path, ["bunny", "box"]) == [["box", "ours, preview", 0.003, 0.0, 0.003, 60.0]]


def test_a_failed_run_is_reported_and_counts_in_no_mean(out):
    rows = load(out)
    assert [message for _, message in failures(rows)] == ["learn: killed after 7200 s"]
    assert "killed after 7200 s" in tables.failed(rows)
    table = tables.presets(Results(rows))
    assert line_of(table, "suzanne", "quality")[3] == "0.0010" and "| box | quality" not in table
    assert line_of(table, "**mean**", "quality")[3] == "-"  # suzanne alone is no mean of two


def test_a_report_replaces_only_what_is_between_markers(out, tmp_path):
    document = tmp_path / "figures.md"
    document.write_text(
        "before\n<!-- presets from 1234abc -->\nold\n<!-- end of presets -->\nafter\n<!-- head -->\n<!-- end of head -->\n"
        "<!-- views -->\nby hand\n<!-- end of views -->\n<!-- other -->\nelse\n<!-- end of other -->\n"
    )
    assert sources_of(document) == {"presets": ["1234abc"], "head": [], "views": []}
    used = write_report(document, [str(out)], tmp_path / "kept")
    text = document.read_text()
    assert text.startswith(f"before\n<!-- presets from {out} -->\n| capture") and "\nafter\n" in text and "old" not in text
    assert "of commit 1234abc\n" in text and "2026-11-20 to 2026-11-21" in text and "torch 2.13.0" in text
    assert "else" in text and "by hand" not in text and set(used) == {"presets", "head", "views"}
    write_report(document, [str(out)], tmp_path / "kept")
    assert document.read_text() == text


def test_a_marker_without_sources_is_left_as_it_is(out, tmp_path):
    document = tmp_path / "figures.md"
    text = "<!-- presets -->\nby hand\n<!-- end of presets -->\n"
    document.write_text(text)
    assert write_report(document) == {} and document.read_text() == text


def test_a_table_without_lines_stays_as_it_is(out, tmp_path):
    document = tmp_path / "figures.md"
    text = "<!-- odd from elsewhere -->\na table of random scenes\n<!-- end of odd -->\n"
    document.write_text(text)
    assert write_report(document, [str(out)], tmp_path / "kept") == {} and document.read_text() == text


def test_a_marker_names_commits_whose_rows_are_kept(out, tmp_path):
    document, rows = tmp_path / "figures.md", tmp_path / "kept"
    rows.mkdir()
    found = [row | {"commit": "1234abc"} for row in load(out)]
    write_lines(rows / "1234abc.jsonl", found)
    write_lines(tmp_path / "trial.jsonl", found)
    document.write_text("<!-- presets -->\n<!-- end of presets -->\n")
    write_report(document, [str(tmp_path / "trial.jsonl")], rows)
    assert "<!-- presets from 1234abc -->" in document.read_text()


def test_a_history_keeps_its_older_commits(tmp_path):
    document = tmp_path / "figures.md"
    for commit, date in (("aaaaaaa", "2026-11-20"), ("bbbbbbb", "2026-11-22")):
        run = {"commit": commit, "date": date, "preset": "preview", "seed": 0, "scores": {"cd_visible": 0.1}}
        write_lines(tmp_path / f"{commit}.jsonl", [run | {"capture": name} for name in tables.FOUR])
    document.write_text("<!-- history from aaaaaaa -->\n<!-- end of history -->\n")
    write_report(document, ["bbbbbbb"], tmp_path)
    text = document.read_text()
    assert "<!-- history from aaaaaaa+bbbbbbb -->" in text
    assert [line.split("|")[1].strip() for line in text.splitlines()[3:5]] == ["bbbbbbb", "aaaaaaa"]
    write_report(document, ["aaaaaaa", "bbbbbbb"], tmp_path)
    assert document.read_text() == text


def test_rows_of_the_source_named_first_count(out, tmp_path):
    document, rows = tmp_path / "figures.md", tmp_path / "kept"
    rows.mkdir()
    run = {"capture": "box", "preset": "preview"}
    write_lines(rows / "aaaaaaa.jsonl", [run | {"commit": "aaaaaaa", "seed": 5, "scores": {"cd_visible": 0.1}}])
    others = [run | {"commit": "bbbbbbb", "seed": seed, "scores": {"cd_visible": 0.3}} for seed in (0, 1)]
    write_lines(rows / "bbbbbbb.jsonl", others)
    for sources, line in (("aaaaaaa bbbbbbb", ["1", "0.1000"]), ("bbbbbbb aaaaaaa", ["2", "0.3000"])):
        document.write_text(f"<!-- presets from {sources} -->\n<!-- end of presets -->\n")
        write_report(document, (), rows)
        assert line_of(document.read_text(), "box", "preview")[2:4] == line
    document.write_text("<!-- presets from aaaaaaa+bbbbbbb -->\n<!-- end of presets -->\n")
    write_report(document, (), rows)
    assert line_of(document.read_text(), "box", "preview")[2:4] == ["3", "0.2333 ± 0.1155"]


@pytest.mark.parametrize("document", DOCUMENTS, ids=str)
def test_the_tables_of_the_documents_are_those_of_the_rows(document, tmp_path):
    """A table that is changed by hand, or not written again after a change of its rows, fails here."""
    copy = tmp_path / document.name
    shutil.copy(ROOT / document, copy)
    assert write_report(copy), "no marker of this document names its rows"
    assert copy.read_text() == (ROOT / document).read_text()


def test_a_row_of_means_counts_as_its_seeds():
    run = {"capture": "box", "preset": "preview", "commit": "a"}
    each = [run | {"seed": seed, "scores": {"cd_visible": seed + 1.0}} for seed in range(5)]
    means = run | {"seeds": 3, "scores": {"cd_visible": 2.0}}
    both = Results([means | {"deviations": {"cd_visible": 1.0}}, *each[3:]])
    assert both.count == 5 and both.figure("cd_visible") == Results(each).figure("cd_visible")


def test_the_short_table_has_a_line_for_each_preset(out):
    table = tables.summary(Results(load(out)))
    assert line_of(table, "preview")[1:] == [
        "0.0055",
        "5.5 degrees",
        "0.0055 / 0.0000 / 0.0055",
        "50 s",
        NONE,
        "100 s",
        "1.0 GB",
    ]


def test_the_history_has_a_line_for_each_commit_with_all_four():
    def rows(commit, date, captures, error):
        run = {"commit": commit, "date": date, "preset": "preview", "seed": 0, "scores": {"cd_visible": error}}
        return [run | {"capture": capture} for capture in captures]

    found = rows("aaaaaaa", "2026-11-20", tables.FOUR, 0.002) + rows("bbbbbbb", "2026-11-22", tables.FOUR, 0.001)
    table = tables.history(found + rows("ccccccc", "2026-11-23", tables.FOUR[:3], 0.1))
    assert [line.split("|")[1].strip() for line in table.splitlines()[2:]] == ["bbbbbbb", "aaaaaaa"]
    assert line_of(table, "bbbbbbb")[1:5] == ["2026-11-22", "preview", "1", "0.0010"]


def half_written(path: Path, data: str | bytes, *_, **__) -> None:
    """Take the place of Path.write_text and write_bytes on a disk that is nearly full."""
    with open(path, "wb") as file:
        file.write((data.encode() if isinstance(data, str) else data)[: len(data) // 2])
    raise OSError(28, "No space left on device")


def test_a_document_that_cannot_be_written_stays_as_it_is(tmp_path, monkeypatch):
    document, link = tmp_path / "figures.md", tmp_path / "link.md"
    link.symlink_to(document)
    document.write_text("before\n<!-- peer -->\nold\n<!-- end of peer -->\n")
    text = document.read_text()
    with monkeypatch.context() as patch:
        for name in ("write_text", "write_bytes"):
            patch.setattr(Path, name, half_written)
        with pytest.raises((OSError, OutputError)):
            fill(link, {"peer": "new"})
    assert document.read_text() == text and {path.name for path in tmp_path.iterdir()} == {"figures.md", "link.md"}
    assert fill(link, {"peer": "new"}) == [] and document.read_text() == text.replace("old", "new") and link.is_symlink()


def test_a_message_of_several_lines_stays_in_its_cell():
    table = markdown(["capture", "message"], [["box", "a | b\nc"], ["bunny", 0.12345]])
    assert table.splitlines()[2:] == ["| box | a \\| b c |", "| bunny | 0.1235 |"]


def test_the_head_lists_commits_of_all_steps_with_seven_digits():
    run = {"run": Run(Path("box")).as_row()}
    older = kept(run | {"machine": {"commit": "1234abcd", "date": "2026-11-21"}})
    newer = kept(run | {"machine": {"date": "2026-11-22"}, "commits": {"learn": "1234abcd", "score": "99ff00aa-dirty"}})
    assert head([older]).startswith("- 1 runs, 2026-11-21, of commit 1234abc\n")
    assert head([older, newer]).startswith("- 2 runs, 2026-11-21 to 2026-11-22, of commits 1234abc, 99ff00a-dirty\n")


def test_a_picture_that_cannot_be_written_leaves_the_old_one(out, tmp_path, monkeypatch):
    pytest.importorskip("matplotlib", reason="the extra `bench`")
    from matplotlib.figure import Figure

    from benchmarks.reports.plots import error_against_roughness

    picture = tmp_path / "roughness.png"
    picture.write_bytes(b"an older picture")
    monkeypatch.setattr(Figure, "savefig", lambda _, file, **__: half_written(Path(file), b"half"))
    with pytest.raises((OSError, OutputError)):
        error_against_roughness(Results(load(out)), picture)
    assert picture.read_bytes() == b"an older picture"


def test_a_study_of_scaling_without_points_ends_without_a_plot(tmp_path, capsys):
    from benchmarks.studies import scaling

    one = {"factor": "views", "value": 5, "cpu_seconds": {"decode photos": 0.5}, "peak_mb": 500.0}
    for rows in ([], [one], [one | {"error": "no memory"}]):
        scaling.plot(rows, tmp_path / "scaling.png")
        assert "no plot" in capsys.readouterr().out and not (tmp_path / "scaling.png").exists()
    pytest.importorskip("matplotlib", reason="the extra `bench`")
    scaling.plot([one, one | {"value": 10, "cpu_seconds": {"decode photos": 1.0}}], tmp_path / "scaling.png")
    assert (tmp_path / "scaling.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.slow
def test_every_plot_of_the_report_is_drawn_as_a_small_picture(out, tmp_path):
    pytest.importorskip("matplotlib", reason="the extra `bench`")
    from benchmarks.reports.plots import PLOTS, draw_all

    document = Path(shutil.copy(DOCUMENT, tmp_path))
    draw_all(write_report(document, [str(out)], tmp_path), tmp_path / "figures")
    assert all(1000 < (tmp_path / "figures" / f"{name}.png").stat().st_size < 150_000 for name in PLOTS)
    assert set(re.findall(r"\(benchmarks/(\w+)\.png\)", document.read_text())) == set(PLOTS)


@pytest.mark.parametrize("unscored", [{"error": "killed after 7200 s"}, {}])
def test_a_report_without_any_scored_run_has_no_plots(unscored, out, tmp_path, capsys):
    pytest.importorskip("matplotlib", reason="the extra `bench`")
    from benchmarks.__main__ import main

    for file in (out / "rows").glob("*.json"):
        row = read_row(file)
        write_row(file, {key: value for key, value in row.items() if key != "relight"} | {"score": unscored})
    document = Path(shutil.copy(DOCUMENT, tmp_path))
    assert main(["report", "--from", str(out), "--write", str(document)]) == 0
    assert "of commit 1234abc" in document.read_text()
    assert not document.with_suffix("").exists()


def test_an_unfillable_document_ends_the_command_before_its_work(tmp_path, monkeypatch, capsys):
    from benchmarks.__main__ import main
    from benchmarks.baselines import peer_mitsuba
    from benchmarks.studies import skipping

    with pytest.raises(SystemExit) as ended:
        main(["report", "--write", str(tmp_path / "missing.md")])
    assert ended.value.code == 2 and "missing.md is no file" in capsys.readouterr().err

    (tmp_path / "other.md").write_text("<!-- skip -->\n<!-- end of skip -->\n")
    for command, marker in ((peer_mitsuba, "peer"), (skipping, "skipping")):
        for name, message in (("missing.md", "is no file"), ("other.md", f"has no marker '{marker}'")):
            monkeypatch.setattr("sys.argv", ["command", str(tmp_path / "capture"), "--write", str(tmp_path / name)])
            with pytest.raises(SystemExit) as ended:
                command.main()
            assert ended.value.code == 2 and f"{name} {message}" in capsys.readouterr().err


def test_the_document_shows_only_pictures_that_are_there():
    for name in re.findall(r"\((benchmarks/\w+\.png)\)", DOCUMENT.read_text()):
        assert (DOCUMENT.parent / name).is_file()
