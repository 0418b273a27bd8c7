"""Cameras of photos alone: the photos of a printed room, whose cameras and lens are known."""

import io
import json
import os
import shutil
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from benchmarks.scoring.cameras import errors
from blender_nep.cameras import object_sphere, structure_from_motion
from blender_nep.cameras.alignment import similarity
from blender_nep.cameras.found_cameras import FoundCameras
from blender_nep.cameras.object_sphere import ObjectSphere
from blender_nep.cameras.photo_folder import Photo, find_photos, mask_copy
from blender_nep.cameras.reduction import Reduction
from blender_nep.cameras.structure_from_motion import Group, PlacedPhoto
from blender_nep.cameras.ways import WAYS
from blender_nep.cameras.written_capture import is_written_by_us, write_capture
from blender_nep.capture import load_capture
from blender_nep.errors import CaptureError
from blender_nep.job.commands import camera_search
from blender_nep.job.commands.camera_search import CameraSearch
from blender_nep.job.reporting.events import Events
from blender_nep.stop_request import StopRequest
from support.printed_room import BALLS, FOCAL, LENS, camera, photograph, write_photos
from support.traps import set_traps

COUNT = 16
OTHER_SCENE = 7


def found(photos, out, **options):
    """(exit code, events) of the command."""
    said = io.StringIO()
    code = camera_search.run(CameraSearch(photos, out, **options), Events(said), StopRequest())
    return code, [json.loads(line) for line in said.getvalue().splitlines()]


def one(events, kind):
    return next(event for event in events if event["event"] == kind)


def warnings(events):
    return {event["code"]: event["values"] for event in events if event["event"] == "warning"}


@pytest.fixture(scope="module")
def photos(tmp_path_factory):
    folder = tmp_path_factory.mktemp("room")
    write_photos(folder, COUNT)
    return folder


@pytest.mark.parametrize("kind", ["gray", "opaque RGBA", "alpha", "16 bits"])
def test_a_mask_for_features_is_read_as_that_of_a_capture(tmp_path, kind):
    shown = np.zeros((40, 60), np.uint8)
    shown[10:30, 20:50] = 255
    if kind == "opaque RGBA":
        image = Image.fromarray(np.dstack([shown, shown, shown, np.full_like(shown, 255)]))
    elif kind == "alpha":
        image = Image.fromarray(np.dstack([np.zeros((40, 60, 3), np.uint8), shown]))
    else:
        image = Image.fromarray(shown if kind == "gray" else np.where(shown > 0, 65535, 3000).astype(np.uint16))
    image.save(tmp_path / "mask.png")
    found = mask_copy(Photo(tmp_path / "photo.jpg", 60, 40, None, (), mask=tmp_path / "mask.png"), Reduction.of(60, 40, 60))
    np.testing.assert_array_equal(found, shown > 0)


def test_links_to_photos_stay_links(tmp_path):
    store, folder = tmp_path / "store", tmp_path / "photos"
    store.mkdir()
    folder.mkdir()
    for number in range(4):
        Image.new("RGB", (32, 24), (40 * number, 9, 9)).save(store / "photo.jpg")
        (store / "photo.jpg").rename(store / f"00abab{number}")  # as a store that names files by their content
        (folder / f"IMG_{number}.jpg").symlink_to(store / f"00abab{number}")
    placed = [PlacedPhoto(photo, camera(n, 4), 0, 0.0) for n, photo in enumerate(find_photos(folder))]
    write_capture(FoundCameras(placed, np.zeros((0, 3)), [], np.zeros(3), 1.0), folder)
    written = folder / "transforms.json"
    frames = json.loads(written.read_text())["frames"]
    assert [frame["file_path"] for frame in frames] == [f"IMG_{number}.jpg" for number in range(4)]
    assert is_written_by_us(written)
    for text in (json.dumps({"frames": frames}), "[]", "{"):
        written.write_text(text)
        assert not is_written_by_us(written), "a batch leaves such a file alone"


@pytest.fixture(scope="module")
def search(photos, tmp_path_factory):
    out = tmp_path_factory.mktemp("found")
    code, events = found(photos, out)
    assert code == 0, events[-1]
    return load_capture(out), events


def test_all_photos_are_placed_where_they_were_taken(search):
    capture, events = search
    true = [camera(number, COUNT) for number in range(COUNT)]
    assert [view.image_path.name for view in capture.views] == [f"photo_{n:02d}.jpg" for n in range(COUNT)]
    off = errors([view.camera for view in capture.views], true, np.array(BALLS[0][0]))
    assert off["rotation_deg"] < 0.1 and off["rotation_deg_largest"] < 0.3
    assert off["position"] < 0.003 and off["direction_deg"] < 0.1
    assert not warnings(events)


def test_the_lens_is_found(search):
    lens, true = search[0].views[0].camera, LENS
    assert lens.fl_x == pytest.approx(FOCAL, rel=0.01)
    radius = np.linspace(0, 0.6, 7) ** 2
    bent, truly = (1 + k.k1 * radius + k.k2 * radius**2 for k in (lens.lens, true))
    assert np.abs(bent - truly).max() < 0.005


