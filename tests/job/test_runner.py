"""A job from the capture to the asset: stages in order, the report, errors. The stages know the answer (ball_stages)."""

from __future__ import annotations

import json
from dataclasses import replace
from types import SimpleNamespace

import numba
import numpy as np
import OpenEXR
import pytest
import torch

from backend.scene_io.capture_files import read_frames, with_exposures
from blender_nep import checkpoints
from blender_nep.capture import load_capture
from blender_nep.capture.exposure.surroundings import Exposures
from blender_nep.errors import LearningError
from blender_nep.job import preparation, runner
from blender_nep.job.stage_names import StageName
from blender_nep.job.stages import AssetStage
from blender_nep.messages import Message
from blender_nep.presets import preset
from blender_nep.shading.unseen_light import UnseenLight
from blender_nep.support.plane import Support
from support.ball_stages import WHY, BallStages, BallSurface

ONE_MATERIAL = WHY.state()


def test_a_job_ends_with_an_asset_and_tells_how_far_it_is(start):
    stages = BallStages(steps=4)
    code, events = start(stages)
    assert code == 0 and stages.entered == ["fields_learning", "surface", "material_learning"]
    assert events[-1] == {"event": "done", "asset": str(start.out)}
    progress = [e for e in events if e["event"] == "progress"]
    assert list(dict.fromkeys(e["stage"] for e in progress)) == list(StageName)
    fractions = [e["fraction"] for e in progress]
    assert fractions == sorted(fractions) and fractions[0] == 0 and fractions[-1] == 1
    assert all(e["eta_s"] >= 0 for e in progress) and progress[-1]["eta_s"] < 1
    assert {"step", "steps", "fraction", "eta_s", "loss"} <= set(progress[0])
    report = json.loads((start.out / "report.json").read_text())
    assert report["preset"] == "preview" and report["seed"] == 0 and report["capture"]["views"] == 6
    assert set(report["seconds"]) == set(StageName) and report["peak_memory_mb"] > 10
    # a build for CUDA calls itself 2.13.0+cu130, and its package 2.13.0
    assert report["versions"]["torch"].partition("+")[0] == torch.__version__.partition("+")[0]
    convex = {"code": "reason.convex", "values": {}, "message": "the object is convex"}
    assert report["skipped"] == {"votes of all pixels": {**ONE_MATERIAL, "message": str(WHY)}, "indirect light": convex}
    assert report["losses"]["fields_learning"] == pytest.approx(0.25)


def test_freed_memory_is_kept_before_the_first_stage(start, monkeypatch):
    class Asked(BallStages):
        def learn_fields(self, *arguments, **keywords):
            found.append(list(kept))
            return super().learn_fields(*arguments, **keywords)

    found, kept = [], []
    monkeypatch.setattr(runner, "keep_freed_memory", lambda: kept.append(True))
    assert start(Asked())[0] == 0 and found == [[True]]


def test_threads_are_those_that_were_asked_for(start):
    class Counting(BallStages):
        def learn_fields(self, *arguments, **keywords):
            found.append((torch.get_num_threads(), numba.get_num_threads()))
            return super().learn_fields(*arguments, **keywords)

    found, before = [], (torch.get_num_threads(), numba.get_num_threads())
    try:
        for threads in (1, 2):
            assert start(Counting(), threads=threads, overwrite=True)[0] == 0
        most = numba.config.NUMBA_NUM_THREADS
        assert found == [(1, 1), (2, min(2, most))]
    finally:
        torch.set_num_threads(before[0])
        numba.set_num_threads(before[1])


