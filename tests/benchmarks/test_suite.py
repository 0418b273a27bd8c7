"""The suite's plans, its runner (with steps that learn nothing) and its captures with fewer photos."""

import json
import os
import shutil
import subprocess
import sys
import threading
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("fcntl", reason="the suite runs on POSIX systems")
from benchmarks.__main__ import main
from benchmarks.row_files import failure, read_row, write_row
from benchmarks.suite import runner
from benchmarks.suite.fewer_views import spread, with_fewer_views
from benchmarks.suite.harness import Children, Ended, command_of
from benchmarks.suite.plan import ABLATIONS, OF_SOME_CAPTURES, PLANS, WITHOUT_F_E, Run, expand, without_each
from benchmarks.suite.runner import OtherRowsError, Suite
from benchmarks.suite.step import STAGE_1, NoLight, learn, take_stage_1
from blender_nep.capture import load_capture
from blender_nep.checkpoints import save_state
from blender_nep.fields.refinements.catalog import refinements_of
from blender_nep.job.folders.run_folder import RunFolder, fingerprint
from blender_nep.presets import EVIDENCE, PRESETS, REFINEMENTS, FieldsPreset, preset
from blender_nep.shading.unseen_light import UnseenLight
from blender_nep.stop_request import StopRequest
from support.paths import ROOT, SUZANNE_SMALL
from support.traps import set_traps


class FakeSuite(Suite):
    """A suite whose steps learn nothing. The learning of seed 1 fails. `done` lists the steps that were done."""

    def __init__(self, *arguments, **keywords):
        super().__init__(*arguments, **keywords)
        self.done, self.now = [], {"capture": "a1", "preset": "preview b2"}

    def identify(self, runs):
        return {run.name: self.now for run in runs}

    def run_step(self, step, run, asset):
        self.done.append((step, run.name))
        return {"error": "no surface was found"} if step == "learn" and run.seed == 1 else {"figure": 1.0}


def test_a_plan_crosses_what_it_names_and_wishes_override_it():
    two = [Path("a/box"), Path("b/bunny")]
    runs = expand(["presets"], two, {})
    assert len(runs) == 2 * 3 * 3 and len({run.name for run in runs}) == len(runs)
    assert {run.ablation for run in runs} == {"full"} and [run.seed for run in runs[:6]] == [0] * 6
    assert [run.preset for run in expand(["presets"], two[:1], {"preset": ("quality",), "seed": (5,)})] == ["quality"]
    everything = {run.name for run in expand(["all"], two, {})}
    assert everything == {run.name for name in PLANS for run in expand([name], two, {})}
    assert len(expand([], two, {"ablation": tuple(ABLATIONS)})) == 2 * len(ABLATIONS)
    assert not any(run.ablation in OF_SOME_CAPTURES for run in expand(["all"], two, {}))


def test_each_refinement_and_evidence_has_an_ablation():
    assert tuple(str(one.name) for one in refinements_of(FieldsPreset())) == REFINEMENTS
    assert {f"without {name}" for name in (*REFINEMENTS, *EVIDENCE)} <= set(ABLATIONS)


def test_the_runner_needs_no_torch():
    """Linux counts the runner's own memory into the peak memory of the steps that it starts."""
    code = "import sys, benchmarks.suite.runner; sys.exit('torch' in sys.modules or 'numba' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=False).returncode == 0


def test_each_name_has_an_ablation_without_it():
    assert without_each("fields", ("hull", "hidden_pixels")) == {
        "without hull": {"fields": {"without": ("hull",)}},
        "without hidden_pixels": {"fields": {"without": ("hidden_pixels",)}},
    }


def test_only_whole_jobs_as_a_user_would_run_them_are_relit(tmp_path):
    plain = Run(SUZANNE_SMALL, "preview")
    changes = {"ablation": "no cones", "views": 8, "pixels": 99, "geometry": "true"}
    others = [replace(plain, **{name: value}) for name, value in changes.items()]
    suite = FakeSuite(tmp_path, relight=True)
    suite.run_all([plain, replace(plain, preset="quality"), *others], 1)
    relit = {name for step, name in suite.done if step == "relight"}
    assert relit == {plain.name, replace(plain, preset="quality").name}


