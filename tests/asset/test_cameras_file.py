"""Blender's reader finds the cameras of a capture of any form in the asset, as the engine has read them."""

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest

from backend.scene_io.capture_files import CAMERAS as BLENDER_CAMERAS
from backend.scene_io.capture_files import read_bounds, read_frames, read_frames_of
from blender_nep.asset.cameras_file import CAMERAS, cameras_content
from blender_nep.capture import load_capture
from blender_nep.capture.formats import transforms


def written(capture, folder):
    folder.mkdir(parents=True)
    (folder / CAMERAS).write_text(json.dumps(cameras_content(capture, folder)))
    return folder


def test_both_sides_name_the_file_alike():
    assert CAMERAS == BLENDER_CAMERAS


def test_blender_reads_what_the_engine_has_read(make_capture, tmp_path):
    tiny = make_capture(views=5)
    expected = read_frames(tiny.folder)
    nerf = tiny.folder.with_name("nerf data")
    shutil.copytree(tiny.folder, nerf)
    (nerf / "transforms.json").rename(nerf / "transforms_train.json")
    asset = written(load_capture(nerf), tmp_path / "out" / "asset")
    for one, other in zip(expected, read_frames_of(nerf, asset), strict=True):
        assert other.path.resolve() == nerf / one.path.relative_to(tiny.folder)
        assert (other.width, other.fl_x, other.cy, other.color_space) == (one.width, one.fl_x, one.cy, one.color_space)
        np.testing.assert_allclose(other.matrix, one.matrix, atol=1e-12)


def test_photos_may_be_links_and_the_asset_a_link(make_capture, tmp_path):
    """As where a folder of photos is shared by several COLMAP projects."""
    tiny = make_capture(views=4)
    linked = tmp_path / "linked"
    linked.mkdir()
    (linked / "images").symlink_to(tiny.folder / "images")
    shutil.copy(tiny.folder / "transforms.json", linked / "transforms_train.json")
    (tmp_path / "disk").mkdir()
    (tmp_path / "asset").symlink_to(written(load_capture(linked), tmp_path / "disk" / "deep" / "asset"))
    frames = read_frames_of(linked, tmp_path / "asset")
    assert len(frames) == 4 and all(frame.path.is_file() for frame in frames)


def test_another_folder_is_no_capture_of_the_asset(make_capture, tmp_path):
    tiny = make_capture(views=4)
    asset = written(load_capture(tiny.folder), tmp_path / "asset")
    (tmp_path / "other").mkdir()
    with pytest.raises(OSError, match=r"has no transforms\.json"):
        read_frames_of(tmp_path / "other", asset)


def test_a_capture_with_transforms_json_is_read_itself(make_capture, tmp_path):
    """Its photos may have been moved since the asset was made."""
    tiny = make_capture(views=4)
    asset = written(load_capture(tiny.folder), tmp_path / "asset")
    moved = tiny.folder.rename(tmp_path / "moved")
    assert [frame.path.parent for frame in read_frames_of(moved, asset)] == [moved / "images"] * 4


def test_the_file_is_a_capture_of_its_own(make_capture, tmp_path):
    """Distortion, sphere and colors come back, in a fisheye lens too."""
    tiny = make_capture(views=4)
    tiny.meta |= {"camera_model": "OPENCV_FISHEYE", "k1": 0.03, "k4": -0.001}
    tiny.save()
    capture = load_capture(tiny.folder)
    asset = written(capture, tmp_path / "asset")
    said = transforms.read(asset, CAMERAS)
    assert [view.camera.lens for view in said.views] == [view.camera.lens for view in capture.views]
    assert said.color_space == capture.color_space and said.object_radius == capture.object_radius


def test_both_sides_read_a_file_with_a_byte_order_mark(make_capture):
    """Notepad and PowerShell on Windows write one."""
    tiny = make_capture(views=4)
    path = tiny.folder / "transforms.json"
    path.write_text(path.read_text(), encoding="utf-8-sig")
    assert len(load_capture(tiny.folder).views) == len(read_frames(tiny.folder)) == 4
    assert read_bounds(tiny.folder) is not None


def test_the_sidebar_asks_the_engine_for_bounds_of_other_forms(make_capture):
    tiny = make_capture(views=4)
    assert read_bounds(tiny.folder) is not None
    (tiny.folder / "transforms.json").unlink()
    assert read_bounds(tiny.folder) is None
    with pytest.raises(OSError, match="no folder"):
        read_bounds(tiny.folder / "nowhere")


def test_the_object_of_a_turntable_rests_in_the_first_photo(make_capture, tmp_path):
    """The engine's room may be that of another photo: what counts is how the object moved since the first one."""
    capture = load_capture(make_capture(views=4).folder)
    turns = [np.eye(4) for _ in capture.views]
    for angle, turn in zip((0.3, 0.8, 1.3, 1.8), turns, strict=True):
        turn[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
        turn[0, 3] = 0.2 * angle
    capture.views = [replace(view, in_room=turn) for view, turn in zip(capture.views, turns, strict=True)]
    frames = read_frames(written(capture, tmp_path / "asset"), CAMERAS)
    np.testing.assert_allclose(frames[0].object_to_room, np.eye(4), atol=1e-12)
    for frame, turn in zip(frames, turns, strict=True):
        np.testing.assert_allclose(turns[0] @ frame.object_to_room, turn, atol=1e-12)


def turned(capture):
    """The capture, whose object has moved by n along x in photo n."""
    motions = [np.eye(4) for _ in capture.views]
    for n, motion in enumerate(motions):
        motion[0, 3] = n
    capture.views = [replace(view, in_room=motion) for view, motion in zip(capture.views, motions, strict=True)]
    return capture


def test_a_moved_capture_of_a_turntable_keeps_its_motions(make_capture, tmp_path):
    """One photo was left out, as one by hand is: nobody knows how the object stood there."""
    tiny = make_capture(views=5)
    capture = turned(load_capture(tiny.folder))
    del capture.views[2]
    asset = written(capture, tmp_path / "asset")
    moved = tiny.folder.rename(tmp_path / "moved")
    frames = read_frames_of(moved, asset)
    assert [(frame.path.parent, frame.path.stem) for frame in frames] == [
        (moved / "images", view.image_path.stem) for view in capture.views
    ]
    assert [frame.object_to_room[0, 3] for frame in frames] == [0, 1, 3, 4]


def test_renamed_photos_of_a_turntable_are_refused(make_capture, tmp_path):
    tiny = make_capture(views=4)
    asset = written(turned(load_capture(tiny.folder)), tmp_path / "asset")
    text = (tiny.folder / "transforms.json").read_text()
    for photo in (tiny.folder / "images").iterdir():
        photo.rename(photo.with_name(f"new_{photo.name}"))
        text = text.replace(photo.name, f"new_{photo.name}")
    (tiny.folder / "transforms.json").write_text(text)
    with pytest.raises(ValueError, match="photos of other names"):
        read_frames_of(tiny.folder, asset)


def test_an_object_that_stood_still_has_no_motion(make_capture, tmp_path):
    capture = load_capture(make_capture(views=4).folder)
    assert all(frame.object_to_room is None for frame in read_frames(written(capture, tmp_path / "asset"), CAMERAS))
