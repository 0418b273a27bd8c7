"""Runs structure from motion on photos, in a process of its own (`matching_process`), and reads what it found."""

from __future__ import annotations

import errno
import json
import math
import os
import queue
import shutil
import signal
import sqlite3
import subprocess
import tempfile
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from PIL import Image
from scipy.spatial.transform import Rotation

from blender_nep.cameras.alignment import moved
from blender_nep.cameras.photo_folder import Photo, gray_copy, mask_copy
from blender_nep.cameras.reduction import Reduction
from blender_nep.cameras.ways import LONGEST_SIDE, WAYS, enough
from blender_nep.capture.cameras.camera import Camera
from blender_nep.capture.formats import colmap
from blender_nep.errors import CaptureError, NepError, OutputError, Stopped
from blender_nep.safety.isolated_python import NEUTRAL_FOLDER, isolated_python
from blender_nep.stop_request import StopRequest

_POLL_S = 0.2
_LOOK_S = 1.0
"""How often the database is asked how far the process is"""
_TABLES = {"features": "descriptors", "matches": "two_view_geometries"}
"""{stage: the table that has a row for each step that is done}"""
_OTHER_FOLDER = "The environment variable TMPDIR can name another folder for them."
_LOG_LINES, _LAST_LINES = 400, 5
"""Lines of pycolmap's log that are kept, and that a message shows"""
_DISK_FULL = ("database or disk is full", "No space left")
_STACK = ("@", "***", "PC:")
"""How the lines begin in which a crash tells its stack"""
_NO_MEMORY = ("bad_alloc", "MemoryError", "Cannot allocate memory")
_LEAST_FREE = 1_000_000
"""Bytes. With less space, the disk counts as full."""
_MOST_SKEW = 5e-4
"""COLMAP has no skew. Less than this, relative to the focal length, is left out of improved cameras."""
_SIGKILL = 9
"""The signal by which Linux ends a process where memory is short"""

Report = Callable[[str, int, int], None]
"""Called with the stage ('photos', 'features', 'matches' or 'places'), the step, and the number of steps. Before a further
way is tried: with 'way', the number of photos placed so far, and that of all"""


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
    seen: np.ndarray = field(default_factory=lambda: np.zeros((0, 5)))
    """[n, 5] places of these features [pixels of the full photo], and their scene points"""
    row: int | None = None
    turn: float | None = None
    """Of a turntable, as the capture told them whose cameras are improved: see `View`"""

    def moved(self, turn: np.ndarray, scale: float, shift: np.ndarray) -> PlacedPhoto:
        """The photo with its camera and its scene points after the similarity x -> scale * turn @ x + shift."""
        seen = np.column_stack([self.seen[:, :2], scale * self.seen[:, 2:] @ turn.T + shift])
        return replace(self, camera=moved(self.camera, turn, scale, shift), seen=seen)


@dataclass(frozen=True)
class Group:
    """Photos whose places are known relative to each other."""

    placed: list[PlacedPhoto]
    points: np.ndarray
    """[n, 3] scene points that three photos show, or more"""
    error_before: float | None = None
    """As the median `PlacedPhoto.error` of all photos, but with the given cameras; None where none were given"""
    way: int = 0
    """The number of the way of `WAYS` that found it, from 0"""