@pytest.mark.parametrize(
    ("captures", "message"),
    [
        ([SUZANNE_SMALL, SUZANNE_SMALL / "images" / ".."], "two captures have the same name"),
        ([SUZANNE_SMALL.parent / "nothing"], "is no capture: it has no transforms.json"),
    ],
)
def test_captures_of_one_name_and_empty_folders_are_refused(captures, message, tmp_path, capsys):
    with pytest.raises(SystemExit) as ended:
        main(["run", *map(str, captures), "--out", str(tmp_path), "--list"])
    assert ended.value.code == 2 and message in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_list_prints_the_runs_of_a_plan_and_runs_none(capsys, tmp_path):
    assert main(["run", str(SUZANNE_SMALL), "--plan", "views", "--views", "8", "all", "--list", "--out", str(tmp_path)]) == 0
    assert capsys.readouterr().out.split() == [
        f"{SUZANNE_SMALL.name}-preview-full-8_views-seed_0",
        f"{SUZANNE_SMALL.name}-preview-full-seed_0",
    ]
    assert not list(tmp_path.iterdir())


def test_only_runs_that_change_stage_2_alone_take_over_a_stage_1():
    def same(ablation):
        return Run(Path("box"), ablation=ablation, seed=3).same_stage_1

    assert same("no cones") == Run(Path("box"), ablation="full", seed=3)
    assert same("full") is None and same("environment at infinity") is None and same("no curvature") is None


def test_a_job_resumes_from_a_stage_1_that_was_taken_over(tmp_path):
    run, done = Run(SUZANNE_SMALL, "preview", "no cones", seed=3), {"seconds": 12.0, "result": {"steps": 7}}
    assert not take_stage_1(tmp_path / "other", tmp_path / "asset", SUZANNE_SMALL, run, None)
    (tmp_path / "other" / "checkpoints").mkdir(parents=True)
    for stage in STAGE_1:
        save_state(tmp_path / "other" / "checkpoints" / f"{stage}.done.pt", done)
    for donor, taken in ((Run(SUZANNE_SMALL, "preview", seed=4), False), (Run(SUZANNE_SMALL, "preview", seed=3), True)):
        made = fingerprint(load_capture(SUZANNE_SMALL), donor.changed_preset, donor.seed, False, None)
        write_row(tmp_path / "other" / "report.json", {"fingerprint": made})
        assert take_stage_1(tmp_path / "other", tmp_path / "asset", SUZANNE_SMALL, run, None) == taken
    folder = RunFolder(tmp_path / "asset", StopRequest(), print)
    assert folder.can_be_resumed(fingerprint(load_capture(SUZANNE_SMALL), run.changed_preset, 3, False, None))
    assert folder.load_result("fields_learning") == ({"steps": 7}, 12.0) and folder.load_result("material_learning") is None


@pytest.mark.parametrize(
    ("learned", "now", "taken"),
    [
        ("aaaaaaaa", "aaaaaaaa", True),
        ("aaaaaaaa", "bbbbbbbb", False),
        ("aaaaaaaa", "aaaaaaaa-dirty", False),
        ("aaaaaaaa-dirty", "aaaaaaaa-dirty", False),
        ("", "", False),
        (None, "aaaaaaaa", False),
    ],
)
def test_a_stage_1_of_other_code_is_not_taken_over(learned, now, taken, tmp_path, monkeypatch):
    """The row of the donor says with which commit it has learned. An older row does not."""
    run, orders = Run(SUZANNE_SMALL, "preview", "no cones"), []

    class Recorder(Children):
        def run(self, command, log, threads, limit):
            orders.append(read_row(Path(command[-2])))
            write_row(Path(command[-1]), {"resumed_stages": ["fields_learning"] if orders[-1]["stage_1"] else []})
            return Ended(0, 1.0, 1.0, 1.0, False)

    monkeypatch.setattr(runner, "commit_now", lambda: now)
    row = {"learn": {}} | ({} if learned is None else {"commits": {"learn": learned}})
    write_row(tmp_path / "rows" / f"{run.same_stage_1.name}.json", row)
    (tmp_path / "logs").mkdir()
    found = Suite(tmp_path, children=Recorder()).run_step("learn", run, tmp_path / "asset")
    donor = str(tmp_path / "assets" / run.same_stage_1.name)
    assert orders[0]["stage_1"] == (donor if taken else None) and ("stage_1_of" in found) == taken


def test_a_changed_preset_has_the_image_size_and_the_ablation():
    changed = Run(Path("box"), "quality", "N = 1", pixels=1234).changed_preset
    assert changed.max_pixels_per_photo == 1234 and changed.material.levels == 1
    assert changed.fields == preset("quality").fields and not changed.skip_needless


