"""`blender-nep cameras film.mp4`: frames and cameras become a capture, or nothing is written."""

import errno
import io
import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from backend.engine.results import capture_contents
from backend.engine.results.capture_contents import photo_count
from benchmarks.scoring.cameras import errors
from blender_nep import command_line
from blender_nep.cameras.photo_folder import find_photos
from blender_nep.cameras.structure_from_motion import Group, PlacedPhoto
from blender_nep.cameras.video import kept_frames
from blender_nep.capture import load_capture
from blender_nep.capture.camera_settings import expected_response
from blender_nep.errors import CaptureError
from blender_nep.job.commands import camera_search
from blender_nep.job.commands.camera_search import CameraSearch
from blender_nep.job.reporting.events import Events
from blender_nep.stop_request import StopRequest
from support.films import pan, write_film
from support.printed_room import BALLS, camera, photograph, write_photos

FRAMES = 6


@pytest.fixture
def film(tmp_path):
    return write_film(tmp_path / "film.mp4", pan(np.linspace(0, 60, 48)))


@pytest.fixture(autouse=True)
def placed(request, monkeypatch):
    """Structure from motion places all photos at once, but in slow tests."""
    if "slow" not in request.keywords:

        def place(photos, *_, **__):
            return [Group([PlacedPhoto(p, camera(n, 16), 500, 0.2) for n, p in enumerate(photos)], np.array([BALLS[0][0]]))]

        monkeypatch.setattr(camera_search, "find_groups", place)


def run(photos: Path, out: Path | None = None, **options) -> tuple[int, list[dict]]:
    """(exit code, events) of the command."""
    said = io.StringIO()
    options = {"frames": FRAMES, "threads": 1} | options
    code = camera_search.run(CameraSearch(photos, out, **options), Events(said), StopRequest())
    return code, [json.loads(line) for line in said.getvalue().splitlines()]


def one(events, kind):
    return next(event for event in events if event["event"] == kind)


def content(folder: Path) -> dict[str, bytes]:
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_frames_and_cameras_become_a_capture(film, tmp_path):
    before = film.read_bytes()
    code, events = run(film)
    assert code == 0, events[-1]
    assert one(events, "done")["asset"] == str(tmp_path / "film")
    told = {line["code"]: line["values"] for line in one(events, "scene")["lines"]}
    assert told["cameras.video_frames"] == {"count": FRAMES, "frames": 48, "video": "film.mp4"}
    capture = load_capture(tmp_path / "film")
    assert len(capture.views) == FRAMES and all(view.image_path.parent.name == "images" for view in capture.views)
    assert expected_response(capture) == 0.5, "a camera has made them, which nobody names"
    assert sorted(path.name for path in (tmp_path / "film").iterdir()) == ["images", "transforms.json"]
    assert film.read_bytes() == before and sorted(path.name for path in tmp_path.iterdir()) == ["film", "film.mp4"]
    notes = [event["note"]["code"] for event in events if event["event"] == "progress" and event.get("note")]
    assert notes[0] == "cameras.video"


def test_a_second_run_refuses_or_loses_nothing(film, tmp_path):
    out = tmp_path / "out"
    assert run(film, out)[0] == 0
    before = content(out)
    code, events = run(film, out)
    assert code == 2 and one(events, "error")["name"] == "usage.cameras_exist" and content(out) == before
    assert run(film, out, frames=4, overwrite=True)[0] == 0
    after = content(out)
    assert {name: after[name] for name in before if name != "transforms.json"}.items() <= before.items()
    assert after["transforms.before.json"] == before["transforms.json"]
    assert {view.image_path.parent.name for view in load_capture(out).views} == {"images2"}


def test_cameras_are_found_again_of_the_frames_taken_last(film, tmp_path):
    out = tmp_path / "out"
    assert run(film, out)[0] == 0 and run(film, out, frames=4, overwrite=True)[0] == 0
    assert photo_count(out) == len(find_photos(out)) == 4, "the panel counts the same"
    assert run(out, overwrite=True)[0] == 0
    assert [view.image_path.parent.name for view in load_capture(out).views] == ["images2"] * 4
    (out / "transforms.json").unlink()
    assert photo_count(out) == len(find_photos(out)) == FRAMES


@pytest.mark.parametrize("content", ["no JSON", "[]", '{"frames": 3}', '{"frames": [{"file_path": "../a/b.jpg"}]}'])
def test_another_transforms_json_names_no_frames(tmp_path, content):
    (tmp_path / "images2").mkdir()
    (tmp_path / "transforms.json").write_text(content)
    assert kept_frames.frames_folder(tmp_path) == tmp_path / "images" == capture_contents._frames_folder(tmp_path)


def test_a_folder_with_one_video_and_no_photos(film, tmp_path):
    assert run(tmp_path)[0] == 0
    assert len(load_capture(tmp_path).views) == FRAMES and (tmp_path / "images").is_dir()


@pytest.mark.parametrize("place", ["", "images"])
def test_a_poster_beside_a_video_is_no_photo(film, tmp_path, place):
    write_photos(tmp_path / place, 1)
    code, events = run(tmp_path)
    assert code == 0, events[-1]
    assert one(events, "scene")["lines"][0]["values"]["video"] == "film.mp4"
    views = load_capture(tmp_path).views
    assert len(views) == FRAMES and {view.image_path.name[:6] for view in views} == {"frame_"}
    assert run(tmp_path, overwrite=True)[0] == 0
    assert [view.image_path for view in load_capture(tmp_path).views] == [view.image_path for view in views], "no new frames"


