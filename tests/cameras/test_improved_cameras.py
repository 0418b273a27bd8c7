"""Given cameras are improved by the photos, in their own frame; good ones are left alone."""

import io
import json
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image
from scipy.spatial.transform import Rotation

from benchmarks.scoring.cameras import errors
from blender_nep.cameras.alignment import angle, moved, similarity
from blender_nep.cameras.found_cameras import FoundCameras
from blender_nep.cameras.photo_folder import find_photos
from blender_nep.cameras.structure_from_motion import PlacedPhoto, find_groups
from blender_nep.cameras.written_capture import write_capture
from blender_nep.capture import load_capture
from blender_nep.job.commands import camera_search
from blender_nep.job.commands.camera_search import CameraSearch
from blender_nep.job.reporting.events import Events
from blender_nep.stop_request import StopRequest
from support.printed_room import BALLS, camera, write_photos

COUNT = 16
CENTER, RADIUS = np.array(BALLS[0][0]), 0.8
TRUE = [camera(number, COUNT) for number in range(COUNT)]


@pytest.fixture(scope="module")
def photos(tmp_path_factory):
    folder = tmp_path_factory.mktemp("room")
    write_photos(folder, COUNT)
    return find_photos(folder)


def capture_with(photos, cameras, folder, **how):
    placed = [PlacedPhoto(photo, given, 0, 0.0) for photo, given in zip(photos, cameras, strict=True)]
    write_capture(FoundCameras(placed, np.zeros((0, 3)), [], CENTER, RADIUS), folder, **how)
    return folder


def shaken(degrees, part, seed=1):
    """The true cameras, each turned by about so many degrees and moved by such a part of its distance."""
    random, out = np.random.default_rng(seed), []
    for true in TRUE:
        matrix = true.camera_to_world.copy()
        matrix[:3, :3] = (
            Rotation.from_rotvec(random.normal(size=3) * degrees / 1.54, degrees=True).as_matrix() @ matrix[:3, :3]
        )
        matrix[:3, 3] += random.normal(size=3) * part / 1.54 * np.linalg.norm(matrix[:3, 3] - CENTER)
        out.append(replace(true, camera_to_world=matrix))
    return out


def improved(capture, out):
    """(cameras, events) after the command."""
    said = io.StringIO()
    code = camera_search.run(CameraSearch(capture, out, improve=True), Events(said), StopRequest())
    events = [json.loads(line) for line in said.getvalue().splitlines()]
    assert code == 0, events[-1]
    return load_capture(out), events


def code_of(events):
    return next(event for event in events if event["event"] == "scene")["lines"][0]["code"]


@pytest.mark.slow
def test_shaken_cameras_come_back(photos, tmp_path):
    given = shaken(0.3, 0.01)
    capture, events = improved(capture_with(photos, given, tmp_path / "given"), tmp_path / "out")
    before, after = (errors(cameras, TRUE, CENTER) for cameras in (given, [view.camera for view in capture.views]))
    assert before["rotation_deg"] > 0.2 and after["rotation_deg"] < 0.3 * before["rotation_deg"]
    assert after["position"] < 0.2 * before["position"] and after["focal_length"] < 0.005
    assert code_of(events) == "cameras.improved"
    assert all(
        view.camera.fl_x == true.fl_x and view.camera.lens == true.lens
        for view, true in zip(capture.views, TRUE, strict=True)
    )
    assert capture.object_center == pytest.approx(CENTER) and capture.object_radius == RADIUS
    # the frame is held: without any alignment, the cameras stand nearer to the true ones than the given ones did
    apart = [np.linalg.norm(view.camera.position - true.position) for view, true in zip(capture.views, TRUE, strict=True)]
    assert np.median(apart) < 0.5 * np.median(
        [np.linalg.norm(g.position - t.position) for g, t in zip(given, TRUE, strict=True)]
    )


@pytest.mark.slow
def test_exact_cameras_are_kept_to_the_last_digit(photos, tmp_path):
    capture, events = improved(capture_with(photos, TRUE, tmp_path / "given"), tmp_path / "out")
    assert code_of(events) == "cameras.good_as_given"
    for view, true in zip(capture.views, TRUE, strict=True):
        assert np.abs(view.camera.camera_to_world - true.camera_to_world).max() < 1e-9
        assert view.camera.lens == true.lens and view.camera.fl_x == true.fl_x