def test_what_the_scene_needs_is_told_first_and_in_the_report(start):
    class Asked(BallStages):
        def learn_fields(self, *arguments, **keywords):
            found = super().learn_fields(*arguments, **keywords)
            found.report |= {"steps": 60, "of_steps": 90}
            return found

        def learn_materials(self, given, *how):
            asked.append(given.preset.levels)
            found = super().learn_materials(given, *how)
            found.report |= {
                "skipped": dict.fromkeys(("material boundaries", "fine textures"), ONE_MATERIAL),
                "seconds_saved": {"fine textures": 3.14159},
            }
            return found

    asked: list[int] = []
    _, events = start(Asked())
    names = [e["event"] if e["event"] != "progress" else e["stage"] for e in events]
    told = [[line["message"] for line in e["lines"]] for e in events if e["event"] == "scene"]
    assert names.index("scene") < names.index("fields_learning") and len(told) == 5, told
    assert "Masks are there and are used." in told[0]
    left_out = "Left out: reflections of the object in itself, because the object is convex."
    assert left_out in told[2] and left_out not in told[1]
    assert any(line.startswith("Left out: the rest of learning") for line in told[1])
    last = events[max(n for n, e in enumerate(events) if e["event"] == "scene")]["lines"][-1]
    assert told[-1][-1] == last["message"]
    assert last["message"] == (
        "Left out: finding the material of every pixel, boundaries between materials, fine textures, because one material "
        "explains the photos (saves about 3 s)."
    )
    assert last["code"] == "scene.left_out_saving" and last["values"]["reason"]["code"] == "reason.one_material"
    assert last["values"]["parts"] == ["votes of all pixels", "material boundaries", "fine textures"]
    report = json.loads((start.out / "report.json").read_text())
    assert report["scene"]["photos"]["masks"] and report["scene"]["surface"]["self_visibility"] == 0
    assert [line["message"] for line in report["scene"]["sentences"]] == [*told[0][:4], "The object is convex."]
    assert report["skipped_seconds"] == {
        "fine textures": 3.14,
        "further steps of both fields": pytest.approx(report["seconds"]["fields_learning"] / 2, abs=0.02),
    }
    assert "seconds_saved" not in report["stages"]["material_learning"]
    start(Asked(), overwrite=True, preset=replace(preset("preview"), skip_needless=False))
    assert asked == [0, preset("preview").material.levels]


@pytest.mark.parametrize("even", [True, False])
def test_the_report_says_how_exposures_were_evened_out(start, monkeypatch, even):
    class Looked(BallStages):
        def learn_fields(self, given, *how):
            seen.append(given.scene.rays.gain)
            return super().learn_fields(given, *how)

    seen: list[torch.Tensor | None] = []
    guessed = Message("capture.exposure_guessed", {"count": 2})
    gain = torch.tensor([2.0, 0.5, 1, 1, 1, 1])[:, None].expand(6, 3)
    compared = SimpleNamespace(exposures=lambda device: Exposures(gain, guessed))
    monkeypatch.setattr(preparation, "compare_exposures", lambda rays: compared)
    monkeypatch.setattr(preparation, "other_light", lambda compared, times: ())
    start(Looked(), preset=replace(preset("preview"), even_exposure=even))
    report = json.loads((start.out / "report.json").read_text())
    evened = {"code": "scene.exposure_differs", "values": {"stops": 2.0}}
    said = evened | {"message": str(Message(**evened))} in report["scene"]["sentences"]
    assert (seen[0] is not None) == said == ("photo_gains" in report["capture"]) == even
    warned = [warning["code"] for warning in report["warnings"] if warning["code"].startswith("capture.")]
    assert warned == (["capture.exposure_guessed"] if even else [])
    if even:
        frames = with_exposures(read_frames(start.folder), start.out)
        assert [frame.gain for frame in frames] == [tuple(g) for g in gain.tolist()]
        assert with_exposures(frames[:3], start.out) == frames[:3], "made from other photos"
    assert all(frame.gain == (1, 1, 1) for frame in with_exposures(read_frames(start.folder), start.folder))


def test_photos_in_another_light_are_left_out(start, monkeypatch):
    class Looked(BallStages):
        def learn_fields(self, given, *how):
            seen.append(given.scene.rays.views)
            return super().learn_fields(given, *how)

    seen: list[int] = []
    compared = SimpleNamespace(exposures=lambda device: Exposures(None))
    monkeypatch.setattr(preparation, "compare_exposures", lambda rays: compared)
    monkeypatch.setattr(preparation, "other_light", lambda compared, times: (0, 4))
    start(Looked())
    report = json.loads((start.out / "report.json").read_text())
    names = [load_capture(start.folder).views[i].name for i in (0, 4)]
    assert report["warnings"][0]["values"] == {"count": 2, "names": names}
    frames = read_frames(start.folder)
    assert with_exposures(frames, start.out) == [frame for i, frame in enumerate(frames) if i not in (0, 4)]
    start(Looked(), all_photos=True, overwrite=True)
    assert seen == [4, 6]


def test_masks_ignored_are_reported_as_skipped(start):
    start(BallStages(), use_masks=False)
    report = json.loads((start.out / "report.json").read_text())
    assert report["skipped"]["mask term"]["code"] == "reason.masks_ignored"


@pytest.mark.parametrize("finder", ["fields", "mesh"])
def test_a_plane_that_a_stage_finds_is_in_the_later_scenes(start, finder):
    plane, seen = Support(np.array([0.0, 0.0, 1.0]), -0.4), {}

    class Found(BallStages):
        def learn_fields(self, given, *how):
            seen["fields"] = given.scene.support
            fields = super().learn_fields(given, *how)
            fields.support = plane if finder == "fields" else None
            return fields

        def learn_materials(self, given, *how):
            seen["materials"] = given.scene.support
            return super().learn_materials(given, *how)

    class InMesh(BallSurface):
        def run(self, given, *how):
            seen["mesh"] = given.scene.support
            return replace(super().run(given, *how), support=plane if finder == "mesh" else None)

    class Asset(AssetStage):
        def run(self, given):
            seen["asset"] = given.scene.support
            super().run(given)

    stages = Found()
    stages.surface, stages.asset = InMesh(stages), Asset()
    assert start(stages)[0] == 0
    assert seen == {"fields": None, "mesh": plane if finder == "fields" else None, "materials": plane, "asset": plane}