def test_a_step_is_done_once_and_a_failed_run_is_a_row(tmp_path):
    runs = [Run(SUZANNE_SMALL, "preview", seed=seed) for seed in (0, 1)]
    suite = FakeSuite(tmp_path)
    assert suite.run_all(runs, 2) == 1
    rows = {run.seed: read_row(tmp_path / "rows" / f"{run.name}.json") for run in runs}
    assert failure(rows[1]) == "learn: no surface was found" and "score" not in rows[1] and not failure(rows[0])
    assert rows[0]["run"]["capture"] == SUZANNE_SMALL.name and rows[0]["machine"]["threads"] == 1
    again = FakeSuite(tmp_path, relight=True)
    again.run_all(runs, 1)
    assert again.done == [("relight", runs[0].name)]
    retried = FakeSuite(tmp_path, retry=True)
    retried.run_all(runs, 1)
    assert retried.done == [("learn", runs[1].name)]


@pytest.mark.parametrize("changed", ["capture", "preset"])
def test_a_row_of_another_capture_or_preset_is_refused_or_redone(changed, tmp_path):
    runs = [Run(SUZANNE_SMALL, "preview", seed=seed) for seed in (2, 3)]
    FakeSuite(tmp_path, relight=True).run_all(runs[1:], 1)
    before = read_row(tmp_path / "rows" / f"{runs[1].name}.json")
    other = FakeSuite(tmp_path, relight=True)
    assert before["made_from"] == other.now
    other.now = other.now | {changed: "c3"}
    with pytest.raises(OtherRowsError, match=f"{runs[1].name} in .* another {changed}. Give another --out, or --retry"):
        other.run_all(runs, 1)
    assert not other.done and read_row(tmp_path / "rows" / f"{runs[1].name}.json") == before
    other.retry = True
    assert other.run_all(runs, 1) == 0
    assert other.done == [(step, run.name) for run in runs for step in ("learn", "score", "relight")]
    assert read_row(tmp_path / "rows" / f"{runs[1].name}.json")["made_from"] == other.now


def test_each_step_has_its_own_commit(tmp_path, monkeypatch):
    run, commits = Run(SUZANNE_SMALL, "preview"), {}
    for commit, relight in (("aaaaaaaa", False), ("bbbbbbbb", True)):
        monkeypatch.setattr(runner, "commit_now", lambda commit=commit: commit)
        FakeSuite(tmp_path, relight=relight).run_all([run], 1)
        commits[commit] = read_row(tmp_path / "rows" / f"{run.name}.json")["commits"]
    assert commits["aaaaaaaa"] == {"learn": "aaaaaaaa", "score": "aaaaaaaa"}
    assert commits["bbbbbbbb"] == commits["aaaaaaaa"] | {"relight": "bbbbbbbb"}


def test_a_row_that_does_not_say_its_origin_is_taken_as_it_is(tmp_path):
    run = Run(SUZANNE_SMALL, "preview")
    older = {"run": run.as_row(), "machine": {}, "learn": {"figure": 2.0}, "score": {"figure": 3.0}}
    write_row(tmp_path / "rows" / f"{run.name}.json", older)
    suite = FakeSuite(tmp_path)
    suite.run_all([run], 1)
    assert not suite.done and read_row(tmp_path / "rows" / f"{run.name}.json") == older


@pytest.mark.slow
def test_the_command_tells_of_a_row_of_a_rerendered_capture(tmp_path, capsys):
    runs = [Run(SUZANNE_SMALL, "preview"), Run(SUZANNE_SMALL, "preview", "no cones")]
    found = Suite(tmp_path).identify([*runs, Run(tmp_path / "nothing")])
    assert found[runs[0].name]["capture"] == found[runs[1].name]["capture"], "one capture"
    assert found[runs[0].name]["preset"] != found[runs[1].name]["preset"], "the ablation changes the preset"
    assert found[Run(tmp_path / "nothing").name] == {}
    row = {"run": runs[0].as_row(), "made_from": found[runs[0].name], "learn": {}, "score": {}}
    write_row(tmp_path / "rows" / f"{runs[0].name}.json", row)
    again = tmp_path / "again" / SUZANNE_SMALL.name
    shutil.copytree(SUZANNE_SMALL, again)
    photo = min((again / "images").iterdir())
    photo.write_bytes(photo.read_bytes() + b"\0")
    command = ["run", "--preset", "preview", "--ablation", "full", "--out", str(tmp_path)]
    assert main([*command, str(SUZANNE_SMALL)]) == 0
    assert main([*command, str(again)]) == 2
    assert "was made from another capture. Give another --out, or --retry" in capsys.readouterr().err


