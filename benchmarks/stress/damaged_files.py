"""Captures of which one file was changed at random: a photo, a mask, or a file of cameras, in every form that is read.

`blender-nep info` reads such a capture in a process of its own. A case passes when the capture is read, or refused by one
clear message and a documented exit code, in bounded time and memory.
"""

from __future__ import annotations

import contextlib
import json
import multiprocessing
import os
import random
import re
import sys
import time
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from hypothesis import strategies as st
from PIL import Image

from benchmarks.stress.checks import strict_json
from benchmarks.stress.file_changes import CHANGES, changed
from benchmarks.stress.scenes import Case, write_capture
from blender_nep import cli
from blender_nep.safety.pictures import open_picture

sys.path.append(str(Path(__file__).parents[2] / "tests"))  # its writers of other programs' files
from support import camera_exports, data_set_exports, peer_exports

MOST_SECONDS = 60.0
"""Of a case"""
MOST_MEGABYTES = 1500.0
"""Of memory that a case takes beside that of an idle engine"""
CODES = (0, 2, 3, 4)
"""Exit codes that a case may end with (docs/conventions.md#exit-codes)"""
WRITERS = {
    writer.__name__.removeprefix("write_"): writer
    for writer in (
        *(camera_exports.write_llff, camera_exports.write_cameras_sphere, camera_exports.write_bundler),
        *(camera_exports.write_metashape, peer_exports.write_realityscan, peer_exports.write_meshroom),
        *(peer_exports.write_opensfm, peer_exports.write_visualsfm, peer_exports.write_polycam),
        *(data_set_exports.write_realityscan_xmp, data_set_exports.write_openmvg, data_set_exports.write_record3d),
        *(data_set_exports.write_sdfstudio, data_set_exports.write_mvsnet, data_set_exports.write_nero),
        data_set_exports.write_gaussians,
    )
}
"""{form: what writes the cameras of it}"""
FORMS = ["transforms", "colmap_bin", "colmap_txt", *WRITERS]
ENDINGS = [".png", ".jpg", ".tif", ".webp", ".exr", ".16.png", ".rgba.png"]
"""Of photos that are changed"""


@dataclass(frozen=True)
class DamagedFile:
    """What is damaged in a capture, and how."""

    form: str = "transforms"
    """Of FORMS"""
    target: str = "cameras"
    """cameras, photo or mask: which kind of file is changed"""
    change: str = "value"
    """Of CHANGES"""
    ending: str = ".png"
    """Of ENDINGS: of the photo that is changed"""
    times: int = 1
    """So many changes are made."""
    number: int = 0
    """The seed of the changes"""


@st.composite
def damaged_files(draw: st.DrawFn) -> DamagedFile:
    """A random case. Half of the cases change a file of cameras."""
    return DamagedFile(
        form=draw(st.sampled_from(FORMS)),
        target=draw(st.sampled_from(["cameras", "cameras", "photo", "mask"])),
        change=draw(st.sampled_from(list(CHANGES))),
        ending=draw(st.sampled_from(ENDINGS)),
        times=draw(st.sampled_from([1, 1, 3])),
        number=draw(st.integers(0, 10**6)),
    )


def write_damaged(case: DamagedFile, folder: Path) -> Path:
    """Write the capture of a case into the empty folder `folder`, and change one of its files. Returns that file."""
    draw = random.Random(case.number)
    if case.form in WRITERS:
        WRITERS[case.form](folder, camera_exports.known_cameras(centered=True))
    else:
        write_capture(Case(views=6, size=24, suffix=".png", masks="none"), folder)
        if case.form != "transforms":
            _write_colmap(folder, binary=case.form == "colmap_bin")
    photos = sorted(path for path in folder.rglob("*.png") if path.parent.name != "masks")
    photos += sorted(folder.rglob("*.jpg"))
    for i, photo in enumerate(photos):
        _paint(photo, i)
        mask = folder / "masks" / f"{photo.stem}.png"
        mask.parent.mkdir(exist_ok=True)
        with open_picture(photo) as image:
            width, height = image.size
        row, column = np.mgrid[:height, :width]
        disc = np.hypot(row - height / 2, column - width / 2) < height / 3
        Image.fromarray(np.uint8(255) * disc).save(mask)
    cameras = [path for path in sorted(folder.rglob("*")) if path.is_file() and path.suffix not in (".png", ".jpg")]
    if case.target == "cameras":
        path = draw.choice(cameras)
    else:
        path = draw.choice(photos) if case.target == "photo" else folder / "masks" / f"{draw.choice(photos).stem}.png"
    if case.target == "photo":
        path = _with_ending(path, case.ending)
    content = path.read_bytes()
    for _ in range(case.times):
        content = changed(content, case.change, draw)
    path.write_bytes(content)
    return path


def _paint(path: Path, number: int) -> None:
    """Give a photo that a writer has left black some colors."""
    with open_picture(path) as image:
        width, height = image.size
    draw = np.random.default_rng(number)
    row, column = np.mgrid[:height, :width] / max(height, width)
    picture = np.stack([0.3 + 0.4 * row, 0.2 + 0.5 * column, 0.5 - 0.2 * row], -1) + draw.normal(0, 0.03, (height, width, 3))
    Image.fromarray(np.uint8(255 * np.clip(picture, 0, 1))).save(path)