def test_who_needs_photos_hears_of_the_video_beside_a_poster(film, tmp_path):
    write_photos(tmp_path, 2)
    with pytest.raises(CaptureError, match=r"film\.mp4") as refused:
        find_photos(tmp_path)
    assert refused.value.name == "capture.video"


def test_a_folder_with_photos_is_not_one_of_videos(film, tmp_path):
    write_photos(tmp_path / "images", 4)
    assert run(tmp_path)[0] == 0
    assert [view.image_path.name for view in load_capture(tmp_path).views] == [f"photo_{n:02d}.jpg" for n in range(4)]


def test_of_several_videos_one_must_be_named(film, tmp_path):
    shutil.copy(film, tmp_path / "second.mp4")
    code, events = run(tmp_path)
    error = one(events, "error")
    assert code == 3 and error["name"] == "capture.several_videos" and error["hint"].endswith(f"blender-nep cameras {film}")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["film.mp4", "second.mp4"]


def test_masks_are_not_asked_of_a_video(film, tmp_path):
    code, events = run(film, features="object")
    assert code == 2 and one(events, "error")["name"] == "usage.no_masks" and not (tmp_path / "film").exists()


def test_where_no_cameras_are_found_nothing_is_written(film, tmp_path, monkeypatch):
    monkeypatch.setattr(camera_search, "find_groups", lambda *_, **__: [])
    code, events = run(film)
    assert code == 3 and one(events, "error")["name"] == "capture.cameras_not_found"
    assert [path.name for path in tmp_path.iterdir()] == ["film.mp4"]


@pytest.mark.parametrize("moment", ["cameras.video", "cameras.sphere"])
def test_a_stopped_search_writes_nothing(film, tmp_path, moment):
    stop = StopRequest()

    class StoppingEvents(Events):
        def progress(self, stage, step, steps, *rest, **more):
            if rest[3] is not None and rest[3].code == moment:
                stop.request("test")

    assert camera_search.run(CameraSearch(film, frames=FRAMES), StoppingEvents(io.StringIO()), stop) == 7
    assert [path.name for path in tmp_path.iterdir()] == ["film.mp4"]


def test_where_the_cameras_cannot_be_written_no_frames_stay(film, tmp_path, monkeypatch):
    from blender_nep.errors import OutputError

    def full(*_, **__):
        if _[1] == tmp_path / "film":
            raise OutputError("the disk is full", "", "output.disk_full")
        return write(*_, **__)

    write = camera_search.write_capture
    monkeypatch.setattr(camera_search, "write_capture", full)
    code, _ = run(film)
    assert code == 5 and list((tmp_path / "film").iterdir()) == []


def test_a_full_disk_is_said_and_leaves_nothing(film, tmp_path, monkeypatch):
    def full(*_, **__):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(kept_frames.shutil, "copytree", full)
    code, events = run(film)
    error = one(events, "error")
    assert code == 5 and error["name"] == "output.disk_full" and "--resume" not in error["hint"]
    assert list((tmp_path / "film").iterdir()) == []


def test_what_is_no_video_is_one_message(tmp_path):
    (tmp_path / "notes.txt").write_text("hello")
    code, events = run(tmp_path / "notes.txt")
    assert code == 3 and one(events, "error")["name"] == "capture.video_unreadable"
    code, events = run(tmp_path / "none.mp4")
    assert code == 3 and one(events, "error")["name"] == "capture.no_folder"


def test_photos_need_no_pyav(film, tmp_path, monkeypatch):
    monkeypatch.setattr(camera_search, "find_spec", lambda name: None)
    code, events = run(film)
    assert code == 1 and one(events, "error")["name"] == "unexpected.no_pyav" and not (tmp_path / "film").exists()
    write_photos(tmp_path / "photos", 3)
    assert run(tmp_path / "photos")[0] == 0


def test_the_command_line_limits_the_frames(capsys):
    assert command_line.parser().parse_args(["cameras", "film.mp4"]).frames == CameraSearch(Path("a")).frames == 80
    for wrong in ("2", "251"):
        with pytest.raises(SystemExit):
            command_line.parser().parse_args(["cameras", "film.mp4", "--frames", wrong])
    assert "must be at most 250" in capsys.readouterr().err


@pytest.mark.slow
def test_cameras_of_a_film_are_where_it_was_filmed(tmp_path):
    """A walk around the printed room of test_camera_search.py, 40 frames a round."""
    count = 40
    film = write_film(tmp_path / "film.mp4", (np.asarray(photograph(camera(n, count), samples=2)) for n in range(count)))
    code, events = run(film, frames=20)
    assert code == 0, events[-1]
    capture = load_capture(tmp_path / "film")
    true = [camera(int(view.image_path.stem.removeprefix("frame_")), count) for view in capture.views]
    off = errors([view.camera for view in capture.views], true, np.array(BALLS[0][0]))
    assert off["photos"] > 15 and off["rotation_deg"] < 0.15 and off["position"] < 0.005