def test_two_runners_do_not_do_the_same_run(tmp_path):
    class Slow(FakeSuite):
        def run_step(self, step, run, asset):
            time.sleep(0.3)
            return super().run_step(step, run, asset)

    both = [Slow(tmp_path), Slow(tmp_path)]
    threads = [threading.Thread(target=one.run, args=(Run(SUZANNE_SMALL),)) for one in both]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert sorted(len(one.done) for one in both) == [0, 2]


def test_a_run_that_takes_over_a_stage_1_waits_for_it(tmp_path):
    class Slow(FakeSuite):
        def run_step(self, step, run, asset):
            if run.ablation == "full":
                time.sleep(0.3)
            return super().run_step(step, run, asset)

    suite = Slow(tmp_path)
    full, other = Run(SUZANNE_SMALL), Run(SUZANNE_SMALL, ablation="no cones")
    suite.run_all([full, other], 2)
    assert suite.done == [(step, run.name) for run in (full, other) for step in ("learn", "score")]


@pytest.mark.parametrize(
    ("commit", "runs"),
    [("aaaaaaaa", {"full", "without hull"}), ("aaaaaaaa-dirty", {"full", "without hull", "without relief"})],
)
def test_what_does_not_act_is_not_left_out(commit, runs, tmp_path, monkeypatch, capsys):
    """The hull acts and the relief does not. Code that no commit holds may be any code, so all of its runs are run."""

    class Acting(FakeSuite):
        def run_step(self, step, run, asset):
            acted = {"hull": {"acted": [0.0]}, "relief": {"skipped": "the photos are too coarse"}}
            return super().run_step(step, run, asset) | {"refinements": acted}

    names = without_each("fields", ("hull", "relief"))
    for name, changes in names.items():
        monkeypatch.setitem(ABLATIONS, name, changes)
    monkeypatch.setattr(runner, "commit_now", lambda: commit)
    suite = Acting(tmp_path)
    assert suite.run_all(expand([], [SUZANNE_SMALL], {"ablation": ("full", *names)}), 1) == 0
    assert {name.split("-")[2].replace("_", " ") for _, name in suite.done} == runs
    assert ("without_relief-seed_0: not run" in capsys.readouterr().err) == ("without relief" not in runs)


@pytest.mark.slow
def test_a_step_that_crashes_or_hangs_is_an_error(tmp_path):
    children, log = Children(), tmp_path / "log"
    dead = children.run([sys.executable, "-c", "import os; os.abort()"], log, 1, 60)
    assert dead.code == -6 and not dead.timed_out
    hung = children.run([sys.executable, "-c", "import time; time.sleep(60)"], log, 1, 0.5)
    assert hung.timed_out and hung.code == -9 and hung.cpu_seconds < 5
    threading.Timer(0.5, lambda: setattr(children, "stopped", True)).start()
    stopped = children.run([sys.executable, "-c", "import time; time.sleep(60)"], log, 1, 60)
    assert stopped.code == -9 and not stopped.timed_out
    children.stopped = False
    missing = Suite(tmp_path).run(Run(tmp_path / "nothing", "preview"))
    assert "there is no folder" in failure(missing) and str(tmp_path) not in failure(missing)


def test_a_step_runs_nothing_from_the_current_folder(tmp_path, monkeypatch):
    """It may hold files of strangers. A suite whose folder is named by a relative path finds it all the same."""
    sprung = set_traps(tmp_path / "stranger")
    monkeypatch.chdir(sprung.parent)
    write_row(tmp_path / "order", {})
    ended = Children().run(
        command_of("benchmarks.suite.identity", tmp_path / "order", tmp_path / "result"), tmp_path / "log", 1, 60
    )
    assert ended.code == 0 and (tmp_path / "result").is_file(), (tmp_path / "log").read_text()
    assert not sprung.exists()
    where = [sys.executable, "-c", "import os; print(os.getcwd())"]
    Children().run(where, tmp_path / "where", 1, 60)
    assert (tmp_path / "where").read_text().strip() == os.path.abspath(os.sep)
    assert Suite(Path("out")).out == tmp_path / "stranger" / "out"


