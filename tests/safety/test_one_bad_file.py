"""One bad file, such as a pipe, an unknown encoding, NaN or deep nesting, stops nothing but what needs that file."""

from __future__ import annotations

import json
import os
import signal
import sys
from pathlib import Path

import numpy as np
import pytest

from backend import plain_files as blenders
from backend.engine.results.asset_description import describe_asset
from backend.engine.results.asset_materials import read_materials
from backend.engine.results.batch_file import read_batch
from backend.engine.results.capture_contents import has_cameras
from backend.engine.results.job_files import EventFile, is_locked, last_lines, read_job
from backend.engine.timings import remember
from backend.scene_io.photos.formats import TiffHeader
from backend.scene_io.photos.image_size import image_size
from blender_nep.batch.captures import find_captures
from blender_nep.batch.outcome import read_report
from blender_nep.capture.loading import describe, recognized
from blender_nep.capture.photos import photo_files
from blender_nep.cli import main
from blender_nep.errors import CaptureError
from blender_nep.gallery import write_gallery
from blender_nep.job.folders.own_files import is_ours
from blender_nep.safety import plain_files as engines
from support.batch_folder import write_batch, write_mirror_ball
from support.camera_exports import known_cameras, write_bundler, write_metashape

WAIT_S = 60
pipes = pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="POSIX")
ENCODINGS = ("no-such-encoding", "utf-32", "idna", "base64", "euc-jp", "utf-7")
DEEP = "[" * 100_000


@pytest.fixture(autouse=True)
def no_wait():
    """End a test that waits for a pipe."""

    def end(*_):
        pytest.fail("it waits for a pipe")  # no OSError, which readers would take for a damaged file

    before = signal.signal(signal.SIGALRM, end)
    signal.alarm(WAIT_S)
    yield
    signal.alarm(0)
    signal.signal(signal.SIGALRM, before)


def pipe(path: Path) -> Path:
    path.unlink(missing_ok=True)
    os.mkfifo(path)
    return path


def shelf_of_captures(folder: Path) -> Path:
    for name in ("bundler", "metashape"):
        (folder / name).mkdir(parents=True)
    write_bundler(folder / "bundler", known_cameras(centered=True))
    write_metashape(folder / "metashape", known_cameras())
    return folder


@pipes
@pytest.mark.parametrize("name", ["a.xml", "a.out", "bundle/a.out"])
def test_a_pipe_is_no_file_of_cameras(name, tmp_path, capsys):
    shelf = shelf_of_captures(tmp_path / "shelf")
    for folder in (shelf / "bad", shelf / "metashape", shelf / "bundler"):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        pipe(folder / name)
    assert not recognized(shelf / "bad") and not has_cameras(shelf / "bad")
    assert main(["info", str(shelf / "bad")]) == 3 and "has no transforms.json" in capsys.readouterr().err
    found = find_captures([shelf], tmp_path / "out")
    assert [one.path.name for one in found if not one.photos_alone] == ["bundler", "metashape"]
    assert len(describe(shelf / "metashape").views) == 4 and has_cameras(shelf / "metashape")


@pipes
def test_a_pipe_in_the_place_of_a_list_is_told(tmp_path):
    shelf = shelf_of_captures(tmp_path)
    (shelf / "bundler" / "list.txt").unlink()
    pipe(shelf / "bundler" / "a.lst")
    with pytest.raises(CaptureError, match=r"a.lst cannot be read"):
        describe(shelf / "bundler")


@pipes
def test_a_pipe_in_the_place_of_a_photo_is_told(tmp_path):
    for name in ("a.png", "a.exr", "a.tif", "a.heic", "a.dng"):
        for read in (photo_files.image_size, photo_files.exif, lambda path: photo_files.open_image(path, "srgb")):
            with pytest.raises(CaptureError):
                read(pipe(tmp_path / name))
    for read in (image_size, TiffHeader):
        with pytest.raises(OSError):
            read(tmp_path / "a.tif")


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_an_unknown_encoding_stops_no_other_capture(encoding, tmp_path, capsys):
    shelf = shelf_of_captures(tmp_path / "shelf")
    (shelf / "bad").mkdir()
    for folder in (shelf / "bad", shelf / "metashape"):
        (folder / "other.xml").write_text(f'<?xml version="1.0" encoding="{encoding}"?><settings/>', "ascii")
    assert main(["info", str(shelf / "bad")]) == 3 and "has no transforms.json" in capsys.readouterr().err
    assert [one.path.name for one in find_captures([shelf], tmp_path / "out")] == ["bundler", "metashape"]
    assert has_cameras(shelf / "metashape") and not has_cameras(shelf / "bad")


