"""run.py --captures: from captures to a shelf, with an engine that only plays a batch."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from backend.run import parse
from support import shelf_engine
from support.own_process import LIMIT_S, in_blender
from support.paths import CHEAP_CYCLES, ROOT, SUZANNE_SMALL
from support.waiting import wait_until

SMALL = ("--relight", "0", "--photos", "1", "--samples", "1")


@pytest.fixture
def folder(asset, tmp_path) -> Path:
    """A folder with an engine, and with captures."""
    for name in ("ant", "bad_bee"):
        (tmp_path / name).symlink_to(SUZANNE_SMALL)
    return tmp_path


def start(folder: Path, *options: str, captures: tuple[str, ...] = ("ant", "bad_bee")) -> subprocess.Popen:
    named = [str(folder / name) for name in captures]
    command = [
        sys.executable,
        CHEAP_CYCLES,
        ROOT / "backend" / "run.py",
        "--out",
        folder / "shelf",
        *options,
        "--captures",
        *named,
    ]
    return subprocess.Popen(
        [*command, "--engine-python", shelf_engine.make(folder)],
        env=os.environ | {"BLENDER_USER_RESOURCES": str(folder)},
        text=True,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    )


def ended(process: subprocess.Popen) -> str:
    return process.communicate(timeout=LIMIT_S)[1]


def test_a_shelf_is_made_and_the_next_start_does_what_is_missing(folder):
    process = start(folder, *SMALL)
    told, shelf = ended(process), folder / "shelf"
    assert process.returncode == 9 and "bad_bee: the photos are no good. Take others." in told, told
    assert "1 of 2 objects failed: bad_bee" in told and "Traceback" not in told
    strip = np.asarray(Image.open(shelf / "ant" / "turntable.png"), np.float32)
    assert strip.shape == (160, 8 * 160, 3)
    frames = np.split(strip, 8, axis=1)
    assert all(frame.std() > 5 and np.ptp(frame[:4]) == 0 for frame in frames), "the object before an even backdrop"
    assert np.abs(frames[0] - frames[4]).mean() > 2, "it turns"
    assert (shelf / "ant" / "comparison.png").is_file() and not (shelf / "bad_bee").exists()
    assert (shelf / "index.html").read_text() == "ant", "the pages are written after the turntables"
    assert not [path for path in shelf.rglob("*") if "partial" in path.name]
    in_blender(check_file, shelf / "shelf.blend")

    (shelf / "ant" / "comparison.png").unlink()
    before = (shelf / "ant" / "turntable.png").stat().st_mtime_ns
    process = start(folder, *SMALL, captures=())
    told = ended(process)
    assert process.returncode == 9 and "render 1/1" in told and "render 1/8" not in told
    assert (shelf / "ant" / "turntable.png").stat().st_mtime_ns == before and (shelf / "ant" / "comparison.png").is_file()


def check_file(path):
    import bpy

    bpy.ops.wm.open_mainfile(filepath=path)
    (item,) = (item for item in bpy.context.scene.objects if item.type == "MESH")
    assert item.asset_data and item.name == "ant" and tuple(item.preview.image_size) == (160, 160)
    assert len(set(item.preview.image_pixels_float)) > 10
    catalogs = (Path(path).parent / "blender_assets.cats.txt").read_text()
    assert f"\n{item.asset_data.catalog_id}:shelf:shelf" in catalogs
    assert all(image.packed_file for image in bpy.data.images if image.source == "FILE") and bpy.context.scene.world


def test_an_object_that_cannot_be_shown_does_not_stop_others(folder, asset):
    (asset / "environment.exr").write_bytes(b"torn")
    process = start(folder, *SMALL, captures=("ant",))
    told = ended(process)
    assert process.returncode == 9 and "ant: Blender's part failed" in told and "environment.exr" in told
    assert (folder / "shelf" / "shelf.blend").is_file() and (folder / "shelf" / "index.html").is_file()


def test_a_stop_stops_the_batch(folder):
    (folder / "mode").write_text("slow")
    process = start(folder)
    wait_until(lambda: (folder / "shelf" / "ant").exists() or process.poll() is not None)
    process.send_signal(signal.SIGTERM)
    told = ended(process)
    assert process.returncode == 7 and (folder / "stopped").exists() and "Start it again" in told
    assert "25 %  Reconstructing the objects" in told
    assert not (folder / "shelf" / "shelf.blend").exists()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--mesh", "m.obj"), "only with --capture"),
        (("--resume",), "always goes on"),
        (("--capture", "x"), "not allowed with"),
    ],
)
def test_options_that_do_not_go_together_are_refused(options, message, capsys):
    with pytest.raises(SystemExit) as refused:
        parse([*options, "--captures", "ant", "--out", "shelf"])
    assert refused.value.code == 2 and message in capsys.readouterr().err


if __name__ == "__main__":
    globals()[sys.argv[1]](*sys.argv[2:])