def test_memory_and_cpu_seconds_are_those_of_the_step_alone(tmp_path):
    # The steps are started from a process as small as the runner, because Linux counts that process's memory too.
    code = (
        "import sys; from pathlib import Path; from benchmarks.suite.harness import Children\n"
        "def used(code):\n"
        "    ended = Children().run([sys.executable, '-c', code], Path(sys.argv[1]), 1, 60)\n"
        "    return f'{ended.peak_mb} {ended.cpu_seconds}'\n"
        "work = 'sum(range(20_000_000)); import resource as r; own = r.getrusage(r.RUSAGE_SELF)'\n"
        "print(used('bytearray(b\"1\") * 300_000_000'), used(work + '; print(own.ru_utime + own.ru_stime)'))"
    )
    run = subprocess.run(
        [sys.executable, "-c", code, tmp_path / "log"],
        capture_output=True,
        text=True,
        check=True,
        cwd=SUZANNE_SMALL.parent.parent,
    )
    eater, _, worker, worker_seconds = map(float, run.stdout.split())
    assert 280 < eater < 400 and worker < 100
    said = float((tmp_path / "log").read_text().split()[-1])  # by the step itself, just before its end
    assert said > 0.1 and said <= worker_seconds < 1.2 * said + 0.1


def test_fewer_views_are_spread_and_are_the_beginning_of_more():
    turn = np.linspace(0, 2 * np.pi, 64, endpoint=False)
    circle = np.stack([np.cos(turn), np.sin(turn), 0 * turn], 1)
    four = spread(circle, 4)
    assert sorted(four) == [0, 16, 32, 48] and spread(circle, 8)[:4] == four
    assert len(spread(circle, 100)) == 64


def test_a_capture_with_fewer_views_is_of_the_same_object(tmp_path):
    whole, few = load_capture(SUZANNE_SMALL), load_capture(with_fewer_views(SUZANNE_SMALL, 8, tmp_path / "few"))
    assert len(few.views) == 8 and few.object_radius == whole.object_radius
    places = {tuple(view.camera.position): view.image_path.resolve() for view in whole.views}
    assert all(places[tuple(view.camera.position)] == view.image_path.resolve() for view in few.views)
    assert (
        fingerprint(few, preset("preview"), 0, False, None)["capture"]
        != fingerprint(whole, preset("preview"), 0, False, None)["capture"]
    )
    assert str(SUZANNE_SMALL) not in json.dumps((tmp_path / "few" / "transforms.json").read_text())


def test_a_capture_with_fewer_views_follows_a_rerendered_source(tmp_path):
    source, few = tmp_path / "source", tmp_path / "few"
    shutil.copytree(SUZANNE_SMALL, source)
    made = (with_fewer_views(source, 4, few) / "transforms.json").read_text()
    before = (few / "transforms.json").stat().st_mtime_ns
    assert (with_fewer_views(source, 4, few) / "transforms.json").stat().st_mtime_ns == before, "it is not made twice"
    meta = json.loads((source / "transforms.json").read_text())
    meta["frames"] = meta["frames"][::-1]
    (source / "transforms.json").write_text(json.dumps(meta))
    other = json.loads((with_fewer_views(source, 4, few) / "transforms.json").read_text())
    assert other["frames"] != json.loads(made)["frames"] and all(frame in meta["frames"] for frame in other["frames"])
    elsewhere = tmp_path / "elsewhere" / "source"
    shutil.copytree(source, elsewhere)
    with_fewer_views(elsewhere, 4, few)
    assert (few / "images").resolve() == elsewhere / "images"


@pytest.mark.slow
def test_without_f_e_in_stage_2_the_mesh_is_the_same(tmp_path, monkeypatch):
    from benchmarks.scoring.materials import read_materials
    from benchmarks.stress.scenes import Case, tiny_preset, write_capture

    monkeypatch.setitem(PRESETS, "preview", tiny_preset())
    monkeypatch.setattr(StopRequest, "watch", lambda self: None)  # a test has no standard input to watch
    write_capture(Case(), tmp_path / "ball")
    whole, other = tmp_path / "whole", tmp_path / "other"
    order = {"settings": {"device": "cpu", "threads": 1}}
    made = learn(Run(tmp_path / "ball", "preview"), whole, order)
    assert not made["resumed_stages"] and {"fields_learning", "surface"} < set(made["stage_cpu_seconds"])
    taken = learn(Run(tmp_path / "ball", "preview", WITHOUT_F_E), other, order | {"stage_1": str(whole)})
    assert sorted(taken["resumed_stages"]) == sorted(STAGE_1) and "fields_learning" not in taken["stage_cpu_seconds"]
    assert (whole / "mesh.obj").read_bytes() == (other / "mesh.obj").read_bytes()
    one, two = (read_materials(asset) for asset in (whole, other))
    assert np.abs(one.albedo - two.albedo).mean() > 1e-3, "the ablation has changed nothing"


def test_without_f_e_all_light_is_unseen_light_that_begins_black():
    light = UnseenLight.expected_beside(NoLight(5.0), 8)
    assert light.radius == 5.0 and (light.missing == 1).all() and not light.expected.any()
