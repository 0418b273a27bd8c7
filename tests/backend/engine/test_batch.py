"""What Blender's side reads of a batch, and how it starts and stops one."""

import json

import pytest

from backend.engine import words
from backend.engine.commands.batch_process import BatchProcess
from backend.engine.commands.gallery_process import GalleryProcess
from backend.engine.results import asset_description, batch_file
from backend.engine.results.batch_file import is_batch_running, read_batch
from blender_nep.batch import runner, state
from support import shelf_engine
from support.batch_folder import write_batch
from support.waiting import wait_until


def test_names_are_those_of_the_library():
    assert (batch_file.FILE, batch_file.FORMAT) == (state.FILE, state.FORMAT)
    assert (batch_file.LOCK, batch_file.STOP_FILE) == (runner._LOCK, runner._STOP)
    assert batch_file.STATES == (state.WAITING, state.RUNNING, state.DONE, state.FAILED, state.STOPPED)


def test_a_batch_is_read(tmp_path):
    error = {"name": "capture", "code": 3, "values": {"n": 1}, "message": "no photos", "hint": "Take some."}
    objects = [
        {"name": "vase", "capture": "/c/vase"},
        {"name": "cup", "capture": "/c/cup", "photos_alone": True, "state": "running", "fraction": 0.5, "stage": "surface"},
        {"name": "bowl", "capture": "/c/bowl", "state": "failed", "fraction": 0.1, "error": error},
    ]
    batch = read_batch(write_batch(tmp_path / "shelf", objects))
    vase, cup, bowl = batch.objects
    assert batch.done == [vase] and vase.folder == tmp_path / "shelf" / "vase" and str(vase.capture) == "/c/vase"
    assert cup.capture == tmp_path / "shelf" / "cup" / "capture" and cup.fraction == 0.5
    assert (bowl.message, bowl.hint, bowl.error, bowl.values) == ("no photos", "Take some.", "capture", {"n": 1})
    assert batch.fraction == pytest.approx(2.5 / 3) and batch.count("done", "failed") == 2
    assert not is_batch_running(tmp_path / "shelf")


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (None, "no batch in"),
        ("{", "is damaged"),
        ("[]", "is damaged"),
        ('{"format": 2, "objects": []}', "another version"),
        ('{"format": 1, "objects": [{"name": "../up", "capture": "", "state": "done"}]}', "is damaged"),
        ('{"format": 1, "objects": [{"name": "a", "capture": "", "state": "new"}]}', "is damaged"),
    ],
)
def test_a_broken_batch_is_refused_with_what_to_do(tmp_path, content, message):
    if content is not None:
        (tmp_path / "batch.json").write_text(content)
    with pytest.raises(ValueError, match=message) as refused:
        read_batch(tmp_path)
    assert str(tmp_path) in str(refused.value) and ". " in str(refused.value)


def follow(process) -> None:
    wait_until(process.poll)


def test_a_batch_runs_stops_and_goes_on(asset, tmp_path):
    python, out = shelf_engine.make(tmp_path), tmp_path / "shelf"
    (tmp_path / "mode").write_text("slow")
    process = BatchProcess(python, [tmp_path / "a", tmp_path / "b"], out, preset="preview", workers=2)
    wait_until(lambda: (out / "batch.json").is_file() and read_batch(out).objects[-1].state == "running")
    assert not process.poll() and is_batch_running(out)
    assert "Reconstructing the objects" in process.progress.lines() and "about 1 min 20 s left" in process.progress.lines()
    process.stop()
    follow(process)
    assert process.failed.code == 7 and "Reconstruct Shelf goes on" in process.failed.words()[1]
    assert not is_batch_running(out)
    given = json.loads((tmp_path / "arguments.json").read_text())
    assert given[:2] == [str(tmp_path / "a"), str(tmp_path / "b")] and "--watch-stdin" in given
    assert given[given.index("--workers") + 1] == "2" and given[given.index("--preset") + 1] == "preview"
    (tmp_path / "go").touch()
    process = BatchProcess(python, [], out)
    follow(process)
    assert process.failed is None and len(read_batch(out).done) == 2


def test_an_engine_that_died_or_knows_no_batches_is_reported(tmp_path):
    python = shelf_engine.make(tmp_path)
    for mode, code, message in (("crash", 137, "was killed"), ("old", 2, "knows no batches")):
        (tmp_path / "mode").write_text(mode)
        process = BatchProcess(python, [tmp_path / "a"], tmp_path / "shelf")
        follow(process)
        assert process.failed.code == code and message in process.failed.message
    gallery = GalleryProcess(python, tmp_path)
    follow(gallery)
    assert "writes no gallery" in gallery.failed.message
    assert set(words.BATCH_HINTS.values()) <= set(words.texts())


def test_hints_of_a_failed_object_do_not_speak_of_a_single_job():
    told = words.error_words("output.disk_full", {"path": "/out"}, "m", "h", hints=words.BATCH_HINTS)
    assert "Reconstruct Shelf" in told[1] and "Resume" not in told[1]
    told = words.error_words(
        "unexpected.job_killed", {"signal": "SIGKILL"}, "m", "try fewer --workers", hints=words.BATCH_HINTS
    )
    assert told[0] == "The job was ended by SIGKILL" and "--" not in told[1]


def test_an_asset_is_described_by_what_its_surface_is(tmp_path):
    learned = {"roughness": 0.3, "metallic": 0.0}
    materials = [
        {"share": 0.1, "albedo": [1, 1, 1], "roughness": 0.9, "metallic": 0.0, "learned": learned},
        {"share": 0.9, "albedo": [1, 1, 1], "roughness": 0.1, "metallic": 1.0, "learned": learned},
    ]
    report = {"preset": "balanced", "capture": {"views": 60}, "materials": materials}
    (tmp_path / "report.json").write_text(json.dumps(report))
    text, tags = asset_description.describe_asset(tmp_path)
    assert tags == ["metal", "mirror-like"] and text.startswith("Reconstructed from 60 photos, preset balanced.")
    assert "metal of roughness 0.10 (90%), not metal of roughness 0.90 (10%)" in text
    assert asset_description.describe_asset(tmp_path / "none") == ("Reconstructed from photos.", [])
