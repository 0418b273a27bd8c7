"""A batch replaces and removes only files that a mark shows to be ours, and only in its own folder."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest

from blender_nep.batch.captures import find_captures


def contents(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def put(path: Path, content: str = "mine") -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(content)
    return path


@pytest.mark.parametrize("overwrite", [False, True])
@pytest.mark.parametrize("file", ["checkpoints/last.pt", "checkpoints/epoch_1/weights", "preview.png", "job/stop"])
def test_a_foreign_folder_fails_its_object_and_is_left_alone(batch, file, overwrite):
    batch.add("a")
    batch.add("b")
    put(batch.out / "a" / file)
    before = contents(batch.out / "a")
    assert batch.run(overwrite=overwrite)[0] == 9 and contents(batch.out / "a") == before
    found = batch.objects()
    assert found["a"]["error"]["name"] in ("usage.unknown_run", "usage.not_ours") and found["a"]["attempts"] == 0
    assert found["b"]["state"] == "done"


def test_a_job_that_refuses_unknown_checkpoints_keeps_them(batch):
    batch.add("a")
    run = {"format": 1, "capture": "", "preset": "", "seed": 0, "refused": "usage.unknown_run"}
    put(batch.out / "a/checkpoints/run.json", json.dumps(run))
    put(batch.out / "a/checkpoints/surface.done.pt")
    assert batch.run()[0] == 9 and (batch.out / "a/checkpoints/surface.done.pt").read_text() == "mine"


def test_foreign_files_beside_ours_outlive_an_overwrite(batch):
    batch.add("a")
    assert batch.run()[0] == 0
    kept = [put(batch.out / "a" / name) for name in ("checkpoints/epoch.pt", "capture/images/0.png", "notes.md")]
    assert batch.run(overwrite=True)[0] == 0 and all(path.read_text() == "mine" for path in kept)
    assert len(batch.steps("a")) == 8, "the object was made anew"


@pytest.mark.parametrize("overwrite", [False, True])
def test_a_foreign_capture_in_the_objects_folder_stays(batch, overwrite):
    photos = batch.add("shots")
    (photos / "transforms.json").unlink()
    cameras, photo = batch.out / "shots/capture/transforms.json", batch.out / "shots/capture/images/0.png"
    put(photo)
    os.utime(put(cameras, "{}"), (1, 1))
    assert batch.run(overwrite=overwrite)[0] == 9
    assert cameras.read_text() == "{}" and photo.read_text() == "mine"
    assert batch.objects()["shots"]["error"]["name"] == "usage.not_ours"


@pytest.mark.parametrize("overwrite", [False, True])
@pytest.mark.parametrize("file", ["log.txt", "index.html", "batch.json", "batch.stop", "gallery/LICENSES.txt", "batch.lock"])
def test_a_folder_with_foreign_files_is_no_folder_for_a_batch(batch, file, overwrite):
    batch.add("a")
    put(batch.out / file, '{"mine": 1}')
    before = contents(batch.out)
    code, events = batch.run(overwrite=overwrite)
    assert code == 2 and events[-1]["name"] == "usage.not_ours" and contents(batch.out) == before


def test_the_folder_of_the_captures_is_refused(batch):
    capture = batch.add("a")
    before = contents(batch.captures)
    for out in (batch.captures, capture):
        batch.out = out
        code, events = batch.run(captures=[capture])
        assert code == 2 and events[-1]["name"] == "usage.output_is_capture"
    assert contents(batch.captures) == before
    batch.out = batch.captures / "shelf"
    assert batch.run()[0] == 0, "a folder of its own among the captures is none"


def test_an_object_whose_folder_is_its_capture_fails(batch):
    """As a batch.json from elsewhere may say it."""
    capture = batch.add("a")
    assert batch.run()[0] == 0
    content = batch.content()
    content["objects"][0].update(state="waiting", name="a")
    (batch.captures / "batch.json").write_text(json.dumps(content))
    before = contents(capture)
    batch.out = batch.captures
    assert batch.run(captures=[], overwrite=True)[0] == 2 or batch.run(captures=[])[0] == 9
    assert contents(capture) == before


@pytest.mark.parametrize("name", ["../victim", "ABSOLUTE", "..", "", "a/b", "nul", "b"])
@pytest.mark.parametrize("options", [{}, {"overwrite": True}, {"captures": [], "overwrite": True}, {"captures": []}])
def test_names_that_lead_elsewhere_are_refused(batch, name, options):
    batch.add("a")
    batch.add("b")
    assert batch.run()[0] == 0
    victim = batch.out.parent / "victim"
    run = {"format": 1, "capture": "", "preset": "", "seed": 0}
    for file, content in (("checkpoints/run.json", run), ("checkpoints/surface.done.pt", 0), ("report.json", {})):
        put(victim / file, json.dumps(content))
    before, content = contents(victim), batch.content()
    content["objects"][0]["name"] = str(victim) if name == "ABSOLUTE" else name
    (batch.out / "batch.json").write_text(json.dumps(content))
    kept = contents(batch.out)
    code, events = batch.run(**options)
    assert contents(victim) == before
    if options == {"overwrite": True}:  # all captures are named, so a new state takes the place of that one
        assert code == 0 and list(batch.objects()) == ["a", "b"]
    else:
        assert code == 2 and events[-1]["name"] == "usage.object_name" and contents(batch.out) == kept


def test_assets_among_captures_are_not_read_as_photos(batch, make_capture):
    batch.add("a")
    asset = batch.captures / "a_asset"
    put(asset / "report.json", json.dumps({"fingerprint": {"format": 14}}))
    (asset / "preview.png").write_bytes((batch.captures / "a/images/000.png").read_bytes())
    assert [one.path.name for one in find_captures([batch.captures], batch.out)] == ["a"]
