"""What follows from the choice of a capture folder: its folder `images` stands for it, and the result comes beside it.

An output folder that the artist has named stays, but not if the result of other photos is in it: the sidebar would offer
that object as the one of these photos, and *Start Again* would replace it.
"""

import os
from pathlib import Path

import bpy

from ..backend.engine.results.capture_contents import has_cameras, has_masks
from ..backend.plain_files import is_on_other_computer, read_json
from . import folder_changes
from .folders import folder_key, resolve_folder

PHOTOS_FOLDER = "images"  # where captures have their photos
RESULT = "{}_result"  # name of the default output folder, beside the capture


def on_capture_chosen(scene: bpy.types.Scene) -> None:
    """The scene names another capture: take the whole of it, and name an output folder where the artist has named none."""
    settings = scene.nep
    folder = resolve_folder(settings.capture)
    if folder is None:
        return
    if _is_part(folder):
        with folder_changes.without_notices():  # the functions that are called after this one see the whole capture
            settings.capture = _beside(settings.capture, folder, "") or str(folder.parent)
        folder = folder.parent
    is_free = settings.output in ("", settings.default_output) or _is_of_others(resolve_folder(settings.output), folder)
    if is_free and folder.name:
        default = _beside(settings.capture, folder, RESULT.format(folder.name)) or str(
            folder.with_name(RESULT.format(folder.name))
        )
        settings.default_output = default
        settings.output = default


def _is_of_others(output: Path | None, capture: Path) -> bool:
    """Whether the output folder holds the result of another capture, which is still where it was."""
    if output is None:
        return False
    try:
        made_of = read_json(output / "report.json")["capture"]["folder"]
    except (OSError, ValueError, KeyError, TypeError):
        return False
    if not isinstance(made_of, str) or is_on_other_computer(made_of, output):
        return False
    return folder_key(Path(made_of)) != folder_key(capture) and os.path.isdir(made_of)


def _is_part(folder: Path) -> bool:
    """Whether the folder has only the photos of the capture that is the folder above it."""
    whole = folder.parent
    return folder.name.lower() == PHOTOS_FOLDER and not has_cameras(folder) and (has_cameras(whole) or has_masks(whole))


def _beside(setting: str, folder: Path, name: str) -> str:
    """The folder `name` beside the folder of a setting, written as the setting is, such as `//photos`.

    Without a name: the folder above. An empty string where the setting does not end with the folder's name.
    """
    setting = setting.rstrip("/\\")
    if not setting.endswith(folder.name):
        return ""
    above = setting[: len(setting) - len(folder.name)]
    return above + name if name else above.rstrip("/\\") or above
