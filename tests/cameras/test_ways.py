"""The ladder of ways: which one is taken, and what is said where too few photos are placed."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from blender_nep.cameras import structure_from_motion
from blender_nep.cameras.found_cameras import choose, messages
from blender_nep.cameras.photo_folder import Photo, find_photos
from blender_nep.cameras.structure_from_motion import Group, PlacedPhoto, find_groups
from blender_nep.cameras.ways import WAYS, enough
from blender_nep.errors import CaptureError
from blender_nep.stop_request import StopRequest
from support.printed_room import camera

COUNT = 20


def group(photos, count, way=0):
    placed = [PlacedPhoto(photo, camera(number, COUNT), 500, 0.2) for number, photo in enumerate(photos[:count])]
    return Group(placed, np.zeros((1, 3)), way=way)


@pytest.fixture
def photos(tmp_path):
    return [Photo(tmp_path / f"photo_{number:02d}.jpg", 320, 240, None, ()) for number in range(COUNT)]


@pytest.fixture
def climbed(tmp_path, monkeypatch):
    """A function: photos placed by each way -> (groups, settings of the ways that were taken, reports)."""
    folder = tmp_path / "photos"
    folder.mkdir()
    for number in range(COUNT):
        Image.new("RGB", (32, 24), (9 * number, 9, 9)).save(folder / f"photo_{number:02d}.png")

    def climb(*placed):
        taken, said = [], []
        monkeypatch.setattr(
            structure_from_motion,
            "_run",
            lambda place, *_: taken.append(json.loads((place / "settings.json").read_text(encoding="utf-8"))),
        )
        monkeypatch.setattr(
            structure_from_motion, "_read", lambda place, found, _: [group(found, n) for n in [placed[len(taken) - 1]] if n]
        )
        work = tmp_path / f"work{len(list(tmp_path.iterdir()))}"
        work.mkdir()
        groups = find_groups(find_photos(folder), work, lambda *step: said.append(step), StopRequest(), threads=1)
        return groups, taken, [step for step in said if step[0] == "way"]

    return climb


def test_the_first_way_is_enough_if_it_places_95_percent(climbed):
    groups, taken, said = climbed(19, 20)
    assert (len(groups[0].placed), groups[0].way, len(taken), said) == (19, 0, 1, [])


def test_a_further_way_is_tried_with_too_few_photos(climbed):
    groups, taken, said = climbed(18, 20)
    assert (len(groups[0].placed), groups[0].way, said) == (20, 1, [("way", 18, COUNT)])
    assert [way["first_octave"] for way in taken] == [-1, -1] and taken[1]["features"] > taken[0]["features"]
    assert taken[0]["all_pairs_up_to"] < 66 < taken[1]["all_pairs_up_to"]


def test_the_third_way_adds_to_the_second_ones_features(climbed):
    _, taken, _ = climbed(12, 13, 20)
    assert [way["affine"] for way in taken] == [False, False, True]
    assert [way["earlier"] and Path(way["earlier"]).parent.name for way in taken] == ["", "", "way_1"]


def test_the_way_that_places_most_photos_counts(climbed):
    groups, taken, _ = climbed(12, 11, 11, 11)
    assert (len(groups[0].placed), groups[0].way, len(taken)) == (12, 0, len(WAYS))
    assert climbed(0, 0, 0, 0)[0] == []


def test_large_photos_are_doubled_by_the_second_way_only():
    assert [way.settings(1600, COUNT)["first_octave"] for way in WAYS[:2]] == [0, -1]


def test_less_than_half_of_the_photos_is_an_error(photos):
    with pytest.raises(CaptureError) as raised:
        choose(photos, [group(photos, 9)])
    assert (raised.value.code, raised.value.name) == (3, "capture.cameras_not_found")
    assert raised.value.values["placed"] == 9 and "only 9 of 20" in raised.value.message
    missing = [f"photo_{number:02d}.jpg" for number in range(9, COUNT)]
    assert raised.value.values["names"] == missing
    assert ", ".join(missing) in raised.value.hint, "an artist must know which photos to take out"
    choose(photos, [group(photos, 10)])


@pytest.mark.parametrize(("placed", "code"), [(18, "cameras.many_not_placed"), (19, "cameras.not_placed"), (20, None)])
def test_missing_photos_are_named(photos, placed, code):
    groups = [group(photos, placed)]
    _, warnings = messages(choose(photos, groups), groups)
    said = {warning.code: str(warning) for warning in warnings}
    assert {name for name in said if "placed" in name} == ({code} if code else set())
    if code == "cameras.many_not_placed":
        assert "only 18 of 20" in said[code] and "photo_18.jpg, photo_19.jpg" in said[code]


def test_the_way_is_said_where_it_was_not_the_first(photos):
    found = choose(photos, [group(photos, COUNT)])
    codes = [{said.code for said in messages(found, [replace(group(photos, COUNT), way=way)])[0]} for way in (0, 1, 2)]
    ways = {"cameras.way_all_pairs", "cameras.way_affine"}
    assert [sorted(code & ways) for code in codes] == [[], ["cameras.way_all_pairs"], ["cameras.way_affine"]]


def test_all_but_one_photo_is_enough():
    assert [enough(photos) for photos in (3, 9, 10, 20, 67)] == [2, 8, 9, 19, 64]


def test_few_photos_are_not_given_to_the_third_way(climbed, tmp_path):
    for number in range(15, COUNT):
        (tmp_path / "photos" / f"photo_{number:02d}.png").unlink()
    groups, taken, _ = climbed(9, 10)
    assert len(groups[0].placed) == 10 and [way["affine"] for way in taken] == [False, False]
