"""Which files of an output folder are ours. Nothing else in it is ever replaced or removed.

A folder is ours if `report.json` or `checkpoints/run.json` in it has the keys that only we write. The first is the mark of
an asset, the second that of a run. In a folder with such a mark, we replace and remove the files that we write, by their
names. In a folder without a mark, a file with such a name belongs to somebody else, and the folder is refused before
anything is written. Files with other names stay where they are, everywhere.
"""

from __future__ import annotations

import contextlib
import json
import os
import re
from collections.abc import Iterable
from pathlib import Path

from blender_nep.asset.export import FILES, PARTIAL, REPORT, TEXTURES_FOLDER, WRITTEN
from blender_nep.capture.capture import Capture
from blender_nep.capture.formats.photo_search import photos_in
from blender_nep.errors import UsageError
from blender_nep.files import output_errors, refuse_links, write_text
from blender_nep.job.folders import job_folder
from blender_nep.job.stage_names import StageName
from blender_nep.safety.plain_files import read_json

CHECKPOINTS, RUN_FILE = "checkpoints", "run.json"
PREVIEW = "preview"
"""Name under which the view of the preview picture is kept in `checkpoints/`."""
LOG, PROFILE = "log.txt", "profile.json"
ENTRIES = (*WRITTEN, CHECKPOINTS, job_folder.FOLDER, LOG, PROFILE)
"""The files and folders that a run writes into the folder of its asset"""
_BLENDERS = ("asset.blend", "comparison.png", "turntable.png")
"""Files that Blender adds to an asset: backend/headless"""
_RUN_KEYS = {"format", "capture", "preset", "seed"}
_NO_RUN = dict.fromkeys(_RUN_KEYS)
"""What run.json says where a run was discarded: the folder is still ours"""
_STAGE_FILE = re.compile(rf"({'|'.join((*StageName, PREVIEW))})(\.previous|\.done)?\.pt")
_UNFINISHED_FILE = re.compile(r"\.(.+)\.\d+\.tmp")
"""A file that `write_atomically` has not finished, because the process was killed"""
_SHOWN = 3
"""So many foreign files are named in a message"""


def is_ours(folder: Path) -> bool:
    """Whether the folder has the mark of an asset or of a run."""
    return _has_report(folder) or _has_run(folder)


def _has_report(folder: Path) -> bool:
    report = _read(folder / REPORT)
    made_by = None if report is None else report.get("fingerprint")
    return isinstance(made_by, dict) and "format" in made_by


def _has_run(folder: Path) -> bool:
    """Whether run.json is ours. One that is damaged counts where results of our stages lie beside it."""
    path = folder / CHECKPOINTS / RUN_FILE
    if not path.is_file():
        return False
    run = _read(path)
    return _RUN_KEYS <= run.keys() if run is not None else any(map(_is_stage_file, path.parent.iterdir()))


def _read(path: Path) -> dict | None:
    """The JSON object in a file; None if there is no such file, or none that can be read."""
    try:
        content = read_json(path) if path.is_file() else None
    except (OSError, ValueError):
        return None
    return content if isinstance(content, dict) else None


def _is_stage_file(path: Path) -> bool:
    unfinished = _UNFINISHED_FILE.fullmatch(path.name)
    return bool(_STAGE_FILE.fullmatch(unfinished[1] if unfinished else path.name))


def _is_unfinished(path: Path) -> bool:
    """Whether the path is a run.json of ours that was not finished, because the process was killed."""
    unfinished = _UNFINISHED_FILE.fullmatch(path.name)
    return unfinished is not None and unfinished[1] == RUN_FILE


def refuse_foreign_files(folder: Path) -> None:
    """Raises UsageError where the folder holds files that a job would replace, and no mark shows that they are ours."""
    with output_errors(folder):
        job_folder.refuse_foreign_files(folder)
        if is_ours(folder):
            return
        checkpoints = folder / CHECKPOINTS
        empty = checkpoints.is_dir() and all(map(_is_unfinished, checkpoints.iterdir()))
        if os.path.lexists(checkpoints) and not empty:
            raise UsageError(
                f"nothing shows that {checkpoints} is of blender-nep: it has no {RUN_FILE} of ours",
                "Choose another --out, or move that folder away.",
                "usage.unknown_run",
                folder=checkpoints,
            )
        # A log only grows. So one in a folder where a job of ours has begun is no reason to refuse.
        logs = () if job_folder.was_used(folder) else (LOG,)
        names = (*FILES, PARTIAL, PROFILE, *_BLENDERS, *logs)
        refuse_files(folder, (name for name in names if os.path.lexists(folder / name)))


