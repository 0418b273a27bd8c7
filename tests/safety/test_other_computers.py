r"""Paths such as \\server\share\photo.png: Windows tells that computer the user's name and a hash of the password."""

from __future__ import annotations

import ntpath
from pathlib import PureWindowsPath

import pytest

from backend import plain_files as blenders
from backend.scene_io.capture_files import read_frames
from blender_nep.capture import load_capture
from blender_nep.errors import CaptureError
from blender_nep.safety import plain_files as engines

ELSEWHERE = ("\\\\evil\\share\\a.png", "//evil/share/a.png", "\\/evil/share", "\\\\?\\UNC\\evil\\share\\a", "\\\\.\\pipe\\a")
HERE = ("a.png", "images/a.png", "/home/a.png", "C:\\a.png", "c:/a.png", "..\\a.png", "", "\\a.png", "a//b.png")
sides = pytest.mark.parametrize("side", [engines, blenders], ids=["engine", "blender"])


@sides
def test_paths_to_another_computer_are_known(side, tmp_path):
    assert all(side.is_on_other_computer(name, tmp_path) for name in ELSEWHERE)
    assert not any(side.is_on_other_computer(name, tmp_path) for name in HERE)


@sides
def test_the_computer_of_the_capture_and_of_a_drive_is_no_other(side, monkeypatch):
    monkeypatch.setattr(side, "_connected", lambda: {"\\\\nas\\photos"})
    monkeypatch.setattr(side.os.path, "abspath", ntpath.normpath)
    folder = PureWindowsPath("//Studio/shelf/vase")
    assert not side.is_on_other_computer("//studio/SHELF/other/a.png", folder)
    assert not side.is_on_other_computer("\\\\NAS\\photos\\a.png", folder)
    assert side.is_on_other_computer("\\\\nas\\other\\a.png", folder)


@pytest.mark.parametrize("key", ["file_path", "mask_path"])
@pytest.mark.parametrize("name", ELSEWHERE)
def test_photos_on_another_computer_are_refused(name, key, make_capture):
    capture = make_capture()
    capture.meta["frames"][2][key] = name
    with pytest.raises(CaptureError, match="lies on another computer") as refused:
        load_capture(capture.save())
    assert "Copy the photos" in refused.value.hint
    with pytest.raises(ValueError, match="lies on another computer"):
        read_frames(capture.folder)