@pytest.mark.slow
def test_a_guessed_sphere_is_not_written_so_masks_decide_later(photos, tmp_path):
    """The capture says no sphere. Its masks show a smaller one than the cameras suggest."""
    masked = []
    for photo, true in zip(photos, TRUE, strict=True):
        y, x = np.indices((true.height, true.width)) + 0.5
        x_center, y_center, depth = true.project(CENTER[None])
        shown = np.hypot(x - x_center, y - y_center) < 0.3 * true.fl_x / depth
        masked.append(replace(photo, mask=tmp_path / f"{photo.path.stem}_object.png"))
        Image.fromarray(np.uint8(255) * shown).save(masked[-1].mask)
    given = capture_with(masked, TRUE, tmp_path / "given", with_sphere=False)
    before = load_capture(given)
    capture, _ = improved(given, tmp_path / "out")
    assert not {"object_center", "object_radius"} & set(json.loads((tmp_path / "out/transforms.json").read_text()))
    assert before.bounds_source == capture.bounds_source == "masks"
    assert capture.object_radius == pytest.approx(before.object_radius, rel=0.05)


@pytest.mark.slow
def test_a_photo_that_shows_little_hardly_changes_its_camera(photos, tmp_path):
    """Photo 5 is blank. Photo 8 is blank but for one corner with a few dozen points, which alone turn its camera away."""
    blank = tmp_path / "blank.png"
    Image.new("L", (TRUE[0].width, TRUE[0].height), 120).save(blank)
    corner = only_a_corner(photos[8], 120, tmp_path / "corner.png")
    given = shaken(0.3, 0.01)
    changed = [*photos[:5], replace(photos[5], path=blank), *photos[6:8], corner, *photos[9:]]
    capture, events = improved(capture_with(changed, given, tmp_path / "given"), tmp_path / "out")
    warned = next(event for event in events if event["event"] == "warning")
    assert (warned["code"], warned["values"]["names"]) == ("cameras.kept", ["blank.png"])
    assert np.abs(capture.views[5].camera.camera_to_world - given[5].camera_to_world).max() < 1e-9
    assert np.abs(capture.views[6].camera.camera_to_world - given[6].camera_to_world).max() > 1e-4
    before, after = (_away(one, TRUE[8]) for one in (given[8], capture.views[8].camera))
    assert (after < 0.8 * before).all()


@pytest.mark.slow
def test_photos_that_show_little_do_not_move_together(photos, tmp_path):
    """Three neighbors show one corner only, and share its points. pycolmap's adjustment alone moves them far away."""
    changed, given, few = list(photos), shaken(0.3, 0.01), (7, 8, 9)
    for number in few:
        changed[number] = only_a_corner(photos[number], 110, tmp_path / f"corner_{number}.png")
    (tmp_path / "work").mkdir()
    group = find_groups(changed, tmp_path / "work", lambda *step: None, StopRequest(), given=given)[0]
    found = {one.photo.path: one.camera for one in group.placed}
    carry = similarity([found[photo.path] for photo in changed], TRUE)
    away = [_away(moved(found[changed[number].path], *carry), TRUE[number])[1] for number in few]
    before = [_away(given[number], TRUE[number])[1] for number in few]
    assert np.mean(away) < 1.5 * np.mean(before)


def only_a_corner(photo, size, path):
    """The photo with nothing left but its last rows and columns, as another file."""
    gray = np.full((photo.height, photo.width), 120, np.uint8)
    gray[-size:, -size:] = np.asarray(Image.open(photo.path).convert("L"))[-size:, -size:]
    Image.fromarray(gray).save(path)
    return replace(photo, path=path)


def _away(found, true):
    """Turn [degrees] and distance between two cameras."""
    turn = angle(found.camera_to_world[:3, :3].T @ true.camera_to_world[:3, :3])
    return np.array([turn, np.linalg.norm(found.position - true.position)])
