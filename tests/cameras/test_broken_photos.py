"""Broken captures: each ends in a clear message, or in good cameras and, where something is doubtful, a warning.

A table at the end of the test's output says what came out of each:

    python -m pytest tests/cameras/test_broken_photos.py

It is printed with pytest-xdist, too, but not where the tests of all folders run.
"""

from __future__ import annotations

import ast
import io
import json
import os
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.scoring.cameras import errors
from blender_nep.cameras import structure_from_motion
from blender_nep.cameras.alignment import similarity
from blender_nep.cameras.matching import matching_process
from blender_nep.cameras.object_sphere import ObjectSphere
from blender_nep.cameras.photo_folder import find_photos
from blender_nep.cameras.seen_through import Sightlines
from blender_nep.cameras.structure_from_motion import find_groups
from blender_nep.capture import Capture, load_capture
from blender_nep.capture.cameras.lens import Lens
from blender_nep.errors import BoundsError
from blender_nep.job.commands import camera_search
from blender_nep.job.commands.camera_search import CameraSearch
from blender_nep.job.reporting.events import Events
from support import broken_cameras as cameras
from support import broken_machine as machine
from support import broken_photos as photos
from support.broken_photos import CENTER, COUNT, Room, Shoot

BROKEN = "broken capture"
GAP = "cameras.gap"
"""The room was photographed from one side only."""
ALL, FEW = range(COUNT), range(3)
IMPROVE = {"improve": True, "overwrite": True}
ON_OBJECT = {"features": "object"}


@dataclass(frozen=True)
class Case:
    """A way to break a capture, and what must come out."""

    name: str
    broken: Callable[[Shoot], None]
    search: dict = field(default_factory=dict)
    """Options of the command"""
    code: int = 0
    """Exit code"""
    error: str = ""
    """Name of the error"""
    says: str = ""
    """What the message or the hint must say"""
    placed: int = COUNT
    """Photos that get a camera"""
    photos: range = ALL
    """Photos that there are, before they are broken"""
    warns: dict[str, list[str]] = field(default_factory=dict)
    """{code of a warning: names of photos that it must name}. No other warning may come, but GAP must, without --improve."""
    degrees: float = 0.3
    """How much the cameras may be turned off; for cameras of photos that no warning names"""
    part: float = 0.006
    """How far they may be off, as a part of their distance"""


def few(name: str, broken: Callable[[Shoot], None]) -> Case:
    """A case in which nothing is wrong with the photos. A few serve, and take less time."""
    return Case(name, broken, placed=len(FEW), photos=FEW)


def refused(name: str, broken: Callable[[Shoot], None], code: int, error: str, says: str, **search: object) -> Case:
    return Case(name, broken, search, code, error, says)