def test_the_frame_stands_upright_around_what_cameras_look_at(search):
    capture, _ = search
    true = [camera(number, COUNT) for number in range(COUNT)]
    turn, scale, shift = similarity([view.camera for view in capture.views], true)
    assert turn @ [0, 0, 1] == pytest.approx([0, 0, 1], abs=0.03)
    assert shift == pytest.approx(BALLS[0][0], abs=0.15 * BALLS[0][1] + 0.05)
    assert capture.object_radius == 1 and scale > BALLS[0][1]


def test_the_sphere_that_was_found_is_written(photos, tmp_path, monkeypatch):
    room = tmp_path / "photos"
    room.mkdir()
    for path in sorted(photos.iterdir())[:10]:
        shutil.copy(path, room)
    guess = ObjectSphere(np.array([0.1, 0.2, 0.3]), 0.7, sure=False)
    monkeypatch.setattr(camera_search, "find_object_sphere", lambda capture, lines, check: guess)
    code, events = found(room, None)
    capture = load_capture(room)
    assert code == 0 and "cameras.sphere_unsure" in warnings(events)
    assert capture.object_center.tolist() == guess.center.tolist() and capture.object_radius == guess.radius


def test_progress_rises_to_the_end(search):
    fractions = [event["fraction"] for event in search[1] if event["event"] == "progress"]
    assert fractions[-1] == 1 and min(fractions) < 0.2 and len(fractions) > 5


@pytest.mark.slow
def test_a_photo_of_another_scene_is_named_and_left_out(photos, tmp_path):
    room = tmp_path / "photos"
    shutil.copytree(photos, room)
    photograph(camera(5, COUNT), seed=OTHER_SCENE).save(room / "stranger.jpg", quality=95)
    code, events = found(room, None)
    assert code == 0
    assert warnings(events)["cameras.not_placed"]["names"] == ["stranger.jpg"]
    assert len(load_capture(room).views) == COUNT


@pytest.mark.slow
def test_portrait_photos_stand_upright(photos, tmp_path):
    """The stored photos are turned, and EXIF says so. The found cameras fit the stored pixels."""
    room = tmp_path / "photos"
    room.mkdir()
    exif = Image.Exif()
    exif[0x0112] = 6  # the stored image must be turned clockwise
    for path in sorted(photos.iterdir()):
        with Image.open(path) as image:
            image.transpose(Image.Transpose.ROTATE_90).save(room / path.name, quality=95, exif=exif)
    code, _ = found(room, tmp_path / "out")
    assert code == 0
    cameras = [view.camera for view in load_capture(tmp_path / "out").views]
    assert (cameras[0].width, cameras[0].height) == (240, 320)
    up = np.mean([-seen.camera_to_world[:3, 0] for seen in cameras], axis=0)
    assert up[2] / np.linalg.norm(up) > 0.99


@pytest.mark.parametrize("features", ["object", "surroundings"])
def test_masks_say_where_features_count(photos, tmp_path, features):
    """Masks that allow no pixel leave no feature, so no photo can be placed."""
    room = tmp_path / "photos"
    (room / "masks").mkdir(parents=True)
    for path in sorted(photos.iterdir())[:4]:
        shutil.copy(path, room)
        shown = 0 if features == "object" else 255
        Image.new("L", (320, 240), shown).save(room / "masks" / f"{path.stem}.png")
    code, events = found(room, tmp_path / "out", features=features)
    assert code == 3 and one(events, "error")["name"] == "capture.cameras_not_found"


def gray(folder, count):
    for number in range(count):
        Image.new("RGB", (320, 240), (90, 90, 90)).save(folder / f"{number}.png")


def alike(folder, count):
    for number in range(count):
        photograph(camera(0, COUNT)).save(folder / f"{number}.jpg")


def strangers(folder, count):
    for number in range(count):
        photograph(camera(number, COUNT), seed=100 + number).save(folder / f"{number}.jpg")


@pytest.mark.parametrize("write", [gray, *(pytest.param(write, marks=pytest.mark.slow) for write in (alike, strangers))])
def test_photos_that_cannot_be_placed_end_in_a_hint(tmp_path, write):
    write(tmp_path, 5)
    code, events = found(tmp_path, tmp_path / "out")
    error = one(events, "error")
    assert (code, error["name"]) == (CaptureError.code, "capture.cameras_not_found") and "print" in error["hint"]
    assert not (tmp_path / "out").exists()


def test_pycolmap_runs_nothing_from_the_current_folder(tmp_path, monkeypatch):
    """It may hold files of strangers."""
    (tmp_path / "photos").mkdir()
    gray(tmp_path / "photos", 3)
    sprung = set_traps(tmp_path / "stranger", "blender_nep")
    monkeypatch.chdir(sprung.parent)
    started, popen = [], structure_from_motion.subprocess.Popen
    monkeypatch.setattr(
        structure_from_motion.subprocess, "Popen", lambda *a, **named: started.append(named["cwd"]) or popen(*a, **named)
    )
    code, events = found(Path("../photos"), Path("../out"))
    assert (code, one(events, "error")["name"]) == (3, "capture.cameras_not_found")
    assert not sprung.exists() and started == [os.path.abspath(os.sep)] * len([way for way in WAYS if way.least_photos <= 3])