def find_groups(
    photos: Sequence[Photo],
    folder: Path,
    report: Report,
    stop: StopRequest,
    *,
    masked: bool | None = None,
    moving: Sequence[np.ndarray] | None = None,
    threads: int | None = None,
    given: Sequence[Camera] | None = None,
) -> list[Group]:
    """Groups of photos whose places were found, the largest one first. Working files are left in the empty `folder`.

    While fewer photos than `enough` are in one group, the next way of `WAYS` is tried. The result is that of the way
    with the largest group.
    masked: None uses features everywhere; True only those on the object that the masks show, False only those beside it.
    moving: without masks, features are used only where these pictures [h, w] bool of the photos say so; None: everywhere.
    given: cameras of the photos that are only improved. There is one group then, in a frame near the given one. Raises
    CaptureError where a photo cannot be read, OutputError where the disk is full, Stopped on request, and NepError where
    pycolmap fails.
    """
    reductions = {}
    for number, photo in enumerate(photos):
        stop_if_asked(stop)
        report("photos", number, len(photos))
        name, reduction = f"{number:05d}.png", Reduction.of(photo.width, photo.height, LONGEST_SIDE)
        reductions[name] = reduction
        _save(gray_copy(photo, reduction), folder / "images" / name)
        if masked is not None and (mask := mask_copy(photo, reduction)) is not None:
            _save(np.uint8(255) * (mask == masked), folder / "masks" / f"{name}.png")
        if moving is not None:
            used = Image.fromarray(np.uint8(255) * moving[number])
            _save(np.asarray(reduction.copy(used, Image.Resampling.NEAREST)), folder / "masks" / f"{name}.png")
    lenses = _lenses(photos, reductions, given)
    longest = max(max(reduction.width, reduction.height) for reduction in reductions.values())
    best: list[Group] = []
    earlier = None
    ways = [way for way in WAYS if len(photos) >= way.least_photos]
    for number, way in enumerate(ways if given is None else ways[:1]):
        if number:
            report("way", _placed(best), len(photos))
        if earlier is not None and not way.added:
            shutil.rmtree(earlier, ignore_errors=True)  # a database of many photos has gigabytes
            earlier = None
        place = folder / f"way_{number}"
        settings = way.settings(longest, len(photos)) | {
            "lenses": lenses,
            "given": {} if given is None else {name: _pose(camera) for name, camera in zip(reductions, given, strict=True)},
            "images": str((folder / "images").absolute()),
            "masks": "" if masked is None and moving is None else str((folder / "masks").absolute()),
            "threads": threads or os.cpu_count() or 1,
            "earlier": "" if earlier is None else str((earlier / "database.db").absolute()),
        }
        with _working_file(folder):
            place.mkdir()
            (place / "settings.json").write_text(json.dumps(settings), encoding="utf-8")
        report("photos", len(photos), len(photos))
        _run(place, report, stop)
        found = [replace(group, way=number) for group in _read(place, photos, reductions)]
        if not best or _placed(found) > _placed(best):  # a group of given cameras may have no photo that is placed
            best = found
        earlier = place
        if _placed(best) >= enough(len(photos)):
            break
    return best


def _placed(groups: Sequence[Group]) -> int:
    """Photos in the largest group"""
    return len(groups[0].placed) if groups else 0


@contextmanager
def working_folder() -> Iterator[Path]:
    """An empty temporary folder, which is removed at the end. Raises OutputError where there can be none."""
    try:
        made = tempfile.TemporaryDirectory(prefix="nep_cameras_", ignore_cleanup_errors=True)
    except OSError as error:
        raise _unwritable(Path(tempfile.tempdir or "."), error) from error
    with made as folder:
        yield Path(folder)


def _save(image: np.ndarray, path: Path) -> None:
    with _working_file(path.parent.parent):
        path.parent.mkdir(exist_ok=True)
        Image.fromarray(image).save(path, compress_level=1)


@contextmanager
def _working_file(folder: Path) -> Iterator[None]:
    """A context that turns the operating system's errors while writing into `folder` into OutputError."""
    try:
        yield
    except OSError as error:
        raise _unwritable(folder.parent, error) from error


def _unwritable(folder: Path, error: OSError) -> OutputError:
    """The error where working files cannot be written into the folder for temporary files."""
    if error.errno in (errno.ENOSPC, errno.EDQUOT):
        return _disk_full(folder)
    reason = error.strerror or str(error)
    message = f"the working files in {folder} cannot be written ({reason})"
    return OutputError(message, _OTHER_FOLDER, "output.no_working_files", reason=reason)


def _disk_full(folder: Path) -> OutputError:
    return OutputError(
        f"the disk is full: the working files in {folder} cannot be written",
        f"Free some space. {_OTHER_FOLDER}",
        "output.disk_full",
        path=folder,
    )


