"""Captures and outputs that cannot work: one clear message, the documented exit code, nothing left behind."""

from __future__ import annotations

import io
import json

import numpy as np
import pytest
from PIL import Image

from blender_nep.capture import load_capture
from blender_nep.errors import NepError
from blender_nep.job import runner as job
from blender_nep.job.reporting.events import Events
from blender_nep.presets import preset
from blender_nep.stop_request import StopRequest
from support.ball_stages import BallStages
from support.captures import CENTER, write_exr


def remove_photos(tiny):
    for number in range(2, len(tiny.meta["frames"])):
        (tiny.folder / f"images/{number:03d}.exr").unlink()


def remove_mask(tiny):
    (tiny.folder / "masks/001.png").unlink()


def no_transforms(tiny):
    (tiny.folder / "transforms.json").unlink()


def broken_json(tiny):
    (tiny.folder / "transforms.json").write_text('{"frames": [')


def list_json(tiny):
    (tiny.folder / "transforms.json").write_text("[]")


def no_frames(tiny):
    tiny.meta["frames"] = []
    tiny.save()


def one_view(tiny):
    tiny.meta["frames"] = tiny.meta["frames"][:1]
    tiny.save()


def no_file_path(tiny):
    del tiny.meta["frames"][1]["file_path"]
    tiny.save()


def nan_photo(tiny):
    write_exr(tiny.folder / "images/001.exr", np.full((24, 24, 3), np.nan, np.float32))


def black_photos(tiny):
    for path in (tiny.folder / "images").iterdir():
        write_exr(path, np.zeros((24, 24, 3), np.float32))


def torn_photo(tiny):
    path = tiny.folder / "images/003.exr"
    path.write_bytes(path.read_bytes()[:500])


def text_as_photo(tiny):
    (tiny.folder / "images/003.exr").write_text("not an image")


def other_format(tiny):
    (tiny.folder / "images/000.exr").rename(tiny.folder / "images/000.tga")
    tiny.meta["frames"][0]["file_path"] = "images/000.tga"
    tiny.save()


def other_aspect(tiny):
    tiny.meta["w"] = 40
    tiny.save()


def other_mask_size(tiny):
    Image.fromarray(np.zeros((12, 20), np.uint8)).save(tiny.folder / "masks/001.png")


def empty_masks(tiny):
    for path in (tiny.folder / "masks").iterdir():
        Image.fromarray(np.zeros((24, 24), np.uint8)).save(path)


def no_focal_length(tiny):
    del tiny.meta["fl_x"], tiny.meta["fl_y"]
    tiny.save()


def text_focal_length(tiny):
    tiny.meta["fl_x"] = "long"
    tiny.save()


def scaled_matrix(tiny):
    matrix = np.array(tiny.meta["frames"][2]["transform_matrix"])
    matrix[:3, :3] *= [1, 2, 1]
    tiny.meta["frames"][2]["transform_matrix"] = matrix.tolist()
    tiny.save()


def mirrored_matrix(tiny):
    matrix = np.array(tiny.meta["frames"][2]["transform_matrix"])
    matrix[:3, 0] *= -1
    tiny.meta["frames"][2]["transform_matrix"] = matrix.tolist()
    tiny.save()


def nan_matrix(tiny):
    for frame in tiny.meta["frames"][2:]:
        frame["transform_matrix"][0][3] = float("nan")
    tiny.save()


def short_matrix(tiny):
    tiny.meta["frames"][2]["transform_matrix"] = [[1, 0, 0], [0, 1]]
    tiny.save()


def same_place(tiny):
    for frame in tiny.meta["frames"]:
        frame["transform_matrix"] = tiny.meta["frames"][0]["transform_matrix"]
    tiny.save()


def panorama(tiny):
    tiny.meta["camera_model"] = "EQUIRECTANGULAR"
    tiny.save()


def fisheye_with_tangential_terms(tiny):
    tiny.meta |= {"camera_model": "OPENCV_FISHEYE", "p1": 0.01}
    tiny.save()


def text_as_distortion(tiny):
    tiny.meta["k1"] = "strong"
    tiny.save()


def negative_radius(tiny):
    tiny.meta["object_radius"] = -1
    tiny.save()


def camera_inside(tiny):
    tiny.meta["object_radius"] = 2.6
    tiny.save()


def sphere_out_of_sight(tiny):
    tiny.meta["object_center"] = [CENTER[0], CENTER[1], CENTER[2] + 60]
    tiny.save()


def sphere_beside_the_object(tiny):
    tiny.meta |= {"object_center": [CENTER[0], CENTER[1], CENTER[2] + 0.75], "object_radius": 0.1}
    tiny.save()