@pytest.mark.parametrize(
    "inner", ["<a>" * 200_000, "<a b='&x;'/>", "\ud800".encode("utf-8", "surrogatepass").decode("latin-1")]
)
def test_an_export_that_is_damaged_further_on_is_told(inner, tmp_path):
    """Its beginning is that of Metashape."""
    (tmp_path / "a.xml").write_text("<document><chunk>" + " " * 100_000 + inner, "latin-1")
    with pytest.raises(CaptureError, match=r"a.xml cannot be read"):
        describe(tmp_path)


def test_json_that_is_nested_deeply_is_damaged_json(tmp_path, capsys):
    for name in ("transforms.json", "report.json", "batch.json"):
        (tmp_path / name).write_text(DEEP)
    (tmp_path / "job").mkdir()
    (tmp_path / "job" / "job.json").write_text(DEEP)
    (tmp_path / "job" / "events.jsonl").write_text(DEEP + '\n{"event": "done"}\n')
    assert main(["info", str(tmp_path)]) == 3 and "nested too deeply" in capsys.readouterr().err
    assert main(["gallery", str(tmp_path)]) == 2 and main(["materials", str(tmp_path)]) == 2
    assert read_report(tmp_path) is None and not is_ours(tmp_path)
    assert read_job(tmp_path) is None and read_materials(tmp_path) == []
    assert describe_asset(tmp_path)[0] == "Reconstructed from photos."
    assert EventFile(tmp_path / "job" / "events.jsonl").read() == [{"event": "done"}]
    with pytest.raises(ValueError, match="damaged"):
        read_batch(tmp_path)


@pipes
def test_pipes_in_an_asset_do_not_hold_up_blender(tmp_path):
    (tmp_path / "job").mkdir()
    for name in ("report.json", "job/job.json", "job/events.jsonl", "job/lock", "times.json"):
        pipe(tmp_path / name)
    assert read_job(tmp_path) is None and read_materials(tmp_path) == [] and describe_asset(tmp_path)[1] == []
    assert EventFile(tmp_path / "job" / "events.jsonl").read() == [] and last_lines(tmp_path / "report.json", 3) == ""
    assert not is_locked(tmp_path / "job" / "lock")
    remember(tmp_path / "times.json", tmp_path)
    write_batch(tmp_path / "shelf", [{"name": "a", "capture": "/c"}])
    (tmp_path / "shelf" / "a").mkdir()
    pipe(tmp_path / "shelf" / "a" / "report.json")
    assert read_batch(tmp_path / "shelf").objects[0].made == ""


def gallery(folder: Path) -> str:
    write_gallery(folder)
    return (folder / "index.html").read_text(encoding="utf-8")


@pipes
def test_pipes_in_an_asset_leave_gaps_in_the_gallery(tmp_path):
    for name in ("bad", "good"):
        write_mirror_ball(tmp_path / "shelf" / name)
    for name in (
        "report.json",
        "preview.png",
        "comparison.png",
        "turntable.png",
        "environment.exr",
        "asset.glb",
        "view.html",
    ):
        pipe(tmp_path / "shelf" / "bad" / name)
    page = gallery(write_batch(tmp_path / "shelf", [{"name": "bad"}, {"name": "good"}]))
    assert page.count("View in 3D") == 1 and "report.json is missing or damaged" in page


NOT_FINITE = [float("nan"), float("inf"), float("-inf"), 10**400, -(10**400)]
PLACES = {
    "seconds": lambda report, value: report.update(seconds_total=value),
    "memory": lambda report, value: report.update(peak_memory_mb=value),
    "faces": lambda report, value: report["stages"]["surface"].update(faces=value),
    "error": lambda report, value: report["stages"]["fields_learning"].update(held_out_error=[0.1, value]),
    "albedo": lambda report, value: report["materials"][0].update(albedo=[0.5, value, 0.5]),
    "roughness": lambda report, value: report["materials"][0].update(roughness=value),
    "metallic": lambda report, value: report["materials"][0].update(metallic=value),
    "share": lambda report, value: report["materials"][0].update(share=value),
}


