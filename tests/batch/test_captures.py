"""Which folders are captures, and how their objects are called."""

from __future__ import annotations

from pathlib import Path

import pytest
from PIL import Image

from blender_nep.batch.captures import FoundCapture, find_captures, size_of
from blender_nep.batch.names import object_name
from blender_nep.batch.settings import BatchSettings
from blender_nep.batch.state import BatchState, ObjectState
from blender_nep.errors import CaptureError, UsageError


def photos(folder: Path, count: int = 4) -> Path:
    folder.mkdir(parents=True)
    for number in range(count):
        Image.new("RGB", (20, 10)).save(folder / f"{number}.jpg")
    return folder


@pytest.fixture
def shelf(tmp_path, make_capture):
    """A folder with a capture, photos alone, photos in `images`, a folder of neither, and the batch's own folder."""
    make_capture(name="all/vase", size=8)
    photos(tmp_path / "all/phone")
    photos(tmp_path / "all/camera/images")
    (tmp_path / "all/notes").mkdir()
    photos(tmp_path / "all/out")
    photos(tmp_path / "all/.hidden")
    Image.new("RGB", (20, 10)).save(tmp_path / "all/cover.png")
    return tmp_path / "all"


def found(*named: Path, out: Path = Path("/nowhere")) -> dict[str, bool]:
    return {one.path.name: one.photos_alone for one in find_captures(named, out)}


def test_a_folder_that_holds_captures(shelf):
    assert found(shelf, out=shelf / "out") == {"camera": True, "phone": True, "vase": False}


def test_a_folder_that_may_not_be_read_is_passed_over(shelf, monkeypatch):
    """As a drive's `lost+found`. The tests may run as root, who may read all, so the refusal is played."""
    locked, whole = shelf / "lost+found", Path.is_file
    locked.mkdir()

    def is_file(path):
        if path.parent == locked:
            raise PermissionError(13, "Permission denied", str(path))
        return whole(path)

    monkeypatch.setattr(Path, "is_file", is_file)
    assert found(shelf, out=shelf / "out") == {"camera": True, "phone": True, "vase": False}


def test_folders_one_by_one_and_each_only_once(shelf):
    assert found(shelf / "vase", shelf / "phone", shelf / "vase", shelf / "camera") == {
        "vase": False,
        "phone": True,
        "camera": True,
    }


def test_a_list(shelf):
    listed = shelf / "list.txt"
    listed.write_text("# all of them\nvase  # the first\n\n  phone\nno_such_folder\nnotes\n")
    assert found(listed) == {"vase": False, "phone": True, "no_such_folder": False, "notes": False}
    with pytest.raises(CaptureError, match="no folder"):
        size_of(FoundCapture(shelf / "no_such_folder", False))


@pytest.mark.parametrize("name", ["notes", "no_such_folder", "cover.png", "empty.txt"])
def test_what_holds_no_captures_is_refused(shelf, name):
    (shelf / "empty.txt").write_text("# nothing\n")
    with pytest.raises(UsageError) as refused:
        find_captures([shelf / name], Path("/nowhere"))
    assert refused.value.hint


def test_sizes(shelf):
    assert size_of(FoundCapture(shelf / "phone", True)).to_dict() == {"photos": 4, "pixels": 800}
    size = size_of(FoundCapture(shelf / "vase", False))
    assert size.to_dict() == {"photos": 6, "pixels": 384} and shelf / "vase/transforms.json" in size.files


@pytest.mark.parametrize(
    ("folder", "taken", "name"),
    [
        ("vase", [], "vase"),
        ("vase", ["vase"], "vase-2"),
        ("Vase", ["vase", "vase-2"], "Vase-3"),
        ("große Vase", [], "große_Vase"),
        ("a/..b: c?", [], "b_c"),
        ("???", [], "object"),
        ("gallery", [], "object_gallery"),
        ("con.old", [], "object_con.old"),
        ("x" * 300, [], "x" * 80),
    ],
)
def test_names(folder, taken, name):
    assert object_name(Path("/captures") / folder, set(taken)) == name


def test_a_name_is_kept_although_other_captures_come_first():
    captures = [FoundCapture(Path(path), False) for path in ("/1/vase", "/2/vase", "/3/cup")]
    state = BatchState(BatchSettings((), Path("out")).identity())
    assert [one.name for one in state.take(captures)] == ["vase", "vase-2", "cup"]
    again = state.take([FoundCapture(Path("/0/vase"), False), *reversed(captures)])
    assert [one.name for one in again] == ["vase-3", "cup", "vase-2", "vase"]


@pytest.mark.parametrize("state", ["failed", "done"])
def test_cameras_that_were_found_since_the_last_start_are_used(state):
    before = BatchState(BatchSettings((), Path("out")).identity())
    (one,) = before.take([FoundCapture(Path("/1/vase"), True)])
    one.state, one.size = state, {"photos": 9, "pixels": 9}
    (again,) = before.take([FoundCapture(Path("/1/vase"), False)])
    assert again is one and one.photos_alone == (state == "done") and (one.size is None) == (state == "failed")


def test_an_object_survives_the_disk():
    one = ObjectState("a", "/a", size={"photos": 3, "pixels": 9}, state="failed", error={"name": "capture"}, seconds=1.5)
    assert ObjectState.from_dict(one.to_dict() | {"of_tomorrow": 1}) == one
