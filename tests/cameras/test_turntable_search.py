"""Cameras of a turntable's photos: it is recognized by the photos alone, and only what turns counts."""

import io
import json
import shutil

import numpy as np
import pytest
from PIL import Image

from benchmarks.scoring.cameras import errors
from blender_nep.cameras.photo_folder import find_photos
from blender_nep.cameras.reduction import Reduction
from blender_nep.cameras.still_surroundings import SIDE, look_for_still_surroundings
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


def test_photos_of_a_plain_backdrop_tell_nothing(tmp_path):
    for number in range(12):
        pixels = np.full((90, 120), 230, np.uint8)
        pixels[30:60, 40:80] = np.random.default_rng(number).integers(0, 255, (30, 40))
        Image.fromarray(pixels).save(tmp_path / f"{number:02d}.png")
    assert not look_for_still_surroundings(find_photos(tmp_path)).turntable


def test_the_comparison_can_be_stopped(turned):
    def check():
        raise Stopped("stopped")

    with pytest.raises(Stopped):
        look_for_still_surroundings(find_photos(turned[0]), check)


def searched(folder, out):
    """The exit code, the codes of what is said, and those of the warnings."""
    protocol = io.StringIO()
    code = camera_search.run(CameraSearch(folder, out), Events(protocol, io.StringIO()), StopRequest())
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
