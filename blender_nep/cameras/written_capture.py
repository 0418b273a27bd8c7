"""Writes found cameras as a capture: transforms.json, with nerfstudio's keys for the lens."""

from __future__ import annotations

import itertools
import json
import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from blender_nep.cameras.found_cameras import FoundCameras
from blender_nep.cameras.structure_from_motion import PlacedPhoto
from blender_nep.capture.cameras.lens_keys import intrinsics_of
from blender_nep.capture.formats import transforms
from blender_nep.errors import OutputError
from blender_nep.files import output_errors, write_atomically, write_text
from blender_nep.safety.plain_files import read_json

_MARK = {"written_by": "blender_nep"}
"""A key of transforms.json, and its value. By it we know a file that may be replaced without a question"""


def is_written_by_us(path: Path) -> bool:
    """Whether `write_capture` has written the file `path`."""
    try:
        content = read_json(path) if path.is_file() else None
    except (OSError, ValueError):
        return False
    return isinstance(content, dict) and content.items() >= _MARK.items()


def check_writable(folder: Path) -> None:
    """Check, before the work, that a capture can be written to `folder`. Raises OutputError. Nothing is left behind."""
    there = folder.absolute()
    while not os.path.lexists(there):
        there = there.parent
    if not there.is_dir():
        raise OutputError(f"{there} is a file, not a folder", "Choose another --out.", "output.is_a_file", path=there)
    with output_errors(folder), tempfile.TemporaryFile(dir=there):
        pass


def keep_present_file(folder: Path) -> Path | None:
    """Copy the folder's transforms.json to a file with a name of its own, and return its path; None where there is none.

    Copies that are there stay as they are. Raises OutputError.
    """
    path = folder / transforms.FILE
    if not path.is_file():
        return None
    names = (f"{path.stem}.before{number or ''}{path.suffix}" for number in itertools.chain([0], itertools.count(2)))
    kept = next(folder / name for name in names if not os.path.lexists(folder / name))
    with without_resume():
        write_atomically(kept, lambda temporary: shutil.copyfile(path, temporary))
    return kept


def write_capture(found: FoundCameras, folder: Path, color_space: str | None = None, *, with_sphere: bool = True) -> Path:
    """Write `folder`/transforms.json, which names the photos where they are. Returns its path. Raises OutputError.

    `with_sphere` False: the object's sphere is not written. Later jobs estimate it then, from the masks if there are any.
    """
    lenses = [intrinsics_of(placed.camera) for placed in found.placed]
    shared = lenses[0] if all(lens == lenses[0] for lens in lenses) else {}
    frames = [
        _frame(placed, folder) | (lens if not shared else {}) for placed, lens in zip(found.placed, lenses, strict=True)
    ]
    stated = {"object_center": found.object_center.tolist(), "object_radius": found.object_radius}
    sphere = stated if with_sphere else {}
    color = {} if color_space is None else {"color_space": color_space}
    turntable = {} if found.turntable is None else {"turntable": found.turntable}
    content = {**_MARK, **shared, **color, **sphere, **turntable, "frames": frames}
    path = folder / transforms.FILE
    with without_resume(), output_errors(path):
        folder.mkdir(parents=True, exist_ok=True)
        write_text(path, json.dumps(content, indent=1) + "\n")
    return path


@contextmanager
def without_resume() -> Iterator[None]:
    """A context whose OutputError for a full disk does not speak of a job that can be resumed."""
    try:
        yield
    except OutputError as error:
        if error.name != "output.disk_full":
            raise
        hint = "Free some space, then run the command again."  # nothing can be resumed
        raise OutputError(error.message, hint, error.name, **error.values) from error


def _frame(placed: PlacedPhoto, folder: Path) -> dict:
    frame: dict = {"file_path": _relative(placed.photo.path, folder)}
    if placed.photo.mask is not None:
        frame["mask_path"] = _relative(placed.photo.mask, folder)
    told = {"row": placed.row, "turn": placed.turn}
    frame |= {key: value for key, value in told.items() if value is not None}
    return frame | {"transform_matrix": placed.camera.camera_to_world.tolist()}


def _relative(path: Path, folder: Path) -> str:
    """The path as seen from the capture's folder; the whole path where both are on different drives.

    A link to a photo stays one: what it leads to may have a name that is no photo's.
    """
    whole = Path(os.path.abspath(path.parent.resolve() / path.name))
    try:
        return Path(os.path.relpath(whole, folder.resolve())).as_posix()
    except ValueError:
        return whole.as_posix()