NOT_FOUND = "capture.cameras_not_found"
FEW_PLACED = "cameras.many_not_placed"
UNREADABLE = "capture.photo_unreadable"
KINDS = "CMYK, gray, palettes, alpha and 16 bits, one photo of each"
CASES = [
    # files
    refused("a JPEG is cut at half", photos.cut_at_half, 3, UNREADABLE, "photo_03.jpg cannot be read"),
    refused("a photo has zero bytes", photos.empty_file, 3, UNREADABLE, "photo_03.jpg cannot be read"),
    refused("a web page is named .jpg", photos.text_file, 3, UNREADABLE, "photo_03.jpg cannot be read"),
    refused("2 photos", photos.two_photos, 3, "capture.too_few_photos", "at least 3"),
    Case("3 photos", photos.three_photos, placed=3),
    few("Thumbs.db, .DS_Store, a film and more beside the photos", photos.other_files_beside),
    Case(KINDS, photos.kinds_of_pixels),
    # EXIF
    Case("EXIF: all 8 orientations", photos.all_orientations),
    Case("2 photos are mirrored", photos.two_mirrored, placed=6, warns={FEW_PLACED: ["photo_00", "photo_07"]}),
    Case("EXIF: the focal length is 5 times too long", photos.focal_length_too_long),
    Case("EXIF: the focal length is 0", photos.focal_length_zero),
    Case("EXIF: nonsense", photos.nonsense_in_exif),
    # sizes and lenses
    Case("3 photos are scaled to half", photos.half_size, warns={"cameras.unsure": ["photo_00"]}),
    Case("two lenses, which EXIF tells", photos.two_lenses_that_exif_tells),
    refused("two lenses, no EXIF", photos.two_lenses, 3, NOT_FOUND, "no EXIF"),
    Case("one photo is zoomed, no EXIF", photos.one_zoomed, warns={"cameras.unsure": ["photo_07"]}, degrees=1, part=0.02),
    Case("one photo is cropped", photos.one_cropped, warns={"cameras.unsure": ["photo_03"]}),
    # what the photos show
    Case("one photo of another scene", photos.one_stranger, warns={"cameras.not_placed": ["stranger"]}),
    Case(
        "4 photos of another scene and 5 of this one",
        photos.half_strangers,
        placed=5,
        warns={
            FEW_PLACED: [f"z_stranger_{n}" for n in range(4)],
            "cameras.groups": [],
            "cameras.unsure": ["photo_04"],
        },
    ),
    Case("one photo twice", photos.one_twice, placed=9),
    refused("all photos alike", photos.all_alike, 3, NOT_FOUND, "from one place"),
    refused("blank photos", photos.blank, 3, NOT_FOUND, "print"),
    Case("2 photos are blurred", photos.two_blurred, placed=6, warns={FEW_PLACED: ["photo_00", "photo_07"]}),
    Case("every second photo is 3 stops darker", photos.exposures),
    Case("noise", photos.noise, warns={"cameras.unsure": ["photo_00"]}),
    # names and places
    few("spaces, quotes and foreign letters in names", photos.strange_names),
    few("a name that is no Unicode", photos.name_that_is_no_unicode),
    few("a path of over 400 characters", photos.long_path),
    few(".JPG", photos.upper_case),
    few("photos in the folder images, a picture beside it", photos.in_images),
    few("the folder is a symbolic link", photos.symbolic_link),
    # masks
    refused(
        "a mask is upright, and its photo is not",
        photos.upright_mask,
        3,
        "capture.mask_size",
        "photo_03.png is 240 x 320",
        **ON_OBJECT,
    ),
    refused("a mask is missing", photos.one_mask_missing, 2, "usage.no_masks", "photo_03.jpg has none", **ON_OBJECT),
    refused("a mask is torn", photos.torn_mask, 3, UNREADABLE, "photo_07.png cannot be read", **ON_OBJECT),
    # where the cameras are written
    refused("transforms.json is there", machine.cameras_there, 2, "usage.cameras_exist", "--overwrite"),
    few("--out among the photos", machine.out_among_the_photos),
    refused("--out is a file", machine.out_is_a_file, 5, "output.is_a_file", "Choose another --out"),
    refused("--out is below a file", machine.out_below_a_file, 5, "output.is_a_file", "Choose another --out"),
    refused("the folder may not be written", machine.read_only, 5, "output.not_permitted", "another --out"),
    refused("the disk is full at the end", machine.disk_full_at_the_end, 5, "output.disk_full", "run the command again"),
    # the machine
    refused("the disk is full while photos are read", machine.disk_full_before, 5, "output.disk_full", "TMPDIR"),
    refused("the disk is full while matching", machine.disk_full_while_matching, 5, "output.disk_full", "TMPDIR"),
    refused("the disk is full, and pycolmap silent", machine.no_space_for_a_log, 5, "output.disk_full", "TMPDIR"),
    refused("pycolmap is missing", machine.no_pycolmap, 1, "unexpected.no_pycolmap", "pip install pycolmap"),
    refused("pycolmap crashes", machine.crash, 1, "unexpected.pycolmap_failed", "crashed (SIGSEGV)"),
    refused("the system kills pycolmap", machine.killed_by_the_system, 1, "unexpected.no_memory", "Close other programs"),
    few("pycolmap prints to standard output", machine.talking_pycolmap),
    refused("a stop while matching", machine.stop_while_matching, 7, "stopped.cameras", "Nothing was written"),
    # captures that have cameras
    refused("transforms.json is cut at half", cameras.cut_transforms, 3, "capture", "must be JSON", **IMPROVE),
    refused("a photo of a capture is cut at half", cameras.cut_photo, 3, UNREADABLE, "photo_03.jpg", **IMPROVE),
    refused(
        "the photos of a capture are blank", cameras.blank_photos, 3, "capture.cameras_not_improved", "0 of 8", **IMPROVE
    ),
    refused(
        "one matrix mirrors", cameras.one_mirrored_matrix, 3, "capture", "photo_03.jpg: transform_matrix mirrors", **IMPROVE
    ),
    refused("all matrices mirror", cameras.mirrored_matrices, 3, "capture", "right-handed", **IMPROVE),
    refused(
        "places are mirrored, rotations are not",
        cameras.mirrored_places,
        3,
        "capture.cameras_not_improved",
        "mirrored",
        **IMPROVE,
    ),
    Case("cameras look along +z", cameras.opencv_axes, IMPROVE, warns={"capture.opencv_axes": []}),
    refused("a lens that COLMAP does not know", cameras.wide_fisheye, 3, "capture.lens_not_improved", "anew", **IMPROVE),
    Case("cameras and sphere in millimeters", cameras.all_in_millimeters, IMPROVE),
    Case("cameras in millimeters, the sphere in meters", cameras.millimeters, IMPROVE, warns={"capture.cameras_far": []}),
    refused("cameras in kilometers, the sphere in meters", cameras.kilometers, 4, "bounds", "inside the object", **IMPROVE),
    Case("one camera in millimeters", cameras.one_far_away, IMPROVE, warns={"cameras.kept": ["photo_03"]}),
    Case("two photos are exchanged", cameras.two_exchanged, IMPROVE, warns={"cameras.kept": ["photo_02"]}),
    Case("the focal length is twice too long", cameras.focal_length_twice, IMPROVE),
]


