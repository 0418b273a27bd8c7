"""A job replaces and removes only files that a mark shows to be ours."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from blender_nep.job.commands import correction
from blender_nep.job.folders import own_files
from blender_nep.job.reporting.events import Events
from blender_nep.stop_request import StopRequest
from support.ball_stages import BallStages

FOREIGN = {
    "a training": ("checkpoints/epoch_1/weights.safetensors", "checkpoints/notes.md"),
    "a training with a run.json": ("checkpoints/run.json", "checkpoints/last.pt"),
    "weights": ("checkpoints/last.pt",),
    "a file called checkpoints": ("checkpoints",),
    "a mesh": ("mesh.obj",),
    "textures": ("textures/albedo.png", "textures/wood.png"),
    "a picture": ("preview.png",),
    "cameras": ("cameras.json",),
    "a report": ("report.json", "profile.json"),
    "a log": ("log.txt",),
    "a .blend file": ("asset.blend",),
    "a folder called job": ("job/preview.png", "job/stop"),
    "a lock that is none": ("job/lock",),
    "a folder called .partial": (".partial/draft.txt",),
}
"""{what somebody has: files with the names that we write, but without our marks}"""
WAYS = [{}, {"resume": True}, {"overwrite": True}, {"overwrite": True, "job_files": True, "clean": True}]


def contents(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def put(folder: Path, *names: str, content: str = '{"mine": true}') -> dict[str, bytes]:
    for name in names:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(content)
    return contents(folder)


def begun(start) -> dict[str, bytes]:
    """A run of ours that was stopped, so that start.out holds its checkpoint."""
    start(BallStages(on_step=lambda r, s: stop.request("test")), stop := StopRequest())
    return contents(start.out)


@pytest.mark.parametrize("options", WAYS, ids=["plain", "resume", "overwrite", "all"])
@pytest.mark.parametrize("names", FOREIGN.values(), ids=FOREIGN)
def test_foreign_files_are_refused_and_left_alone(start, names, options):
    before = put(start.out, *names)
    code, events = start(stages := BallStages(), **options)
    assert code == 2 and not stages.entered and contents(start.out) == before
    assert events[-1]["name"] in ("usage.not_ours", "usage.unknown_run")
    assert "--out" in events[-1]["hint"] and str(start.out) in events[-1]["message"]


@pytest.mark.parametrize("options", WAYS, ids=["plain", "resume", "overwrite", "all"])
def test_files_with_other_names_stay(start, options):
    names = ("notes.txt", "textures/wood.png", "job/list.md", "images/000.png", "capture/transforms.json")
    before = put(start.out, *names)
    assert start(BallStages(), **options)[0] == 0
    assert before.items() <= contents(start.out).items()


@pytest.mark.parametrize("options", [{"overwrite": True}, {"resume": True}, {"resume": True, "clean": True}])
@pytest.mark.parametrize("finished", [False, True])
def test_foreign_files_in_a_folder_of_ours_stay(start, finished, options):
    if finished:
        assert start(BallStages())[0] == 0
    else:
        begun(start)
    names = ("checkpoints/best/weights.pt", "checkpoints/epoch.pt", ".partial/draft.txt", "textures/wood.png")
    put(start.out, *names)
    assert start(BallStages(), **options)[0] == 0
    assert all((start.out / name).read_text() == '{"mine": true}' for name in names)
    assert (start.out / "report.json").is_file() and not (start.out / "draft.txt").exists()
    if "clean" in options:
        assert {path.name for path in (start.out / "checkpoints").iterdir()} == {"best", "epoch.pt"}


def test_old_checkpoints_of_ours_are_removed(start):
    begun(start)
    put(start.out, "checkpoints/.surface.done.pt.77.tmp", "checkpoints/fields_learning.previous.pt")
    assert start(BallStages(), seed=5, overwrite=True, clean=True)[0] == 0
    assert not (start.out / "checkpoints").exists()
    assert start(BallStages(), overwrite=True)[0] == 0, "the report shows that the asset is ours"


def test_a_damaged_run_file_alone_is_no_mark(start):
    before = put(start.out, "checkpoints/run.json", content='{"format": 3')
    code, events = start(BallStages(), resume=True)
    assert code == 2 and events[-1]["name"] == "usage.unknown_run" and contents(start.out) == before


def test_a_folder_is_ours_at_each_moment_of_a_new_begin(start, monkeypatch):
    """A job that is killed while it removes the old run can be started again."""
    assert start(BallStages(), clean=True)[0] == 0
    seen = []

    def watch(name, function):
        def watched(*arguments, **options):
            seen.append((name, own_files.is_ours(start.out)))
            return function(*arguments, **options)

        return watched

    monkeypatch.setattr(Path, "unlink", watch("unlink", Path.unlink))
    monkeypatch.setattr(own_files, "write_text", watch("write", own_files.write_text))
    own_files.discard_run(start.out)
    assert [name for name, _ in seen].count("write") == 1 and len(seen) > 3 and all(ours for _, ours in seen)
    monkeypatch.undo()
    assert own_files.is_ours(start.out) and not (start.out / "report.json").exists()
    code, _ = start(stages := BallStages(), resume=True, seed=9)
    assert code == 0 and stages.started_at["fields_learning"] == 0


@pytest.mark.parametrize("where", [".", "images", "masks"])
@pytest.mark.parametrize("options", WAYS, ids=["plain", "resume", "overwrite", "all"])
def test_the_folder_of_the_photos_is_refused(start, where, options):
    before = contents(start.folder)
    code, events = start(stages := BallStages(), out=start.folder / where, **options)
    assert code == 2 and events[-1]["name"] == "usage.output_is_capture" and not stages.entered
    assert contents(start.folder) == before


def test_photos_that_lie_elsewhere_are_found_as_well(start):
    """The capture's file may name photos anywhere."""
    photos = start.folder.parent / "photos"
    (start.folder / "images").rename(photos)
    file = start.folder / "transforms.json"
    file.write_text(file.read_text().replace('"images/', '"../photos/'))
    before = contents(start.folder) | contents(photos)
    code, events = start(stages := BallStages(), out=photos, overwrite=True)
    assert code == 2 and events[-1]["name"] == "usage.output_is_capture" and not stages.entered
    assert contents(start.folder) | contents(photos) == before