def _lenses(photos: Sequence[Photo], reductions: dict[str, Reduction], given: Sequence[Camera] | None) -> list[dict]:
    """The lenses of `matching_process`, with the names of their copies. Photos of one lens share a camera."""
    lenses: dict[tuple, dict] = {}
    for number, ((name, reduction), photo) in enumerate(zip(reductions.items(), photos, strict=True)):
        if given is None:
            lens = lenses.setdefault(photo.lens, _unknown_lens(photo, reduction))
        else:
            camera = given[number]
            intrinsics = (camera.width, camera.height, camera.fl_x, camera.fl_y, camera.cx, camera.cy, camera.lens)
            lens = lenses.setdefault(intrinsics, _given_lens(reduction.in_copy(camera)))
        lens["names"].append(name)
    return list(lenses.values())


def _unknown_lens(photo: Photo, reduction: Reduction) -> dict:
    """A lens whose focal length EXIF may tell."""
    size = {"width": reduction.width, "height": reduction.height}
    center = [reduction.width / 2, reduction.height / 2]
    params = [photo.focal_length / reduction.scale, *center, 0.0] if photo.focal_length else None
    return {"model": "SIMPLE_RADIAL", "params": params, "refined": True, "names": []} | size


def _given_lens(camera: Camera) -> dict:
    """The lens of a copy, with COLMAP's model that has the fewest parameters for it. k3 of FULL_OPENCV is not refined."""
    k, center = camera.lens, [camera.cx, camera.cy]
    focal, refined = [camera.fl_x, camera.fl_y], True
    if (k.k4 and not k.fisheye) or abs(k.skew) > _MOST_SKEW:
        raise CaptureError(
            "cameras with k4 or a skew cannot be improved", "Find them anew, without --improve.", "capture.lens_not_improved"
        )
    if k.fisheye:
        model, params = "OPENCV_FISHEYE", [*focal, *center, k.k1, k.k2, k.k3, k.k4]
    elif k.k3:
        model, params, refined = "FULL_OPENCV", [*focal, *center, k.k1, k.k2, k.p1, k.p2, k.k3, 0.0, 0.0, 0.0], False
    elif k.p1 or k.p2 or abs(camera.fl_x / camera.fl_y - 1) > 1e-6:
        model, params = "OPENCV", [*focal, *center, k.k1, k.k2, k.p1, k.p2]
    else:
        model, params = "RADIAL", [focal[0], *center, k.k1, k.k2]
    size = {"width": camera.width, "height": camera.height}
    return {"model": model, "params": params, "refined": refined, "names": []} | size


def _pose(camera: Camera) -> dict[str, list[float]]:
    """A pose as COLMAP has it: the rotation (w, x, y, z) and translation from the world to OpenCV's axes."""
    to_camera = (camera.camera_to_world[:3, :3] * [1, -1, -1]).T
    x, y, z, w = Rotation.from_matrix(to_camera).as_quat().tolist()
    position = camera.position
    return {"quaternion": [w, x, y, z], "translation": (-to_camera @ position).tolist(), "position": position.tolist()}


def _run(folder: Path, report: Report, stop: StopRequest) -> None:
    """Run `matching_process` to its end."""
    command = [*isolated_python(), "-m", "blender_nep.cameras.matching.matching_process", str(folder.absolute())]
    process = subprocess.Popen(
        command, cwd=NEUTRAL_FOLDER, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE
    )
    said: queue.SimpleQueue[bytes | None] = queue.SimpleQueue()
    log: deque[bytes] = deque(maxlen=_LOG_LINES)  # in memory: a log on a full disk would say nothing

    def listen() -> None:
        for line in process.stdout or ():
            said.put(line)
        said.put(None)

    readers = [threading.Thread(target=target, daemon=True) for target in (listen, lambda: log.extend(process.stderr or ()))]
    for reader in readers:
        reader.start()
    try:
        if _follow(said, folder / "database.db", report, stop):
            process.wait()
    finally:
        process.kill()
        process.wait()
        for reader in readers:
            reader.join()
        for pipe in (process.stdout, process.stderr):
            if pipe is not None:
                pipe.close()
    stop_if_asked(stop)
    if process.returncode or not (folder / "result.json").is_file():
        raise _failure(b"".join(log).decode("utf-8", "replace"), process.returncode, folder)