SLOW = {
    *("EXIF: the focal length is 5 times too long", "EXIF: the focal length is 0"),
    *("EXIF: nonsense", "two lenses, which EXIF tells", "two lenses, no EXIF", "one photo is zoomed, no EXIF"),
    *("one photo is cropped", "one photo of another scene", "one photo twice", "all photos alike", "2 photos are blurred"),
    *("every second photo is 3 stops darker", "noise", ".JPG", "a path of over 400 characters", "--out among the photos"),
    *("photos in the folder images, a picture beside it", "the folder is a symbolic link", "the disk is full at the end"),
    *("pycolmap prints to standard output", "places are mirrored, rotations are not", "two photos are exchanged"),
    *("the focal length is twice too long", "cameras look along +z", "2 photos are mirrored"),
    "cameras in millimeters, the sphere in meters",
}
"""Cases that search for cameras in 1 to 3 CPU seconds. Of each way in which such a search ends, a quick case stays."""


@pytest.fixture(scope="module")
def room():
    return Room.photographed()


@pytest.fixture
def shoot(room, tmp_path, monkeypatch):
    """The photos on the disk, ready to be broken. Temporary files go to the folder `temporary` beside them."""
    for name in ("spare", "temporary"):
        (tmp_path / name).mkdir()
    made = Shoot(room, tmp_path / "photos", tmp_path / "spare", monkeypatch)
    monkeypatch.setattr(camera_search, "find_object_sphere", sphere_of_cameras)
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "temporary"))
    return made