def test_photos_in_a_folder_that_an_asset_has_are_refused(start):
    moved = start.folder.parent / "project" / "textures"
    shutil.copytree(start.folder, moved)
    before = contents(moved)
    code, events = start(BallStages(), capture=moved, out=moved.parent)
    assert code == 2 and events[-1]["name"] == "usage.output_is_capture" and contents(moved) == before


def test_a_mesh_that_the_asset_would_replace_is_refused(start):
    assert start(BallStages())[0] == 0
    before = contents(start.out)
    code, events = start(BallStages(), mesh=start.out / "mesh.obj", overwrite=True)
    assert code == 2 and events[-1]["name"] == "usage.output_is_capture" and contents(start.out) == before


@pytest.mark.parametrize("place", ["result", ".."])
def test_a_folder_in_or_around_the_capture_works(start, place):
    before = contents(start.folder)
    out = (start.folder / place).resolve()
    assert start(BallStages(), out=out)[0] == 0 and (out / "report.json").is_file()
    assert before.items() <= contents(start.folder).items()


def test_no_lock_is_made_in_a_folder_that_is_no_asset(tmp_path):
    put(tmp_path, "report.json")
    assert correction.run(tmp_path, {}, Events()) == 2
    assert list(contents(tmp_path)) == ["report.json"] and not (tmp_path / "job").exists()


def test_the_mark_of_older_versions_counts(tmp_path):
    put(tmp_path, "report.json", content=json.dumps({"fingerprint": {"format": 2}}))
    assert own_files.is_ours(tmp_path)
    own_files.refuse_foreign_files(tmp_path)