def test_a_number_that_is_none_leaves_a_gap_in_the_gallery(tmp_path):
    """Python's JSON has NaN and infinity, and whole numbers of any length."""
    names = []
    for place, put in PLACES.items():
        for number, value in enumerate(NOT_FINITE):
            names.append(f"{place}{number}")
            asset = tmp_path / "shelf" / names[-1]
            if len(names) == 1:
                write_mirror_ball(asset)
                whole = json.loads((asset / "report.json").read_text())
            asset.mkdir(exist_ok=True)
            report = json.loads(json.dumps(whole))
            put(report, value)
            (asset / "report.json").write_text(json.dumps(report))
            assert isinstance(read_materials(asset), list) and describe_asset(asset)
    page = gallery(write_batch(tmp_path / "shelf", [{"name": name} for name in names]))
    assert all(f"<h3>{name}</h3>" in page for name in names) and ">nan" not in page.lower() and ">inf" not in page.lower()


@pytest.mark.parametrize("value", NOT_FINITE[:3], ids=str)
def test_a_number_that_is_none_in_a_batch_is_left_out(value, tmp_path):
    keys = {"fraction": value, "eta_s": value, "seconds": value, "peak_memory_mb": value}
    page = gallery(write_batch(tmp_path, [{"name": "a", "state": "running"} | keys, {"name": "b", "state": "failed"}]))
    assert "<h3>a</h3>" in page and "<h3>b</h3>" in page and "nan" not in page.split("</style>")[-1].split("<script>")[0]


@pytest.mark.parametrize("value", [10**400, "many", [], {}], ids=lambda value: type(value).__name__)
def test_a_damaged_batch_is_told_in_both_programs(value, tmp_path, capsys):
    write_batch(tmp_path, [{"name": "a", "capture": "/c", "fraction": value or [1]}])
    assert main(["gallery", str(tmp_path)]) == 2 and "Traceback" not in capsys.readouterr().err
    with pytest.raises(ValueError):
        read_batch(tmp_path)


def test_a_light_without_pixels_leaves_a_gap(tmp_path):
    from blender_nep.asset.export import write_exr

    write_mirror_ball(tmp_path / "shelf" / "ball")
    write_exr(tmp_path / "shelf" / "ball" / "environment.exr", np.ones((4, 8), np.float32))  # one channel
    assert "View in 3D" in gallery(write_batch(tmp_path / "shelf", [{"name": "ball"}]))


@pytest.mark.parametrize("materials", ["{}", "[1]", '[{"albedo": 3}]', "null", f"[{10**400}]"])
def test_a_list_of_damaged_materials_is_told(materials, tmp_path, capsys):
    from blender_nep.job.folders.run_folder import FORMAT

    (tmp_path / "report.json").write_text(f'{{"fingerprint": {{"format": {FORMAT}}}, "materials": {materials}}}')
    expected = 0 if materials == "{}" else 2
    assert main(["materials", str(tmp_path)]) == expected and "Traceback" not in capsys.readouterr().err


@pytest.mark.parametrize("side", [engines, blenders], ids=["engine", "blender"])
def test_both_sides_read_the_same(side, tmp_path):
    path = tmp_path / "a.json"
    path.write_bytes(b'\xef\xbb\xbf{"a": [1, "x\\r\\n"]}\r\n')
    assert side.read_json(path, "utf-8-sig") == {"a": [1, "x\r\n"]}
    assert side.read_bytes(path, path.stat().st_size) == path.read_bytes()
    with pytest.raises(OSError, match="more than 0 MB"):
        side.read_bytes(path, path.stat().st_size - 1)
    for bad in (DEEP, "{", "\ud800"):
        with pytest.raises(ValueError):
            side.parse_json(bad)
    with pytest.raises(OSError):
        side.read_json(tmp_path)
    if hasattr(os, "mkfifo"):
        for other in (pipe(tmp_path / "pipe"), Path("/dev/zero")):
            with pytest.raises(OSError):
                side.read_json(other)


def test_both_sides_have_the_same_code():
    ends = [Path(side.__file__).read_text(encoding="utf-8").partition("from __future__")[2] for side in (engines, blenders)]
    assert ends[0] == ends[1] and sys.version_info >= (3, 11)