def sphere_of_cameras(capture: Capture, lines: Sightlines, check: Callable[[int, int], None]) -> ObjectSphere:
    """The sphere that the cameras suggest. The search for a better one takes longer than all else of a case."""
    return ObjectSphere(capture.object_center, capture.object_radius, True)


class StoppingEvents(Events):
    """Events of a user who asks for a stop at a certain step."""

    def __init__(self, protocol: io.StringIO, shoot: Shoot) -> None:
        super().__init__(protocol)
        self._shoot = shoot

    def progress(self, *values, **more):
        super().progress(*values, **more)
        note = values[6] if len(values) > 6 else None
        if note is not None and note.code == self._shoot.stop_at:
            self._shoot.stop.request("test")


def run(shoot: Shoot, **options: object) -> tuple[int, list[dict]]:
    """(exit code, events) of the command. One thread, because several give no equal results."""
    said = io.StringIO()
    wanted = CameraSearch(shoot.folder, shoot.out, threads=1, **options)
    code = camera_search.run(wanted, StoppingEvents(said, shoot), shoot.stop)
    return code, [json.loads(line) for line in said.getvalue().splitlines()]


def contents(folder: Path) -> dict[Path, bytes]:
    """All files below a folder, without what Python keeps of a played pycolmap."""
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file() and path.parent.name != "__pycache__"}


def named(events: list[dict]) -> dict[str, list[str]]:
    """{code of a warning: names of the photos that it names, without endings}."""
    warnings = [event for event in events if event["event"] == "warning"]
    texts = {w["code"]: w["values"].get("names") or w["values"].get("list", "").split(", ") for w in warnings}
    return {code: [Path(name).stem for name in names if name] for code, names in texts.items()}


def accuracy(shoot: Shoot, doubtful: set[str]) -> tuple[int, dict[str, float], float]:
    """(photos with cameras, their errors, degrees between up and z); errors of doubtful photos do not count."""
    truth = {path.resolve(): true for path, true in zip(shoot.files, shoot.truth, strict=True)}
    views = load_capture(shoot.out or shoot.folder, use_masks=False).views
    assert len({view.image_path.resolve() for view in views} & set(truth)) == len(views), "a photo without a true camera"
    pairs = [(view.camera, truth[view.image_path.resolve()]) for view in views if view.image_path.stem not in doubtful]
    found, true = zip(*pairs, strict=True)
    up = similarity(found, true)[0] @ [0, 0, 1]
    return len(views), errors(found, true, CENTER), float(np.degrees(np.arccos(min(1.0, up[2]))))


@pytest.mark.parametrize(
    "case", [pytest.param(case, id=case.name, marks=[pytest.mark.slow] * (case.name in SLOW)) for case in CASES]
)
def test_a_broken_capture(shoot, case, tmp_path, record_property):
    shoot.keep(case.photos)
    case.broken(shoot)
    before = contents(tmp_path)
    code, events = run(shoot, **case.search)
    end = events[-1]
    assert code == case.code, end
    assert not list((tmp_path / "temporary").iterdir()), "working files are left"
    after = contents(tmp_path)
    if case.code:
        record_property(BROKEN, (case.name, f"exit {code}: {end['message']}".replace(f"{tmp_path}/", "")))
        assert (end["event"], end["name"], end["code"]) == ("error", case.error, case.code)
        assert case.says in end["message"] + end["hint"]
        assert end["hint"] and "\n" not in end["message"] and "Traceback" not in end["message"] + end["hint"]
        assert "--resume" not in end["hint"] and [event["event"] for event in events].count("error") == 1
        assert after == before, "something was written"
        return
    warned, improve = named(events), case.search == IMPROVE
    doubtful = {name for code, names in warned.items() if code in ("cameras.unsure", "cameras.kept") for name in names}
    count, off, tilt = accuracy(shoot, doubtful)
    words = [f"{code.partition('.')[2]} {' '.join(names)}".strip() for code, names in warned.items() if code != GAP]
    degrees, part = off["rotation_deg_largest"], off["position_largest"]
    figures = f"{count} cameras, off by {degrees:.2f} degrees and {100 * part:.2f} %"
    record_property(BROKEN, (case.name, "; ".join([figures, *(f"warning: {text}" for text in words)])))
    assert warned == case.warns | ({} if improve else {GAP: []})
    assert count == case.placed and degrees < case.degrees and part < case.part
    assert improve or tilt < 3
    new = {path for path in after if after[path] != before.get(path)}
    kept_as_given = improve and any(line["code"] == "cameras.good_as_given" for line in events[-3]["lines"])
    written = (shoot.out or shoot.folder).resolve() / "transforms.json"
    replaced = {written.with_name("transforms.before.json")} if written in before else set()
    assert new == (set() if kept_as_given else {written} | replaced)