def _follow(said: queue.SimpleQueue[bytes | None], database: Path, report: Report, stop: StopRequest) -> bool:
    """Report the steps that the process says, until it says None. Returns False as soon as a stop is asked for.

    Between two steps, the rows of the database tell how far the process is. They are counted here and not in the process:
    Python's SQLite and pycolmap's in one process release each other's locks, and the database breaks.
    """
    stage, steps, looked = "", 0, time.monotonic()
    while not stop.requested:
        try:
            line = said.get(timeout=_POLL_S)
        except queue.Empty:
            if stage in _TABLES and time.monotonic() - looked >= _LOOK_S:
                looked = time.monotonic()
                rows = _rows(database, _TABLES[stage])
                if rows is not None:
                    report(stage, min(rows, steps), steps)
            continue
        if line is None:
            return True
        step = _step(line)
        if step is not None:
            stage, steps = step[0], step[2]
            report(*step)
    return False


def _step(line: bytes) -> tuple[str, int, int] | None:
    """The stage, the step and the number of steps that a line of the process says; None for what pycolmap prints."""
    try:
        said = json.loads(line)
        return str(said["stage"]), int(said["step"]), int(said["steps"])
    except (ValueError, TypeError, KeyError):
        return None


def _rows(database: Path, table: str) -> int | None:
    """The number of rows of a table; None where the database cannot be read at this moment."""
    try:
        with closing(sqlite3.connect(f"{database.absolute().as_uri()}?mode=ro", uri=True, timeout=1)) as opened:
            return int(opened.execute(f"SELECT COUNT(*) FROM {table}").fetchone()[0])
    except sqlite3.Error:
        return None


def _failure(log: str, code: int, folder: Path) -> NepError:
    """The error for a process that ended with `code` and the words `log`."""
    if "No module named 'pycolmap'" in log:
        return NepError("pycolmap is not installed", "Install it: pip install pycolmap.", "unexpected.no_pycolmap")
    if any(words in log for words in _DISK_FULL) or shutil.disk_usage(folder).free < _LEAST_FREE:
        return _disk_full(folder.parents[1])
    if code == -_SIGKILL or any(words in log for words in _NO_MEMORY):
        return NepError("out of memory", "Close other programs, or use fewer or smaller photos.", "unexpected.no_memory")
    how = f"ended with exit code {code}"
    if code < 0:
        names = {one.value: one.name for one in signal.Signals}
        how = f"crashed ({names.get(-code, f'signal {-code}')})"
    said = [line.strip() for line in log.splitlines() if line.strip() and not line.strip().startswith(_STACK)]
    last = f" Its last words: {' '.join(said[-_LAST_LINES:])}" if said else ""
    hint = "Try it again. If it fails again, install the newest pycolmap, or report it."
    return NepError(f"pycolmap {how}", hint + last, "unexpected.pycolmap_failed")


def stop_if_asked(stop: StopRequest) -> None:
    """Raises Stopped if a stop was asked for."""
    if stop.requested:
        raise Stopped(f"stopped ({stop.reason})", "Nothing was written.", "stopped.cameras")


def _read(folder: Path, photos: Sequence[Photo], reductions: dict[str, Reduction]) -> list[Group]:
    """The groups that `matching_process` has written."""
    by_name = dict(zip(reductions, photos, strict=True))
    groups = []
    for model in json.loads((folder / "result.json").read_text(encoding="utf-8")):
        placed = []
        sparse = folder / "sparse" / model["folder"]
        for name, camera in colmap.read_cameras(sparse).items():
            said, photo, reduction = model["photos"].get(name), by_name[name], reductions[name]
            if said is not None and math.isfinite(said["error"]):
                full, scale = reduction.in_photo(camera, photo.width, photo.height), reduction.scale
                seen = np.load(sparse / f"{name}.npy") * [scale, scale, 1, 1, 1] + [reduction.left, reduction.top, 0, 0, 0]
                placed.append(PlacedPhoto(photo, full, said["points"], said["error"] * scale, seen))
        points = np.load(folder / f"points_{model['folder']}.npy")
        before = [reductions[name].scale * said["error"] for name, said in model.get("before", {}).items() if said["points"]]
        error = float(np.median(before)) if before else None
        groups.append(Group(sorted(placed, key=lambda found: found.photo.path.name), points, error))
    return sorted(groups, key=lambda group: -len(group.placed))
