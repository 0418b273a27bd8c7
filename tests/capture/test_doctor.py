"""The doctor (`blender-nep info`): each fault of a capture is found and named, and a healthy capture gets no warning."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image
from scipy.ndimage import gaussian_filter, uniform_filter1d

from blender_nep.capture import PixelRays, load_capture
from blender_nep.capture.doctor import summary
from blender_nep.capture.doctor.coverage import Coverage
from blender_nep.capture.doctor.coverage_picture import LIMITS, SHADES, SIZE, draw_coverage, place, shade
from blender_nep.capture.doctor.sharpness import blurred
from blender_nep.capture.doctor.summary import describe, summarize
from blender_nep.capture.doctor.turntable import MOST_STILL, still_share
from blender_nep.capture.exposure import from_exif
from blender_nep.capture.exposure.surroundings import compare_exposures
from blender_nep.capture.turntable import motions
from blender_nep.cli import main
from support.captures import look_at, write_exr
from support.exposures import find_exposures
from support.paths import SUZANNE_SMALL
from support.printed_room import printed

WIDE, FOCAL, BALL, ROOM = 96, 120.0, 0.6, 6.0
"""Pixels of a photo's side, focal length in pixels, radius of the ball, and radius of the round room with a print"""
FAULTS = {
    "capture.on_turntable",
    "capture.photos_blurred",
    "capture.photos_darker",
    "capture.photos_brighter",
    "capture.sphere_clipped",
    "capture.cameras_look_away",
    "capture.cameras_near",
    "capture.cameras_distant",
    "capture.sphere_small",
    "capture.sphere_at_edges",
    "capture.hole_above",
    "capture.hole_beside",
    "capture.exposure_unclear",
}
"""What the doctor warns of"""
ROLL = np.array([[0.0, -1, 0, 0], [1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
"""Turns a camera about its axis, to portrait"""


def around(elevations, turns, distance=3.2) -> list[np.ndarray]:
    """Cameras [4, 4] at these elevations and at these azimuths, in degrees; all look at the origin."""
    found = []
    for up in np.radians(elevations):
        for turn in np.radians(turns):
            place = [math.cos(turn) * math.cos(up), math.sin(turn) * math.cos(up), math.sin(up)]
            found.append(look_at(distance * np.array(place), np.zeros(3)))
    return found


def rays_of(matrix: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Origin [3] and unit directions [n, 3] of a camera's pixels."""
    row, column = np.mgrid[:WIDE, :WIDE].reshape(2, -1) + 0.5
    local = np.stack([(column - WIDE / 2) / FOCAL, (WIDE / 2 - row) / FOCAL, -np.ones_like(row)], -1)
    return matrix[:3, 3], local / np.linalg.norm(local, axis=1, keepdims=True) @ matrix[:3, :3].T


def room(origin: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """What the walls of a round room with a print show, [n, 3]."""
    along = direction @ origin
    point = origin + (-along + np.sqrt(along**2 - origin @ origin + ROOM**2))[:, None] * direction
    return printed(point / 3, 0)[:, None] * [0.5, 0.45, 0.4]


def studio(origin: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """A white sweep, darker towards one side and towards the floor."""
    return (0.8 + 0.5 * direction[:, 1:2] + 0.4 * direction[:, 2:]) * np.ones(3)


def field(origin: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """A plain floor under a sky with a sharp horizon: it looks the same from all sides."""
    return np.where(direction[:, 2:] < 0, [0.1, 0.2, 0.1], 0.5 + 0.4 * direction[:, 2:])


def photo(matrix: np.ndarray, surroundings=room, behind: np.ndarray | None = None) -> np.ndarray:
    """A photo [H, W, 3] of a printed ball. The surroundings are those that the camera `behind` would see."""
    origin, direction = rays_of(matrix)
    color = surroundings(*rays_of(matrix if behind is None else behind))
    along = -(direction @ origin)
    under = along**2 - origin @ origin + BALL**2
    hit = under > 0
    point = origin + (along - np.sqrt(np.maximum(under, 0)))[:, None] * direction
    color[hit] = printed(point[hit], 1)[:, None] * [0.3, 0.5, 0.6]
    color *= 1 + 0.01 * np.random.default_rng(round(1e6 * abs(matrix[0, 3]))).normal(size=color.shape)
    return color.reshape(WIDE, WIDE, 3).astype(np.float32)


def write(folder: Path, cameras: list[np.ndarray], photos: list[np.ndarray], focal=FOCAL, radius=1.0) -> Path:
    """Write a capture with the photos p00, p01 and so on; radius is that of the object's sphere."""
    (folder / "images").mkdir(parents=True)
    frames = []
    for k, (matrix, pixels) in enumerate(zip(cameras, photos, strict=True)):
        write_exr(folder / f"images/p{k:02d}.exr", pixels)
        height, width = pixels.shape[:2]
        size = {"w": width, "h": height, "fl_x": focal, "cx": width / 2, "cy": height / 2}
        frames.append({**size, "file_path": f"images/p{k:02d}.exr", "transform_matrix": matrix.tolist()})
    meta = {"object_center": [0, 0, 0], "object_radius": radius, "frames": frames}
    (folder / "transforms.json").write_text(json.dumps(meta))
    return folder


CAMERAS = around((5, 40), np.arange(0, 360, 30)) + around((70,), (0, 120, 240))
"""27 cameras that leave no hole but the one below"""


@pytest.fixture(scope="module")
def photos():
    return [photo(matrix) for matrix in CAMERAS]


def pixels_of(folder: Path, use_masks: bool = True) -> PixelRays:
    return PixelRays.from_capture(load_capture(folder), 40_000, use_masks)


def warned(folder: Path) -> dict[str, dict]:
    """{code of a warning: its values}, for the faults."""
    return {found["code"]: found["values"] for found in summarize(folder)["warnings"] if found["code"] in FAULTS}


def names(values: dict) -> list[str]:
    return values["names"]


def test_a_healthy_capture_is_called_healthy(tmp_path, photos):
    folder = write(tmp_path / "a", CAMERAS, photos)
    found = summarize(folder)
    assert [w["code"] for w in found["warnings"]] == ["capture.sphere_small"], "the sphere is 79 pixels wide"
    assert found["surroundings_still"] == 0 and found["z_up"] and found["sphere_cut"] == 0
    assert found["sphere_width"] == pytest.approx(2 * FOCAL * math.tan(math.asin(1 / 3.2)), abs=0.1)
    assert found["largest_hole"]["code"] == "capture.hole_below" and found["largest_hole"]["values"]["degrees"] > 84
    text = describe(found)
    assert "straight below" in text and "nothing looks wrong" not in text
    hostile = describe(found | {"folder": "p\n\x1b[2J"})
    assert hostile.startswith("p\\n\\x1b[2J: ") and len(hostile.splitlines()) == len(text.splitlines())


def test_the_capture_in_the_repository_is_healthy():
    assert warned(SUZANNE_SMALL) == {}


# ---------------------------------------------------------------------------------------------------------------- coverage


def test_a_gap_beside_the_object_is_named_with_the_photos_beside(tmp_path, photos):
    cameras = around((10,), np.arange(0, 241, 20))
    found = warned(write(tmp_path / "a", cameras, photos[: len(cameras)]))
    assert set(found) >= {"capture.hole_above"}, "a single ring shows nothing from above"
    cameras = around((10, 45, 75), np.arange(0, 241, 20))
    capture = load_capture(write(tmp_path / "b", cameras, (2 * photos)[: len(cameras)]))
    hole = Coverage.of(capture).largest_hole(0)
    values = hole.message().values
    assert hole.message().code == "capture.hole_beside"
    assert values["azimuth"] == pytest.approx(300, abs=3) and values["elevation"] < 5
    assert (values["before"], values["after"]) == ("p12", "p00") and values["degrees"] == pytest.approx(60, abs=2)


def test_up_is_up_in_the_photos_if_the_z_axis_is_not(tmp_path, photos):
    cameras = around((10, 50), np.arange(0, 241, 20))
    turn = np.eye(4)
    turn[:3, :3] = [[1, 0, 0], [0, -1, 0], [0, 0, -1]]
    other = np.eye(4)
    other[:3, :3] = [[1, 0, 0], [0, 0, -1], [0, 1, 0]]
    upright = Coverage.of(load_capture(write(tmp_path / "0", cameras, photos[: len(cameras)])))
    for name, by in (("1", turn), ("2", other)):
        moved = [by @ matrix for matrix in cameras]
        found = Coverage.of(load_capture(write(tmp_path / name, moved, photos[: len(cameras)])))
        assert upright.z_up and not found.z_up
        np.testing.assert_allclose(found.directions[:, 2], upright.directions[:, 2], atol=1e-6)
        assert found.largest_hole(0).degrees == pytest.approx(upright.largest_hole(0).degrees, abs=2)


def test_a_camera_that_is_held_upright_does_not_move_up(tmp_path, photos):
    portrait = [matrix @ ROLL for matrix in CAMERAS]
    assert Coverage.of(load_capture(write(tmp_path / "a", portrait, photos))).z_up


def test_the_share_covered_is_that_of_caps():
    one = Coverage(np.array([[0.0, 0, 1]]), ["a"], True)
    assert one.share == pytest.approx((1 - math.cos(math.radians(30))) / 2, abs=0.001)
    assert one.largest_hole().degrees == pytest.approx(180, abs=2)


def test_the_picture_shades_directions_by_the_nearest_photo(tmp_path):
    rng = np.random.default_rng(3)
    directions = rng.normal(size=(12, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    coverage = Coverage(directions, [""] * 12, True)
    picture = np.array(draw_coverage(coverage))
    assert picture.shape == (SIZE[1], SIZE[0], 3)
    probes = rng.normal(size=(3000, 3))
    probes /= np.linalg.norm(probes, axis=1, keepdims=True)
    angle = np.degrees(np.arccos(np.clip(probes @ directions.T, -1, 1))).min(1)
    clear = (np.abs(angle[:, None] - np.array(LIMITS)).min(1) > 1.5) & (np.abs(probes[:, 2]) > 0.05) & (angle > 8)
    hole = coverage.largest_hole().direction
    right = []
    for probe, degrees in zip(probes[clear & (probes @ hole < 0.9)], angle[clear & (probes @ hole < 0.9)], strict=True):
        column, row = (int(value) for value in place(probe))
        expected = SHADES[sum(degrees > limit for limit in LIMITS)]
        right.append(tuple(picture[row, column]) == expected)
    assert len(right) > 1000 and np.mean(right) > 0.97, "the rest lies under circles of elevation"
    assert [tuple(color) for color in shade(np.array([0.0, 20, 100]))] == [SHADES[0], SHADES[1], SHADES[-1]]


def test_directions_have_their_places_in_the_picture():
    (left, row), (right, _) = place(np.array([0.0, 0, 1])), place(np.array([0.0, 0, -1]))
    assert left < right and place(np.array([1.0, 0, 0]))[0] > left and place(np.array([0.0, 1, 0]))[1] < row
    thirty = np.array([math.cos(math.pi / 6), 0, 0.5])
    edge = place(np.array([1.0, 0, 0]))[0] - left
    assert place(thirty)[0] - left == pytest.approx(edge * math.sqrt(0.5)), (
        "half of the hemisphere's area lies above 30 degrees"
    )


def test_info_writes_the_picture(tmp_path, photos, capsys):
    folder = write(tmp_path / "a", CAMERAS, photos)
    assert main(["info", str(folder), "--picture", str(tmp_path / "found.png")]) == 0
    with Image.open(tmp_path / "found.png") as picture:
        assert picture.format == "PNG" and picture.size == SIZE
    assert "degrees of straight below" in capsys.readouterr().out
    assert main(["info", str(folder), "--picture", str(tmp_path / "found.png")]) == 0, "a picture of ours is replaced"
    assert main(["info", str(folder), "--picture", str(tmp_path / "nowhere" / "found.png")]) == 5
    assert "--picture" in capsys.readouterr().err


def test_the_picture_replaces_no_photo(tmp_path, photos, capsys):
    folder = write(tmp_path / "a", CAMERAS, photos)
    photo = next(path for path in folder.rglob("*") if path.suffix in (".exr", ".png"))
    before = photo.read_bytes()
    assert main(["info", str(folder), "--picture", str(photo)]) == 2 and photo.read_bytes() == before
    assert "--picture" in capsys.readouterr().err


# ------------------------------------------------------------------------------------------------------ sharpness, exposure


def test_blurred_photos_are_named(tmp_path, photos):
    bad = list(photos)
    bad[4] = gaussian_filter(bad[4], (1.3, 1.3, 0))
    bad[17] = uniform_filter1d(bad[17], 6, axis=1)
    bad[22] = uniform_filter1d(bad[22], 6, axis=0)
    assert names(warned(write(tmp_path / "a", CAMERAS, bad))["capture.photos_blurred"]) == ["p04", "p17", "p22"]


def test_blur_of_cut_outs_is_seen_on_the_object_alone(tmp_path, photos):
    cut = []
    for k, (matrix, pixels) in enumerate(zip(CAMERAS, photos, strict=True)):
        origin, direction = rays_of(matrix)
        away = np.linalg.norm(origin - (direction @ origin)[:, None] * direction, axis=1)
        alpha = (away < BALL).reshape(WIDE, WIDE, 1).astype(np.float32)
        pixels = gaussian_filter(pixels, (1.5, 1.5, 0)) if k == 8 else pixels
        cut.append(np.concatenate([pixels * alpha, alpha], -1))
    rays = pixels_of(write(tmp_path / "a", CAMERAS, cut))
    assert not rays.background and blurred(rays) == [8]
    assert still_share(rays) is None and compare_exposures(rays) is None


def test_photos_of_another_exposure_are_named(tmp_path, photos):
    bad = [k * pixels for k, pixels in zip([1, 1, 2.6, *21 * [1], 0.3, 1, 1], photos, strict=True)]
    found = warned(write(tmp_path / "a", CAMERAS, bad))
    assert names(found["capture.photos_brighter"]) == ["p02"] and names(found["capture.photos_darker"]) == ["p24"]
    assert found["capture.photos_brighter"]["stops"] == pytest.approx(math.log2(2.6), abs=0.25)
    assert found["capture.photos_darker"]["stops"] == pytest.approx(-math.log2(0.3), abs=0.25)


@pytest.mark.slow
def test_automatic_exposure_is_no_fault(tmp_path, photos):
    gain = 2 ** np.random.default_rng(1).uniform(-0.9, 0.9, len(photos))
    folder = write(tmp_path / "a", CAMERAS, [k * pixels for k, pixels in zip(gain, photos, strict=True)])
    found = summarize(folder)
    assert not {w["code"] for w in found["warnings"]} & {"capture.photos_brighter", "capture.photos_darker"}
    assert found["exposure_stops"] == pytest.approx(np.ptp(np.log2(gain)), abs=0.3)
    rays = pixels_of(folder)
    assert torch.equal(find_exposures(rays).gain, compare_exposures(rays).exposures().gain)


def test_burnt_out_pixels_are_told(tmp_path, photos):
    found = warned(write(tmp_path / "a", CAMERAS, [np.minimum(3 * pixels, 1) for pixels in photos]))
    assert found["capture.sphere_clipped"]["percent"] > 5


# ------------------------------------------------------------------------------------------------------------------ cameras


def test_cameras_that_look_away_or_stand_elsewhere_are_named(tmp_path, photos):
    cameras = [matrix.copy() for matrix in CAMERAS]
    cameras[3] = look_at(cameras[3][:3, 3], np.array([0, 0, 1.6]))
    cameras[6][:3, 3] *= 0.45
    cameras[9][:3, 3] *= 3
    found = warned(write(tmp_path / "a", cameras, photos))
    assert names(found["capture.cameras_look_away"]) == ["p03"]
    assert names(found["capture.cameras_near"]) == ["p06"] and names(found["capture.cameras_distant"]) == ["p09"]


def test_the_size_of_the_sphere_is_judged(tmp_path, photos):
    found = summarize(write(tmp_path / "a", CAMERAS, photos, radius=1.6))
    assert found["sphere_cut"] == 1
    assert {w["code"] for w in found["warnings"]} >= {"capture.sphere_at_edges", "capture.sphere_small"}
    found = summarize(write(tmp_path / "b", CAMERAS, photos, focal=500.0, radius=0.6))
    assert "capture.sphere_small" not in {w["code"] for w in found["warnings"]} and found["sphere_width"] > 150


# ---------------------------------------------------------------------------------------------------------------- turntable


def on_turntable(elevations, turns=tuple(range(0, 360, 30)), surroundings=room) -> tuple[list, list]:
    """Cameras relative to an object that turns before one fixed camera for each elevation, and their photos."""
    cameras, found = [], []
    for up in elevations:
        row = around((up,), turns)
        cameras += row
        found += [photo(matrix, surroundings, behind=row[0]) for matrix in row]
    return cameras, found


@pytest.mark.parametrize(
    "elevations",
    [pytest.param((20,), id="one height"), pytest.param((0, 25, 50), id="three heights", marks=pytest.mark.slow)],
)
def test_a_turntable_is_recognized(tmp_path, elevations):
    cameras, found = on_turntable(elevations)
    gain = 2 ** np.random.default_rng(0).normal(0, 0.3, len(found))
    folder = write(tmp_path / "a", cameras, [k * pixels for k, pixels in zip(gain, found, strict=True)])
    assert warned(folder)["capture.on_turntable"]["percent"] == pytest.approx(100)


def test_a_turntable_whose_platter_is_seen_is_recognized(tmp_path):
    cameras, found = on_turntable((20,))
    for matrix, pixels in zip(cameras, found, strict=True):
        pixels[70:] = photo(matrix)[70:]
    assert still_share(pixels_of(write(tmp_path / "a", cameras, found))) > MOST_STILL


def test_exposures_of_a_turntable_are_compared_in_the_room(tmp_path):
    cameras, found = on_turntable((20,))
    gain = 2 ** np.random.default_rng(0).normal(0, 0.3, len(found))
    capture = load_capture(write(tmp_path / "a", cameras, [k * pixels for k, pixels in zip(gain, found, strict=True)]))
    rays = PixelRays.from_capture(capture, 10**6, use_masks=False)
    turned = motions.on_turntable(capture).capture
    still = rays.with_turntable(motions.in_unit_frame(turned, turned.views[0]))
    log = compare_exposures(still).log.mean(1)
    assert np.abs(log - (np.log(gain) - np.log(gain).mean())).max() < 0.02


def test_a_photo_that_a_job_leaves_out_is_no_hindrance(tmp_path):
    """The exposures of the others are still compared in the room."""
    cameras, found = on_turntable((20,))
    cameras[5], found[5] = around((60,), (200,), 4.5)[0], found[5]
    gain = 2 ** np.linspace(-0.5, 0.5, len(found))
    folder = write(tmp_path / "a", cameras, [k * pixels for k, pixels in zip(gain, found, strict=True)])
    facts = summarize(folder)
    said = {w["code"]: w["values"] for w in facts["warnings"]}
    assert said["capture.turntable_left_out"]["count"] == 1 and facts["turntable"] is True
    assert facts["exposure_stops"] == pytest.approx(1, abs=0.1)
    assert "the object turned" in describe(facts)


def test_two_rows_of_a_turntable_are_said_to_be_on_one_side(tmp_path):
    cameras, found = on_turntable((10, 40))
    warnings = summarize(write(tmp_path / "a", cameras, found), turntable=True)["warnings"]
    assert [w["values"]["rows"] for w in warnings if w["code"] == "capture.turntable_side"] == [2]


def test_cameras_that_fit_no_turntable_are_described_anyhow(tmp_path, capsys):
    """A job would end. `info` says all that it knows, and that."""
    _, found = on_turntable((20,))
    rng = np.random.default_rng(0)
    walk = [around((float(rng.uniform(0, 60)),), (turn,), rng.uniform(3, 4))[0] for turn in range(0, 360, 30)]
    folder = write(tmp_path / "a", walk, found)
    facts = summarize(folder)
    said = {w["code"]: w["values"] for w in facts["warnings"]}
    assert "of 12 photos" in said["capture.turntable_unfit"]["reason"] and facts["turntable"] is True
    assert summarize(folder, turntable=False)["turntable"] is False
    assert main(["info", str(folder), "--json", "--turntable", "no"]) == 0
    codes = {w["code"] for w in json.loads(capsys.readouterr().out)["warnings"]}
    assert not {"capture.on_turntable", "capture.turntable_unfit"} & codes


def test_equal_exposures_that_exif_tells_are_known(tmp_path, monkeypatch):
    """The photos share too little, but their files tell the same."""
    folder = write(tmp_path / "a", CAMERAS[:3], [photo(matrix) for matrix in CAMERAS[:3]])
    monkeypatch.setattr(summary, "compare_exposures", lambda rays: None)
    assert summarize(folder)["exposure_stops"] is None
    monkeypatch.setattr(from_exif, "exif_exposure", lambda path: (0.01, 8.0, 100.0))
    assert summarize(folder)["exposure_stops"] == 0


def test_a_walk_around_the_object_is_no_turntable(tmp_path, photos):
    rays = pixels_of(write(tmp_path / "a", CAMERAS, photos))
    assert still_share(rays) == 0


@pytest.mark.parametrize("surroundings", [studio, field], ids=["white sweep", "floor and sky"])
@pytest.mark.parametrize("turned", [False, True], ids=["walk", "turntable"])
@pytest.mark.parametrize("portrait", [False, True], ids=["landscape", "portrait"])
def test_plain_surroundings_do_not_tell_a_turntable(tmp_path, surroundings, turned, portrait):
    cameras = [matrix @ ROLL if portrait else matrix for matrix in around((20,), range(0, 360, 30))]
    found = [photo(matrix, surroundings, cameras[0] if turned else None) for matrix in cameras]
    assert still_share(pixels_of(write(tmp_path / "a", cameras, found))) == 0


def test_cut_outs_do_not_tell_a_turntable(tmp_path):
    cameras, found = on_turntable((20,))
    plain = np.linalg.norm(np.mgrid[:WIDE, :WIDE] - WIDE / 2, axis=0) > 20
    cut = [np.concatenate([pixels * ~plain[..., None], ~plain[..., None]], -1).astype(np.float32) for pixels in found]
    folder = write(tmp_path / "a", cameras, cut)
    assert still_share(pixels_of(folder)) is None


def test_photos_from_nearly_one_direction_are_not_judged(tmp_path):
    cameras = around((20, 22), range(0, 15, 3))
    assert still_share(pixels_of(write(tmp_path / "a", cameras, [photo(matrix) for matrix in cameras]))) is None


def test_photos_of_two_sizes_are_compared_with_their_like(tmp_path):
    cameras, found = on_turntable((20,))
    cut = [pixels[16:-16] if k % 2 else pixels for k, pixels in enumerate(found)]
    assert still_share(pixels_of(write(tmp_path / "a", cameras, cut))) == 1