def _with_ending(path: Path, ending: str) -> Path:
    """The photo with that ending. The original is removed. Its files of cameras may name another ending: it is found."""
    with open_picture(path) as image:
        pixels = np.asarray(image.convert("RGB"))
    path.unlink()
    new = path.with_suffix("." + ending.rpartition(".")[2])
    if ending == ".exr":
        import OpenEXR

        header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
        OpenEXR.File(header, {"RGB": (pixels / 255).astype(np.float16)}).write(str(new))
    elif ending == ".16.png":
        Image.fromarray(pixels[..., 0].astype(np.uint16) * 257).save(new)
    elif ending == ".rgba.png":
        alpha = np.full((*pixels.shape[:2], 1), 255, np.uint8)
        alpha[:8] = 0
        Image.fromarray(np.concatenate([pixels, alpha], -1)).save(new)
    else:
        Image.fromarray(pixels).save(new)
    return new


def _write_colmap(folder: Path, binary: bool) -> None:
    """The cameras of transforms.json as a COLMAP project, by pycolmap. transforms.json is removed."""
    import pycolmap

    meta = json.loads((folder / "transforms.json").read_text())
    (folder / "transforms.json").unlink()
    model = pycolmap.Reconstruction()
    camera = pycolmap.Camera(model="PINHOLE", width=meta["w"], height=meta["h"], camera_id=1)
    camera.params = [meta["fl_x"], meta["fl_y"], meta["cx"], meta["cy"]]
    model.add_camera_with_trivial_rig(camera)
    for number, frame in enumerate(meta["frames"], 1):
        matrix = np.array(frame["transform_matrix"])
        rotation = (matrix[:3, :3] * [1, -1, -1]).T
        pose = pycolmap.Rigid3d(pycolmap.Rotation3d(rotation), -rotation @ matrix[:3, 3])
        image = pycolmap.Image(name=Path(frame["file_path"]).name, camera_id=1, image_id=number)
        model.add_image_with_trivial_frame(image, pose)
    place = folder / "sparse/0"
    place.mkdir(parents=True)
    (model.write if binary else model.write_text)(str(place))


def run_damaged(case: DamagedFile, folder: Path) -> dict:
    """Make the capture of a case in the empty folder `folder` and let it be read.

    Returns {"file", "code", "failures", "message", "warnings", "seconds", "megabytes"}.
    """
    capture = folder / "capture"
    capture.mkdir()
    path = write_damaged(case, capture)
    start = time.monotonic()
    code, megabytes = _read_apart(capture, folder)
    seconds = time.monotonic() - start
    out, told = (
        (folder / name).read_text(errors="replace") if (folder / name).is_file() else "" for name in ("out", "told")
    )
    failures, found = [], {}
    if code is None:
        failures.append(f"time: it took more than {MOST_SECONDS:.0f} s")
    elif code not in CODES:
        failures.append(f"exit code {code}: {told[-1500:] or 'no message'}")
    else:
        try:
            found = strict_json(out)
        except ValueError as error:
            failures.append(f"no JSON: {error}: {out[:200]}")
    if "Traceback" in told or "RuntimeWarning" in told:
        failures.append(f"traceback or numerical warning: {told[-1500:]}")
    message = found.get("error", {}).get("message", "")
    has_words = any(line.startswith("error: ") for line in told.splitlines())
    if code and code in CODES and not (message and "\n" not in message and has_words):
        failures.append(f"unclear error: {told[:300]}")
    if megabytes > MOST_MEGABYTES:
        failures.append(f"memory: {megabytes:.0f} MB")
    return {
        "file": path.relative_to(capture).as_posix(),
        "code": code,
        "failures": failures,
        "message": message,
        "warnings": [warning["message"] for warning in found.get("warnings", [])],
        "seconds": round(seconds, 2),
        "megabytes": round(megabytes),
    }


def _read_apart(capture: Path, folder: Path) -> tuple[int | None, float]:
    """The exit code of `info` in another process, None where it took too long, and the MB of memory that it took."""
    methods = multiprocessing.get_all_start_methods()
    context = multiprocessing.get_context("forkserver" if "forkserver" in methods else "spawn")
    if "forkserver" in methods:
        context.set_forkserver_preload([__name__, "blender_nep.capture.doctor.summary"])
    memory = context.Value("d", 0.0)
    process = context.Process(target=_info, args=(str(capture), str(folder), memory))
    process.start()
    process.join(MOST_SECONDS)
    if process.is_alive():
        process.kill()
        process.join()
        return None, memory.value
    return process.exitcode, memory.value


def _info(capture: str, folder: str, memory: Any) -> None:
    """Run `blender-nep info --json` in this process, write what it prints to files, and end with its exit code."""
    before = _resident()
    for descriptor, name in ((1, "out"), (2, "told")):
        os.dup2(os.open(Path(folder) / name, os.O_WRONLY | os.O_CREAT), descriptor)
    sys.stdout, sys.stderr = (open(number, "w", encoding="utf-8", closefd=False) for number in (1, 2))
    warnings.simplefilter("default", RuntimeWarning)
    code = cli.main(["info", capture, "--json"])
    memory.value = _resident(peak=True) - before
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code)


def _resident(peak: bool = False) -> float:
    """MB of memory of this process, now or at most so far; 0 where the system does not tell it."""
    name = "VmHWM" if peak else "VmRSS"
    with contextlib.suppress(OSError):
        found = re.search(rf"{name}:\s*(\d+) kB", Path("/proc/self/status").read_text())
        return int(found[1]) / 1024 if found else 0.0
    return 0.0
