"""The search for the cameras of photos, while it is under way and when it has ended.

The engine works on the files of a folder. So a search belongs to its folder, and not to a scene or a .blend file.
"""

from pathlib import Path

from bpy.app.translations import pgettext_iface

from ...backend.engine.commands.camera_process import CameraProcess
from ..capture_folder import forget_looks, look_into
from ..folders import SAVE_FILE_FIRST, resolve_folder
from . import registry
from .engine_task import CommandTask

NO_CAMERAS = "{folder} holds photos, but no cameras yet: press Find Cameras first"
CHOOSE_CAPTURE = "Choose a capture folder first"
CAMERAS, FOUND = "Cameras", "The cameras were found"
AT_WORK = "The cameras of the photos in {folder} are being found: wait until that has ended"


class CameraSearch(CommandTask):
    """A search. When it ends, the cameras are in the folder, or `failed` says why not.

    `replaces`: whether it replaces cameras that were there. `improves`: whether it begins with these.
    """

    process_type = CameraProcess
    replaces = improves = False

    def displayed_state(self) -> object:
        return self.process.progress, self.process.stopping

    @property
    def done_fraction(self) -> float:
        return self.process.progress.fraction

    @property
    def has_failed(self) -> bool:
        return self.failed is not None

    def status_name(self) -> str:
        return pgettext_iface(CAMERAS)

    def end_status(self) -> str:
        return self.failed.words(pgettext_iface)[0] if self.failed is not None else pgettext_iface(FOUND)

    def finish(self) -> None:
        forget_looks()


def start_search(
    python: str,
    folder: Path,
    *,
    threads: int | None,
    features: str = "everywhere",
    replace: bool = False,
    improve: bool = False,
    video: Path | None = None,
    frames: int | None = None,
    wait: bool,
) -> CameraSearch:
    """Find the cameras of the photos in the folder, and write them into it. `replace`: also where it has cameras.

    `video`: the photos are its frames, at most `frames`, which are written into the folder, too.

    `improve`: begin with the cameras that it has. `features`: as in `cameras_arguments`. With `wait` this function returns
    after that; else it returns at once. NoEngineError where the engine cannot be started.
    """
    options = {"threads": threads, "overwrite": replace, "improve": improve, "features": features}
    if video is not None:
        options |= {"out": folder, "frames": frames}
    process = CameraProcess(python, video or folder, **options)
    search = CameraSearch(folder, process)
    search.replaces, search.improves = replace, improve
    return registry.start(search, wait=wait)


def why_not_usable(capture: Path) -> str:
    """What to do first, where the folder has photos but no cameras yet; an empty string for all other folders."""
    if registry.running(CameraSearch, capture) is not None:
        return pgettext_iface(AT_WORK).format(folder=capture)
    if look_into(capture).lacks_cameras:
        return pgettext_iface(NO_CAMERAS).format(folder=capture)
    return ""


def usable_capture(named: str) -> Path:
    """The capture folder that a setting names. Raises ValueError where it cannot be used yet; its text says what to do."""
    folder = resolve_folder(named)
    if folder is None:
        raise ValueError(SAVE_FILE_FIRST if named else CHOOSE_CAPTURE)
    if refused := why_not_usable(folder):
        raise ValueError(refused)
    return folder
