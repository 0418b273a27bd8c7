"""Runs structure from motion on photos, in a process of its own (`matching_process`), and reads what it found."""

from __future__ import annotations

import json
import math
import os
import subprocess
import sys
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image

from blender_nep.cameras.photo_folder import Photo, grey_copy, mask_copy
from blender_nep.capture.camera import Camera
from blender_nep.capture.formats import colmap
from blender_nep.errors import NepError, OutputError, Stopped
from blender_nep.files import output_errors
from blender_nep.stop_request import StopRequest

LONGEST_SIDE = 1600
"""Pixels. Larger photos are scaled down for the features."""
_FEATURES = 6000
"""Largest number of features in a photo"""
_PARTNERS = 24
"""Photos that each photo is compared with, if there are more"""
_SMALL = 1100
"""Photos whose longest side is shorter than this [pixels] are doubled before features are sought, as SIFT's paper does."""
_POLL_S = 0.2

Report = Callable[[str, int, int], None]
"""Called with the stage ('photos', 'features', 'matches' or 'places'), the step, and the number of steps"""


@dataclass(frozen=True)
class PlacedPhoto:
    """A photo whose camera was found."""

    photo: Photo
    camera: Camera
    """In structure from motion's own frame and scale, for the photo's full size"""
    points: int
    """Number of scene points that it shows"""
    error: float
    """Median distance [pixels of the full photo] between its features and the projections of their scene points"""


@dataclass(frozen=True)
class Group:
    """Photos whose places are known relative to each other."""

    placed: list[PlacedPhoto]
    points: np.ndarray
    """[n, 3] scene points that three photos show, or more"""


def find_groups(
    photos: Sequence[Photo], folder: Path, masked: bool | None, threads: int | None, report: Report, stop: StopRequest
) -> list[Group]:
    """Groups of photos whose places were found, the largest one first. Working files are left in the empty `folder`.

    masked: None uses features everywhere; True only those on the object that the masks show, False only those beside it.
    Raises CaptureError where a photo cannot be read, OutputError where the disk is full, Stopped on request, and NepError
    where pycolmap fails.
    """
    scale = {}
    with output_errors(folder):
        for sub in ("images", "masks"):
            (folder / sub).mkdir()
        for number, photo in enumerate(photos):
            _stop_if_asked(stop)
            report("photos", number, len(photos))
            name, grey = f"{number:05d}.png", grey_copy(photo, LONGEST_SIDE)
            scale[name] = photo.width / grey.shape[1]
            Image.fromarray(grey).save(folder / "images" / name, compress_level=1)
            if masked is not None and (mask := mask_copy(photo, (grey.shape[1], grey.shape[0]))) is not None:
                Image.fromarray(np.uint8(255) * (mask == masked)).save(folder / "masks" / f"{name}.png", compress_level=1)
        settings = _settings(photos, scale, masked is not None, threads)
        (folder / "settings.json").write_text(json.dumps(settings), encoding="utf-8")
    report("photos", len(photos), len(photos))
    _run(folder, report, stop)
    return _read(folder, photos, scale)


def _settings(photos: Sequence[Photo], scale: dict[str, float], masked: bool, threads: int | None) -> dict:
    """The file settings.json of `matching_process`. Photos of one lens share a camera."""
    lenses: dict[tuple, dict] = {}
    for name, photo in zip(scale, photos, strict=True):
        lens = lenses.setdefault(
            photo.lens,
            {
                "width": photo.width / scale[name],
                "height": photo.height / scale[name],
                "focal_length": photo.focal_length and photo.focal_length / scale[name],
                "names": [],
            },
        )
        lens["names"].append(name)
    longest = max(max(photo.width, photo.height) / factor for photo, factor in zip(photos, scale.values(), strict=True))
    return {
        "lenses": list(lenses.values()),
        "masked": masked,
        "features": _FEATURES,
        "first_octave": -1 if longest < _SMALL else 0,
        "partners": _PARTNERS,
        "threads": threads or os.cpu_count() or 1,
    }


def _run(folder: Path, report: Report, stop: StopRequest) -> None:
    """Run `matching_process` to its end."""
    log = folder / "pycolmap.log"
    command = [sys.executable, "-m", "blender_nep.cameras.matching_process", str(folder)]
    with open(log, "wb") as errors:
        process = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=errors)
    ended = threading.Event()

    def end_if_asked() -> None:
        while not ended.wait(_POLL_S):
            if stop.requested:
                process.kill()

    watcher = threading.Thread(target=end_if_asked, daemon=True)
    watcher.start()
    try:
        assert process.stdout is not None
        for line in process.stdout:
            said = json.loads(line)
            report(said["stage"], said["step"], said["steps"])
        process.wait()
    finally:
        ended.set()
        process.kill()
        process.wait()
        watcher.join()
    _stop_if_asked(stop)
    if process.returncode or not (folder / "result.json").is_file():
        raise _failure(log.read_text(encoding="utf-8", errors="replace"), process.returncode)


def _failure(log: str, code: int) -> NepError:
    if "No module named 'pycolmap'" in log:
        return NepError("pycolmap is not installed", "Install it: pip install pycolmap.", "unexpected.no_pycolmap")
    if "database or disk is full" in log or "No space left" in log:
        return OutputError("the disk is full: the cameras cannot be found", "Free some space.", "output.disk_full")
    last = "\n".join(log.strip().splitlines()[-5:])
    return NepError(f"pycolmap failed (exit code {code})", f"Its last words: {last}", "unexpected.pycolmap_failed")


def _stop_if_asked(stop: StopRequest) -> None:
    if stop.requested:
        raise Stopped(f"stopped ({stop.reason})", "Nothing was written.", "stopped.cameras")


def _read(folder: Path, photos: Sequence[Photo], scale: dict[str, float]) -> list[Group]:
    """The groups that `matching_process` has written."""
    by_name = dict(zip(scale, photos, strict=True))
    groups = []
    for model in json.loads((folder / "result.json").read_text(encoding="utf-8")):
        placed = []
        for name, camera in colmap.read_cameras(folder / "sparse" / model["folder"]).items():
            said, photo = model["photos"].get(name), by_name[name]
            if said is not None and math.isfinite(said["error"]):
                full = camera.scaled(photo.width, photo.height)
                placed.append(PlacedPhoto(photo, full, said["points"], said["error"] * scale[name]))
        points = np.load(folder / f"points_{model['folder']}.npy")
        groups.append(Group(sorted(placed, key=lambda found: found.photo.path.name), points))
    return sorted(groups, key=lambda group: -len(group.placed))
