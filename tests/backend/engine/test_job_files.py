"""The files by which Blender follows a job."""

import pytest

from backend.engine.results.batch_file import has_batch
from backend.engine.results.capture_contents import has_cameras
from backend.engine.results.job_files import TEXTURE_NAMES, EventFile, has_checkpoint, is_asset
from blender_nep.asset.export import TEXTURES


def test_only_whole_events_are_read_and_other_lines_are_left_out(tmp_path):
    file = EventFile(tmp_path / "events.jsonl")
    assert file.read() == []
    with open(tmp_path / "events.jsonl", "ab", buffering=0) as writer:
        writer.write(b'a stray line\n[1]\n{"event": "warn')
        assert file.read() == []
        writer.write(b'ing", "message": "\xc3\xa4"}\n{"event": "done"}\n')
        assert file.read() == [{"event": "warning", "message": "ä"}, {"event": "done"}]
        assert file.read() == []


def test_both_copies_name_the_same_textures():
    assert TEXTURE_NAMES == TEXTURES


@pytest.mark.parametrize("missing", ["mesh.obj", "report.json", *(f"textures/{name}.exr" for name in TEXTURE_NAMES)])
def test_an_asset_is_finished_when_all_its_files_are_there(tmp_path, missing):
    (tmp_path / "textures").mkdir()
    for name in ("mesh.obj", "report.json", *(f"textures/{name}.exr" for name in TEXTURE_NAMES)):
        (tmp_path / name).touch()
    assert is_asset(tmp_path)
    (tmp_path / missing).unlink()
    assert not is_asset(tmp_path)


def test_a_folder_that_cannot_be_read_holds_nothing(tmp_path):
    """The sidebar asks while it draws, where an error would empty the panel."""
    unreadable = tmp_path / ("x" * 300)  # a name that no file system takes
    assert not is_asset(unreadable) and not has_checkpoint(unreadable) and not has_batch(unreadable)
    assert not has_cameras(unreadable) and not has_cameras(tmp_path / "a" / ("x" * 300))