@pytest.mark.parametrize(
    ("count", "name"), [(0, "capture.too_few_photos"), (2, "capture.too_few_photos"), (None, "capture.no_folder")]
)
def test_too_few_photos(tmp_path, count, name):
    folder = tmp_path / "photos"
    if count is not None:
        folder.mkdir()
        gray(folder, count)
    code, events = found(folder, None)
    assert (code, one(events, "error")["name"]) == (3, name)


def test_a_broken_photo_is_named(tmp_path):
    gray(tmp_path, 3)
    (tmp_path / "half.png").write_bytes((tmp_path / "0.png").read_bytes()[:60])
    code, events = found(tmp_path, None)
    assert code == 3 and "half.png" in one(events, "error")["message"]


def test_cameras_that_are_there_are_not_replaced_unasked(tmp_path):
    gray(tmp_path, 3)
    (tmp_path / "transforms.json").write_text("mine")
    code, events = found(tmp_path, None)
    assert (code, one(events, "error")["name"]) == (2, "usage.cameras_exist")
    assert (tmp_path / "transforms.json").read_text() == "mine"


def test_features_by_masks_need_masks(tmp_path):
    gray(tmp_path, 3)
    code, events = found(tmp_path, None, features="object")
    assert (code, one(events, "error")["name"]) == (2, "usage.no_masks")


def test_stopping_writes_nothing(photos, tmp_path):
    stop = StopRequest()

    class StoppingEvents(Events):
        def progress(self, stage, step, steps, *rest, **more):
            if rest[3].code == "cameras.features":
                stop.request("test")

    code = camera_search.run(CameraSearch(photos, tmp_path / "out"), StoppingEvents(io.StringIO()), stop)
    assert code == 7 and not (tmp_path / "out").exists()


@pytest.fixture
def known(photos, tmp_path, monkeypatch):
    """A folder with five photos and a file of cameras. Structure from motion finds their true cameras at once."""
    room = tmp_path / "photos"
    room.mkdir()
    for path in sorted(photos.iterdir())[:5]:
        shutil.copy(path, room)
    (room / "transforms.json").write_text("mine")
    group = [PlacedPhoto(p, camera(n, COUNT), 500, 0.2) for n, p in enumerate(find_photos(room))]
    monkeypatch.setattr(camera_search, "find_groups", lambda *_, **__: [Group(group, np.array([BALLS[0][0]]))])
    return room


def test_stopping_while_the_object_is_sought_writes_nothing(known, monkeypatch):
    """The search ends after the next photo, long before anything is learned. The cameras that were there stay."""
    stop = StopRequest()

    class StoppingEvents(Events):
        def progress(self, stage, step, steps, *rest, **more):
            if rest[3].code == "cameras.sphere":
                stop.request("test")

    before = sorted(path.name for path in known.iterdir())
    monkeypatch.setattr(camera_search, "find_object_sphere", object_sphere.find_object_sphere)  # conftest.py has another
    monkeypatch.setattr(object_sphere, "FieldsLearning", lambda *_: pytest.fail("the stop was not heeded"))
    said = io.StringIO()
    assert camera_search.run(CameraSearch(known, overwrite=True), StoppingEvents(said), stop) == 7
    assert "stopped.cameras" in said.getvalue()
    assert (known / "transforms.json").read_text() == "mine" and sorted(path.name for path in known.iterdir()) == before


def test_masks_with_the_names_of_no_photo_are_a_warning(known):
    """The masks of some programs are `PHOTO_mask.png`: these count."""
    (known / "masks").mkdir()
    Image.new("L", (320, 240), 255).save(known / "masks/mask 1.png")
    code, events = found(known, None, overwrite=True)
    first = find_photos(known)[0]
    assert code == 0 and warnings(events)["capture.masks_unmatched"] == {"example": f"{first.path.stem}.png"}
    mask = known / f"masks/{first.path.stem}_mask.png"
    Image.new("L", (320, 240), 255).save(mask)
    code, events = found(known, None, overwrite=True)
    assert code == 0 and "capture.masks_unmatched" not in warnings(events)
    assert find_photos(known)[0].mask == mask


def test_cameras_that_are_replaced_are_kept(known, monkeypatch):
    guess = ObjectSphere(np.zeros(3), 0.7, sure=True)
    monkeypatch.setattr(camera_search, "find_object_sphere", lambda capture, lines, check: guess)
    for kept in ("transforms.before.json", "transforms.before2.json"):
        present = (known / "transforms.json").read_text()
        code, events = found(known, None, overwrite=True)
        told = {line["code"]: line["values"] for line in one(events, "scene")["lines"]}
        assert code == 0 and told["cameras.backup"] == {"file": kept}
        assert (known / kept).read_text() == present
    assert (known / "transforms.before.json").read_text() == "mine" and len(load_capture(known).views) == 5