def refuse_files(folder: Path, names: Iterable[str]) -> None:
    """Raises UsageError where there are `names`: those of foreign files in `folder`, which would be replaced."""
    found = list(names)
    if found:
        shown = ", ".join(found[:_SHOWN]) + (f" and {len(found) - _SHOWN} more" if len(found) > _SHOWN else "")
        raise UsageError(
            f"{folder} holds {shown}, and nothing shows that blender-nep has written that",
            "Choose another --out, or move these files away.",
            "usage.not_ours",
            folder=folder,
            files=shown,
        )


def refuse_captures_folder(out: Path, capture: Path) -> None:
    """Raises UsageError where `out` is the folder of the capture, or one in it that has photos. Reads only names.

    `refuse_folder_of_photos` knows more, but the capture must be read for it.
    """
    if _is_same(out, capture):
        raise _in_capture(out, capture)
    with output_errors(out):
        photos = photos_in(out) if capture.resolve() in out.resolve().parents else []
    if photos and not is_ours(out):
        raise UsageError(
            f"{out} cannot be --out: it lies in the capture's folder and holds {photos[0].name}, which may be a photo",
            "Choose another --out: a folder of its own.",
            "usage.output_is_capture",
            folder=out,
            path=photos[0],
        )


def refuse_folder_of_captures(out: Path, captures: Path) -> None:
    """Raises UsageError where `out` is the folder that holds captures: an object has the name of its capture."""
    if _is_same(out, captures):
        raise _in_capture(out, captures)


def refuse_folder_of_photos(out: Path, capture: Capture, mesh: Path | None) -> None:
    """Raises UsageError where the asset in `out` would lie among the capture's photos, masks or camera files.

    Then its pictures could be read as photos. It is also refused if such a file, or the given mesh, lies where the asset's
    own files are written. `out` may be a folder of its own in the capture's folder, or around it.
    """
    photos = [path for view in capture.views for path in (view.image_path, view.mask_path) if path is not None]
    files = [*photos, *capture.files]
    folders = {path.parent: path for path in reversed(files)}
    own = [out / name for name in (CHECKPOINTS, TEXTURES_FOLDER, PARTIAL, job_folder.FOLDER)]
    for folder, path in folders.items():
        inside = folder.resolve()
        if _is_same(out, folder) or any(place.resolve() in (inside, *inside.parents) for place in own):
            raise _in_capture(out, path)
    if mesh is not None and any(_is_same(out / name, mesh) for name in FILES):
        raise _in_capture(out, mesh)


def _in_capture(out: Path, path: Path) -> UsageError:
    return UsageError(
        f"{out} cannot be --out: the job reads {path}",
        "Choose another --out: a folder of its own.",
        "usage.output_is_capture",
        folder=out,
        path=path,
    )


def _is_same(one: Path, other: Path) -> bool:
    try:
        return os.path.samefile(one, other)
    except OSError:  # one of them is not there yet
        return one.resolve() == other.resolve()


def discard_run(folder: Path) -> None:
    """Remove the checkpoints of the run in `folder`, and the reports of its asset. The folder stays ours.

    From here on it holds no valid asset. Raises UsageError where the checkpoints are not ours, and OutputError, also where
    one of our files or folders there is a link.
    """
    refuse_links(folder, ENTRIES)
    refuse_foreign_files(folder)
    checkpoints = folder / CHECKPOINTS
    with output_errors(checkpoints):
        checkpoints.mkdir(parents=True, exist_ok=True)
        write_text(checkpoints / RUN_FILE, json.dumps(_NO_RUN))
        for name in (REPORT, PROFILE):
            (folder / name).unlink(missing_ok=True)
        _remove_stage_files(checkpoints)


def is_discarded(run: dict[str, object]) -> bool:
    """Whether the content of run.json says that its run was discarded."""
    return run == _NO_RUN


def remove_checkpoints(folder: Path) -> None:
    """Remove the checkpoints of a finished asset (--clean). Foreign files stay, and so the folder.

    Raises OutputError, also where the checkpoints are a link.
    """
    refuse_links(folder, [CHECKPOINTS])
    checkpoints = folder / CHECKPOINTS
    with output_errors(checkpoints):
        _remove_stage_files(checkpoints)
        (checkpoints / RUN_FILE).unlink(missing_ok=True)
        with contextlib.suppress(OSError):  # not empty
            checkpoints.rmdir()


def _remove_stage_files(checkpoints: Path) -> None:
    for path in checkpoints.iterdir():
        if _is_stage_file(path) and not (path.is_dir() and not path.is_symlink()):
            path.unlink(missing_ok=True)
