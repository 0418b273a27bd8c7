"""Cameras of a turntable's photos: it is recognized by the photos alone, and only what turns counts."""

import io
import json
import shutil
from dataclasses import replace

import numpy as np
import pytest
import torch
from PIL import Image
from scipy.spatial.transform import Rotation

from benchmarks.scoring.cameras import errors
from blender_nep.cameras import object_sphere
from blender_nep.cameras.found_cameras import FoundCameras
from blender_nep.cameras.improved_cameras import ImprovedCameras
from blender_nep.cameras.photo_folder import find_photos
from blender_nep.cameras.reduction import Reduction
from blender_nep.cameras.still_surroundings import SIDE, StillSurroundings, look_for_still_surroundings
from blender_nep.cameras.structure_from_motion import Group, PlacedPhoto
from blender_nep.cameras.written_capture import write_capture
from blender_nep.capture import load_capture
from blender_nep.errors import Stopped
from blender_nep.job.commands import camera_search
from blender_nep.job.commands.camera_search import CameraSearch
from blender_nep.job.reporting.events import Events
from blender_nep.stop_request import StopRequest
from support import printed_room, printed_turntable

COUNT = 24


@pytest.fixture(scope="module")
def turned(tmp_path_factory):
    """(folder, cameras, where the photos show what turns)"""
    folder = tmp_path_factory.mktemp("turned")
    return folder, *printed_turntable.write_photos(folder, COUNT)


def test_what_turns_is_found_in_the_photos_alone(turned):
    folder, _, shown = turned
    still = look_for_still_surroundings(find_photos(folder))
    assert still.turntable and still.share == 1
    small = Reduction.of(320, 240, SIDE)
    true = np.stack([np.asarray(small.copy(Image.fromarray(part), Image.Resampling.NEAREST)) for part in shown])
    found = np.stack(still.moving)
    assert (found & true).sum() / true.sum() > 0.95, "features on the object would be lost"
    assert (found & ~true).sum() / (~true).sum() < 0.15, "features on the room would count"


def test_a_walk_is_no_turntable(tmp_path):
    printed_room.write_photos(tmp_path, 12)
    still = look_for_still_surroundings(find_photos(tmp_path))
    assert still.share == 0 and not still.turntable and still.moving is None


def test_cropped_photos_are_recognized_too(turned, tmp_path):
    rng = np.random.default_rng(0)
    for path in sorted(turned[0].iterdir()):
        left, top = rng.integers(0, 20, 2).tolist()
        with Image.open(path) as image:
            image.crop((left, top, left + 300, top + 220)).save(tmp_path / path.name, quality=95)
    still = look_for_still_surroundings(find_photos(tmp_path))
    assert still.turntable and still.moving is None


@pytest.mark.parametrize(
    "share", [pytest.param(0.12, marks=pytest.mark.slow), 0.25, pytest.param(0.42, marks=pytest.mark.slow)]
)
def test_a_walk_before_a_far_background_is_no_turntable(tmp_path, share):
    """The background pans by this share of the width from the first photo to the last."""
    rng = np.random.default_rng(3)
    wide = Image.fromarray(rng.integers(0, 255, (30, 64), np.uint8)).resize((640, 240), Image.Resampling.BICUBIC)
    for number in range(COUNT):
        left = round(share * 320 * number / (COUNT - 1))
        photo = wide.crop((left, 0, left + 320, 240))
        photo.paste(Image.fromarray(rng.integers(0, 255, (90, 80), np.uint8)), (120, 90))
        photo.save(tmp_path / f"{number:02d}.png")
    still = look_for_still_surroundings(find_photos(tmp_path))
    assert still.share == 0 and not still.turntable and still.moving is None
    assert still.drift or share > 0.4, "photos at both ends show nothing in common"


def test_photos_of_a_plain_backdrop_tell_nothing(tmp_path):
    for number in range(12):
        pixels = np.full((90, 120), 230, np.uint8)
        pixels[30:60, 40:80] = np.random.default_rng(number).integers(0, 255, (30, 40))
        Image.fromarray(pixels).save(tmp_path / f"{number:02d}.png")
    assert not look_for_still_surroundings(find_photos(tmp_path)).turntable


def test_the_comparison_can_be_stopped(turned):
    def report(step, steps):
        steps_seen.append(step)
        if step == steps - 1:
            raise Stopped("stopped")

    steps_seen = []
    with pytest.raises(Stopped):
        look_for_still_surroundings(find_photos(turned[0]), report)
    assert steps_seen == list(range(2 * COUNT)), "it can be stopped while photos are read and compared"