CASES = [
    (remove_photos, 3, "photos of transforms.json are missing, the first: images/002.exr"),
    (remove_mask, 3, "001.png is missing"),
    (no_transforms, 3, "has no transforms.json"),
    (broken_json, 3, "cannot be read"),
    (list_json, 3, "does not hold a JSON object"),
    (no_frames, 3, "no frames"),
    (one_view, 3, "1 photo: at least 3"),
    (no_file_path, 3, "frame 1 has no file_path"),
    (nan_photo, 3, "001.exr holds no finite pixel"),
    (black_photos, 3, "all photos are black"),
    (torn_photo, 3, "003.exr cannot be read as an image"),
    (text_as_photo, 3, "003.exr cannot be read as an image"),
    (other_format, 3, "photos can be read"),
    (other_aspect, 3, "is 24 x 24 pixels, but transforms.json says 40 x 24"),
    (other_mask_size, 3, "001.png is 20 x 12 pixels, but its photo is 24 x 24"),
    (empty_masks, 3, "masks are empty"),
    (no_focal_length, 3, "no focal length"),
    (text_focal_length, 3, "fl_x is not a number"),
    (scaled_matrix, 3, "not rigid"),
    (mirrored_matrix, 3, "mirrors"),
    (nan_matrix, 3, "not a 4 x 4 matrix"),
    (short_matrix, 3, "not a 4 x 4 matrix"),
    (same_place, 3, "same place"),
    (panorama, 3, "EQUIRECTANGULAR is not supported"),
    (fisheye_with_tangential_terms, 3, "has no p1 and p2"),
    (text_as_distortion, 3, "k1 is not a number"),
    (negative_radius, 3, "object_radius"),
    (camera_inside, 4, "cameras stand inside the object's sphere"),
    (sphere_out_of_sight, 4, "no photo sees the object's sphere"),
    (sphere_beside_the_object, 4, "contains nothing"),
]


def reconstruct(folder, out, **keywords):
    """Exit code, events and text for people of a job with stages that would succeed."""
    protocol, human = io.StringIO(), io.StringIO()
    settings = job.Settings(folder, out, preset("preview"), **keywords)
    code = job.run(settings, Events(protocol, human), StopRequest(), BallStages())
    return code, [json.loads(line) for line in protocol.getvalue().splitlines()], human.getvalue()


@pytest.mark.parametrize(("spoil", "code", "message"), CASES, ids=[c[0].__name__ for c in CASES])
def test_a_bad_capture_gives_one_message_and_no_asset(make_capture, tmp_path, spoil, code, message):
    tiny = make_capture(masks=True)
    spoil(tiny)
    out = tmp_path / "asset"
    got, events, text = reconstruct(tiny.folder, out)
    errors = [e for e in events if e["event"] == "error"]
    assert got == code and len(errors) == 1 and errors[0]["code"] == code
    assert message in errors[0]["message"] and "\n" not in errors[0]["message"]
    assert text.count("error:") == 1 and "Traceback" not in text
    assert not out.exists()


def test_an_empty_folder_and_no_folder(tmp_path):
    (tmp_path / "empty").mkdir()
    code, events, _ = reconstruct(tmp_path / "empty", tmp_path / "asset")
    assert code == 3 and "is empty" in events[-1]["message"]
    code, events, _ = reconstruct(tmp_path / "nowhere", tmp_path / "asset")
    assert code == 3 and "no folder" in events[-1]["message"]
    assert not (tmp_path / "asset").exists()


def test_parallel_cameras_need_a_given_sphere(make_capture):
    tiny = make_capture(bounds=False)
    for i, frame in enumerate(tiny.meta["frames"]):
        matrix = np.array(tiny.meta["frames"][0]["transform_matrix"])
        matrix[0, 3] += i
        frame["transform_matrix"] = matrix.tolist()
    with pytest.raises(NepError, match="parallel") as caught:
        load_capture(tiny.save())
    assert caught.value.code == 4 and "object_center" in caught.value.hint


def test_out_that_is_a_file_or_below_one(make_capture, tmp_path):
    folder = make_capture().folder
    (tmp_path / "file").write_text("mine")
    for out in (tmp_path / "file", tmp_path / "file" / "asset"):
        code, events, _ = reconstruct(folder, out)
        assert code == 5 and events[-1]["event"] == "error"
    assert (tmp_path / "file").read_text() == "mine"


def test_an_unusable_mesh_is_refused_before_anything_is_learned(make_capture, tmp_path):
    (tmp_path / "flat.obj").write_text("v 0 0 0\nv 0.5 0 0\nv 0.2 0 0\nf 1 2 3\n")
    code, events, _ = reconstruct(make_capture().folder, tmp_path / "asset", mesh=tmp_path / "flat.obj")
    assert code == 3 and "flat.obj" in events[-1]["message"]
    assert {event["stage"] for event in events if event["event"] == "progress"} <= {"capture"}


def test_a_missing_mesh(make_capture, tmp_path):
    code, events, _ = reconstruct(make_capture().folder, tmp_path / "asset", mesh=tmp_path / "no.obj")
    assert code == 2 and "no.obj" in events[-1]["message"] and not (tmp_path / "asset").exists()


def test_a_missing_cuda_device(make_capture, tmp_path, monkeypatch):
    monkeypatch.setattr(job.torch.cuda, "is_available", lambda: False)
    code, events, _ = reconstruct(make_capture().folder, tmp_path / "asset", device="cuda")
    assert code == 2 and "CUDA" in events[-1]["message"] and not (tmp_path / "asset").exists()