@pytest.mark.parametrize(
    "lens",
    [
        Lens(k1=-0.1, k2=0.02),
        Lens(k1=-0.1, k2=0.02, k3=0.01, p1=0.001, p2=-0.002),
        Lens(k1=-0.1, k2=0.02, k3=0.01, k4=0.003, fisheye=True),
    ],
)
def test_every_lens_is_written_as_it_is(shoot, lens):
    shoot.capture([replace(camera, lens=lens) for camera in shoot.truth])
    assert {view.camera.lens for view in load_capture(shoot.folder).views} == {lens}


def test_no_sphere_around_the_object(shoot, monkeypatch):
    """The cameras are good all the same."""

    def refuse(capture, lines, check):
        raise BoundsError("no photo sees the object's sphere")

    monkeypatch.setattr(camera_search, "find_object_sphere", refuse)
    shoot.keep(FEW)
    code, events = run(shoot)
    assert code == 0 and "cameras.sphere_unsure" in named(events)
    assert load_capture(shoot.folder).object_radius == 1


def test_progress_is_counted_while_pycolmap_writes(shoot, tmp_path, monkeypatch):
    """A second SQLite in the process of pycolmap would release its locks. One in this process harms nothing."""
    monkeypatch.setattr(structure_from_motion, "_POLL_S", 0.005)
    monkeypatch.setattr(structure_from_motion, "_LOOK_S", 0.005)
    steps = set()
    groups = find_groups(
        find_photos(shoot.folder), tmp_path / "temporary", lambda *step: steps.add(step), shoot.stop, threads=1
    )
    assert len(groups[0].placed) == COUNT
    assert [step for step in steps if step[0] == "features" and 0 < step[1] < COUNT]
    folder = Path(matching_process.__file__).parent
    for name in ("matching_process", "feature_matching", "mapping", "adjustment", "given_adjustment", "matching_output"):
        assert not {"sqlite3", "PIL", "zlib"} & imported(folder / f"{name}.py")


def imported(path: Path) -> set[str]:
    """The modules that a file imports."""
    nodes = list(ast.walk(ast.parse(path.read_text(encoding="utf-8"))))
    names = {alias.name for node in nodes if isinstance(node, ast.Import) for alias in node.names}
    return names | {node.module or "" for node in nodes if isinstance(node, ast.ImportFrom)}


def test_a_folder_that_may_not_be_read(shoot, monkeypatch):
    """Root may read everywhere, so the operating system's refusal is played."""
    real = os.stat

    def list_nothing(*_):
        raise PermissionError(13, "Permission denied")

    def look(path, *rest, **more):
        return list_nothing() if Path(os.fsdecode(path)).parent == shoot.folder else real(path, *rest, **more)

    monkeypatch.setattr(Path, "iterdir", list_nothing)
    monkeypatch.setattr(os, "stat", look)
    code, events = run(shoot)
    assert (code, events[-1]["name"]) == (3, "capture.folder_unreadable")


def test_no_folder_for_temporary_files(shoot, tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "missing"))
    code, events = run(shoot)
    assert (code, events[-1]["name"]) == (5, "output.no_working_files") and "TMPDIR" in events[-1]["hint"]