def searched(folder, out, **options):
    """The exit code, the codes of what is said, and those of the warnings."""
    protocol = io.StringIO()
    code = camera_search.run(CameraSearch(folder, out, **options), Events(protocol, io.StringIO()), StopRequest())
    events = [json.loads(line) for line in protocol.getvalue().splitlines()]
    said = [line["code"] for event in events if event["event"] == "scene" for line in event["lines"]]
    return code, said, [event["code"] for event in events if event["event"] == "warning"]


@pytest.mark.slow
def test_the_cameras_are_found_relative_to_what_turns(turned, tmp_path):
    folder, cameras, _ = turned
    code, said, _ = searched(folder, tmp_path / "out")
    assert code == 0 and "cameras.turntable" in said
    capture = load_capture(tmp_path / "out")
    assert capture.turntable is True and len(capture.views) == COUNT
    off = errors([view.camera for view in capture.views], cameras, printed_turntable.CENTER)
    assert off["rotation_deg"] < 0.1 and off["rotation_deg_largest"] < 0.3
    assert off["position"] < 0.003 and off["direction_deg"] < 0.1


@pytest.mark.slow
def test_masks_take_the_place_of_what_turns(turned, tmp_path, monkeypatch):
    """Features count on the object of the masks, and a search without features says that no photo could be placed."""
    folder, _, _ = turned
    asked = {}

    def kept(photos, scratch, progress, stop, **options):
        asked.update(options)
        return []

    monkeypatch.setattr(camera_search, "find_groups", kept)
    searched(folder, tmp_path / "out")
    assert asked["masked"] is None and len(asked["moving"]) == COUNT
    masked = tmp_path / "masked"
    (masked / "masks").mkdir(parents=True)
    for path, part in zip(sorted(folder.iterdir()), turned[2], strict=True):
        shutil.copy(path, masked)
        Image.fromarray(np.uint8(255) * part).save(masked / "masks" / f"{path.stem}.png")
    searched(masked, tmp_path / "out")
    assert asked["masked"] is True and asked["moving"] is None


@pytest.mark.parametrize("masks", ["read", "damaged"])
@pytest.mark.parametrize("error_on_object", [0.2, 0.5], ids=["turntable", "walk"])
def test_drifting_surroundings_are_judged_by_the_masks(turned, tmp_path, monkeypatch, error_on_object, masks):
    """After a walk, features on the object agree as all features do. On a turntable they agree much better.

    Inverted masks are told of only where they count. Damaged ones end nothing, because the search did not ask for masks.
    """
    folder, cameras, shown = turned
    (tmp_path / "photos" / "masks").mkdir(parents=True)
    for path, part in zip(sorted(folder.glob("*.*")), shown, strict=True):
        shutil.copy(path, tmp_path / "photos")
        mask = tmp_path / "photos" / "masks" / f"{path.stem}.png"
        Image.fromarray(np.uint8(255) * ~part).save(mask)
        if masks == "damaged":
            mask.write_bytes(mask.read_bytes()[:-40])
    asked, better = [], error_on_object < 0.3 and masks == "read"

    def groups(photos, scratch, progress, stop, *, masked, **options):
        asked.append(masked)
        found, error = (cameras, error_on_object) if masked else (shaken(cameras), 0.56)
        placed = [PlacedPhoto(*one, 100, error) for one in zip(photos, found, strict=True)]
        return [Group(placed, np.zeros((1, 3)))]

    drifting = StillSurroundings(0.0, True, None, drift=True)
    monkeypatch.setattr(camera_search, "find_groups", groups)
    monkeypatch.setattr(camera_search, "look_for_still_surroundings", lambda photos, report: drifting)
    code, said, warnings = searched(tmp_path / "photos", tmp_path / "out")
    assert code == 0 and asked == ([None, True] if masks == "read" else [None])
    assert ("capture.masks_background" in warnings) is ("cameras.by_masks" in said) is better
    found = [view.camera for view in load_capture(tmp_path / "out", use_masks=False).views]
    off = errors(found, cameras, printed_turntable.CENTER)
    assert (off["rotation_deg_largest"] < 0.01) is better


def placed_at(cameras, monkeypatch, asked=None):
    """Let the search find these cameras. What is asked of it is put into `asked`."""

    def groups(photos, scratch, progress, stop, **options):
        if asked is not None:
            asked.update(options)
        return [Group([PlacedPhoto(*one, 100, 0.1) for one in zip(photos, cameras, strict=True)], np.zeros((1, 3)))]

    monkeypatch.setattr(camera_search, "find_groups", groups)


