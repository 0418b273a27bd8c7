"""A shelf or an asset from a stranger may hold links to files of the user: nothing is written through them."""

from __future__ import annotations

import io
import json
import os
from pathlib import Path

import pytest

from blender_nep import cli
from blender_nep.asset.export import WRITTEN, write_asset
from blender_nep.errors import OutputError
from blender_nep.files import refuse_links, write_atomically, write_text
from blender_nep.job import runner
from blender_nep.job.commands import correction
from blender_nep.job.folders.job_folder import JobFolder, lock_file
from blender_nep.job.folders.own_files import ENTRIES, discard_run, is_ours, remove_checkpoints
from blender_nep.job.reporting.events import Events
from blender_nep.job.settings import Settings
from blender_nep.presets import preset
from blender_nep.stop_request import StopRequest

FOLDERS = ("textures", ".partial", "checkpoints", "job")


@pytest.fixture
def victim(tmp_path):
    """A folder of the user: links of a stranger lead there."""
    folder = tmp_path / "victim"
    (folder / "textures").mkdir(parents=True)
    for name in ("mine.txt", "lock", "run.json", "albedo.png", "mesh.obj", "textures/albedo.png"):
        (folder / name).write_text("mine")
    return folder


def content(folder: Path) -> dict[str, str]:
    return {str(path.relative_to(folder)): path.read_text() for path in folder.rglob("*") if path.is_file()}


@pytest.mark.parametrize("name", ENTRIES)
def test_a_run_refuses_a_link_before_it_reads_the_photos(name, make_capture, tmp_path, victim):
    before, out = content(victim), tmp_path / "out"
    out.mkdir()
    (out / name).symlink_to(victim if name in FOLDERS else victim / "mine.txt")
    told = io.StringIO()
    settings = Settings(make_capture(views=6, size=8).folder, out, preset=preset("preview"), overwrite=True)
    code = runner.run(settings, Events(told), StopRequest())
    error = json.loads(told.getvalue().splitlines()[-1])
    assert code == 5 and error["name"] == "output.is_a_link" and error["values"]["path"] == str(out / name)
    assert content(victim) == before and os.path.islink(out / name)


@pytest.mark.parametrize("name", ["log.txt", "textures", ".partial", "job"])
def test_a_correction_refuses_a_link(name, tmp_path, victim):
    before, asset = content(victim), tmp_path / "asset"
    asset.mkdir()
    (asset / "report.json").write_text("{}")
    (asset / name).symlink_to(victim if name in FOLDERS else victim / "mine.txt")
    told = io.StringIO()
    assert correction.run(asset, {}, Events(told)) == 5 and "output.is_a_link" in told.getvalue()
    assert content(victim) == before


def test_an_output_folder_that_is_a_link_is_the_users_own(tmp_path):
    (tmp_path / "disk").mkdir()
    (tmp_path / "out").symlink_to(tmp_path / "disk")
    refuse_links(tmp_path / "out", WRITTEN)
    JobFolder(tmp_path / "out", followed=True).close()
    assert (tmp_path / "disk" / "job" / "lock").is_file()


def test_a_lock_makes_no_file_elsewhere(tmp_path):
    (tmp_path / "lock").symlink_to(tmp_path / "elsewhere")
    with pytest.raises(OutputError) as refused:
        lock_file(tmp_path / "lock", tmp_path)
    assert refused.value.name == "output.is_a_link" and not (tmp_path / "elsewhere").exists()


def test_a_file_that_is_replaced_takes_the_place_of_a_link(tmp_path):
    """The name under which it is written first may be a link, too."""
    mine = tmp_path / "mine"
    mine.write_text("mine")
    for name in ("page", f".page.{os.getpid()}.tmp"):
        (tmp_path / name).symlink_to(mine)
    write_text(tmp_path / "page", "new")
    assert mine.read_text() == "mine" and not (tmp_path / "page").is_symlink() and (tmp_path / "page").read_text() == "new"
    write_atomically(tmp_path / "page", lambda temporary: temporary.write_text("newer"))
    assert sorted(path.name for path in tmp_path.iterdir()) == ["mine", "page"]


def test_arguments_write_no_lines_of_their_own(capsys):
    """A shell's `*` gives names that strangers chose."""
    with pytest.raises(SystemExit):
        cli.main(["info", "capture", "x\x1b[31m\nerror: y"])
    assert cli.main(["info", "no\n\x1b[31mfolder"]) == 3
    said = capsys.readouterr().err
    assert "x\\x1b[31m\\nerror: y" in said and "no\\n\\x1b[31mfolder" in said and "\x1b" not in said


def test_checkpoints_that_are_a_link_are_not_discarded(tmp_path, victim):
    before, out = content(victim), tmp_path / "out"
    out.mkdir()
    (out / "report.json").write_text('{"fingerprint": {"format": 15}}')
    (out / "checkpoints").symlink_to(victim)
    for remove in (discard_run, remove_checkpoints):
        with pytest.raises(OutputError, match="link"):
            remove(out)
    assert content(victim) == before


def test_textures_are_not_made_through_a_link(tmp_path, victim):
    before, out = content(victim), tmp_path / "out"
    (out / ".partial").mkdir(parents=True)
    (out / ".partial/textures").symlink_to(victim / "textures")
    with pytest.raises(OutputError, match="link"):
        write_asset(out, None, None, None, None, dict)
    assert content(victim) == before


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="POSIX")
def test_a_pipe_or_deep_json_is_no_mark_and_stops_nothing(tmp_path):
    os.mkfifo(tmp_path / "report.json")
    assert not is_ours(tmp_path)
    (tmp_path / "report.json").unlink()
    (tmp_path / "report.json").write_text("[" * 100_000)
    assert not is_ours(tmp_path)