@pytest.mark.parametrize("coverage", [1.0, 0.5, 0.0])
def test_the_light_that_no_photo_shows_is_in_the_environment_map(start, coverage):
    class Lit(BallStages):
        def learn_fields(self, *arguments, **keywords):
            fields = super().learn_fields(*arguments, **keywords)
            fields.environment.coverage = coverage
            return fields

        def learn_materials(self, *arguments, **keywords):
            materials = super().learn_materials(*arguments, **keywords)
            materials.unseen = UnseenLight.uniform(8, 4.0, "cpu", 2.0)
            return materials

    assert start(Lit())[0] == 0
    light = OpenEXR.File(str(start.out / "environment.exr")).channels()["RGB"].pixels
    exposure = json.loads((start.out / "report.json").read_text())["capture"]["exposure"]
    assert abs(exposure - 1) > 0.01, "otherwise a map that is not as bright as the photos would pass"
    assert np.allclose(light * exposure, 0.5 + 2.0 * (1 - coverage), rtol=1e-3)


def test_clean_removes_checkpoints(start):
    assert start(BallStages(), clean=True)[0] == 0
    assert not (start.out / "checkpoints").exists() and (start.out / "report.json").exists()


def test_an_asset_is_not_overwritten_by_accident(start):
    assert start(BallStages())[0] == 0
    before = (start.out / "report.json").stat().st_mtime_ns
    code, events = start(BallStages())
    assert code == 2 and "already holds an asset" in events[-1]["message"] and "--overwrite" in events[-1]["hint"]
    assert (start.out / "report.json").stat().st_mtime_ns == before
    assert start(BallStages(), overwrite=True)[0] == 0
    assert (start.out / "report.json").stat().st_mtime_ns > before


@pytest.mark.parametrize(("margin", "told"), [(0.01, True), (-0.02, True), (0.2, False), (None, False)])
def test_doubt_about_metal_is_told(start, margin, told):
    class Doubtful(BallStages):
        def learn_materials(self, *arguments, **keywords):
            found = super().learn_materials(*arguments, **keywords)
            found.report["metal_or_not_margin"] = margin
            return found

    code, events = start(Doubtful())
    assert code == 0 and ("job.metal_unclear" in [e["code"] for e in events if e["event"] == "warning"]) == told


@pytest.mark.parametrize(("share", "told"), [(0.03, True), (0.002, False)])
def test_a_cut_at_the_sphere_is_told(start, share, told):
    class Cut(BallSurface):
        def run(self, *arguments):
            found = super().run(*arguments)
            return replace(found, report=found.report | {"cut_by_sphere": share})

    stages = BallStages()
    stages.surface = Cut(stages)
    code, events = start(stages)
    said = {e["code"]: e["values"] for e in events if e["event"] == "warning"}
    assert code == 0 and said.get("job.cut_by_sphere") == ({"percent": 3.0} if told else None)


def test_errors_have_one_message_and_their_traceback_in_the_log(start):
    code, events = start(BallStages(fail=LearningError("no surface was found", "Use masks.")))
    assert code == 6 and events[-1] == {
        "event": "error",
        "code": 6,
        "name": "learning",
        "values": {},
        "message": "no surface was found",
        "hint": "Use masks.",
    }
    code, events = start(BallStages(fail=ZeroDivisionError("division by zero")), overwrite=True)
    assert code == 1 and events[-1]["message"] == "unexpected ZeroDivisionError: division by zero"
    assert "Traceback" in (start.out / "log.txt").read_text() and "Traceback" not in json.dumps(events)
    code, events = start(BallStages(fail=MemoryError()), overwrite=True)
    assert code == 1 and events[-1]["name"] == "unexpected.no_memory"
    assert not (start.out / "report.json").exists()


def test_a_full_disk_is_said(start, monkeypatch):
    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(checkpoints.torch, "save", full)
    code, events = start(BallStages())
    assert code == 5 and "disk is full" in events[-1]["message"]
    checkpoint = str(start.out / "checkpoints" / "fields_learning.done.pt")
    assert events[-1]["name"] == "output.disk_full" and events[-1]["values"] == {"path": checkpoint}
    assert not (start.out / "report.json").exists()