def shaken(cameras):
    """The cameras of a walk: each aims elsewhere by some degrees."""
    rng, found = np.random.default_rng(0), []
    for camera in cameras:
        matrix = camera.camera_to_world.copy()
        matrix[:3, :3] = matrix[:3, :3] @ Rotation.from_rotvec(rng.normal(0, 0.04, 3)).as_matrix()
        found.append(replace(camera, camera_to_world=matrix))
    return found


def told(folder):
    return json.loads((folder / "transforms.json").read_text()).get("turntable")


@pytest.mark.parametrize(
    ("change", "options", "expected", "code"),
    [
        (list, {}, True, None),
        (shaken, {}, None, "cameras.turntable_unsure"),
        (shaken, {"turntable": True}, True, None),
        (list, {"turntable": False}, False, None),
    ],
    ids=["still cameras", "cameras of a walk", "told", "denied"],
)
def test_the_cameras_must_fit_a_turntable(turned, tmp_path, monkeypatch, change, options, expected, code):
    asked = {}
    placed_at(change(turned[1]), monkeypatch, asked)
    result, said, warned = searched(turned[0], tmp_path / "out", **options)
    assert result == 0 and told(tmp_path / "out") is expected
    assert [w for w in warned if "turntable" in w] == ([code] if code else [])
    assert ("cameras.turntable" in said) == (expected is True and not options)
    assert (asked["moving"] is None) == (expected is False)


def test_shifted_surroundings_are_not_written_down(turned, tmp_path, monkeypatch):
    """The job looks at the photos again, and decides."""
    placed_at(turned[1], monkeypatch)
    shifted = StillSurroundings(1.0, True, None)
    monkeypatch.setattr(camera_search, "look_for_still_surroundings", lambda photos, report: shifted)
    code, _, warned = searched(turned[0], tmp_path / "out")
    assert code == 0 and told(tmp_path / "out") is None and "cameras.turntable_shifted" in warned


@pytest.mark.parametrize("turntable", [True, False, None])
def test_improved_cameras_keep_what_the_file_tells(turned, tmp_path, monkeypatch, turntable):
    """The turntable, its rows and its turns; and only what turns counts."""
    given = [PlacedPhoto(photo, camera, 0, 0.0) for photo, camera in zip(find_photos(turned[0]), turned[1], strict=True)]
    given = [replace(one, row=number % 2, turn=15.0 * number) for number, one in enumerate(given)]
    capture = FoundCameras(given, np.zeros((0, 3)), [], printed_turntable.CENTER, 1.0, turntable)
    write_capture(capture, tmp_path / "given")
    asked = {}
    placed_at(turned[1], monkeypatch, asked)

    def take_over(photos, cameras, *_):
        placed = [PlacedPhoto(*one, 100, 0.1) for one in zip(photos, cameras, strict=True)]
        return ImprovedCameras(placed, placed, 1.0, 0.1, [], 0.1, 0.01, 0.0)

    monkeypatch.setattr(camera_search, "take_over", take_over)
    code, _, _ = searched(tmp_path / "given", tmp_path / "out", improve=True)
    assert code == 0 and told(tmp_path / "out") is turntable
    frames = json.loads((tmp_path / "out" / "transforms.json").read_text())["frames"]
    expected = [(number % 2, 15.0 * number) for number in range(COUNT)]
    assert [(frame.get("row"), frame.get("turn")) for frame in frames] == expected
    assert (asked["moving"] is None) == (turntable is not True)


@pytest.mark.parametrize(("change", "fits"), [(list, True), (shaken, False)], ids=["turntable", "walk"])
def test_the_search_for_the_sphere_knows_the_turns(turned, tmp_path, monkeypatch, change, fits):
    """Cameras that do not fit a turntable are searched as those of a walk."""
    placed = [PlacedPhoto(*one, 0, 0.0) for one in zip(find_photos(turned[0]), change(turned[1]), strict=True)]
    write_capture(FoundCameras(placed, np.zeros((0, 3)), [], printed_turntable.CENTER, 1.5, True), tmp_path / "out")
    seen = []

    def look(rays):
        seen.append(rays.turntable)
        raise Stopped("stopped")

    monkeypatch.setattr(object_sphere.Scene, "of", look)
    with pytest.raises(Stopped):
        object_sphere.find_object_sphere(load_capture(tmp_path / "out", use_masks=False))
    assert (seen[0] is not None) == fits
    if fits:
        places = np.stack([camera.position for camera in turned[1]])
        in_room = seen[0].points(torch.tensor((places - printed_turntable.CENTER) / 1.5, dtype=torch.float32))
        assert np.allclose(in_room, in_room[0], atol=1e-4), "the camera stood still"
