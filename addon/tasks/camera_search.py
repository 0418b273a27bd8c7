"""The search for the cameras of photos, while it is under way and when it has ended.

The engine works on the files of a folder. So a search belongs to its folder, and not to a scene or a .blend file.
"""

from pathlib import Path

from bpy.app.handlers import persistent
from bpy.app.translations import pgettext_iface

from ...backend.engine.command import EngineError
from ...backend.engine.commands.camera_process import CameraError, CameraProcess
from ..capture_folder import forget_looks, look_into
from ..folders import SAVE_FILE_FIRST, folder_key, resolve_folder
from . import clock

NO_CAMERAS = "{folder} holds photos, but no cameras yet: press Find Cameras first"
CHOOSE_CAPTURE = "Choose a capture folder first"
AT_WORK = "The cameras of the photos in {folder} are being found: wait until that has ended"


class CameraSearch:
    """A search that is under way, or has ended; `clock.follow` follows it.

    `failed` says why it failed. `replaces`: whether it replaces cameras that were there. `improves`: whether it begins with
    these.
    """

    def __init__(
        self,
        folder: Path,
        process: CameraProcess | None,
        *,
        replaces: bool = False,
        improves: bool = False,
        failed: CameraError | None = None,
    ) -> None:
        """`process` is None for a search that could not be started."""
        self.folder, self.process, self.failed = folder, process, failed
        self.replaces, self.improves = replaces, improves

    def poll(self) -> bool:
        """Whether the engine has ended."""
        return self.process.poll()

    def displayed_state(self) -> object:
        """What the sidebar shows of the search."""
        return self.process.progress, self.process.stopping

    def finish(self) -> None:
        """The cameras are in the folder, or `failed` says why not."""
        global current
        current = None
        self.failed = self.process.failed
        forget_looks()


current: CameraSearch | None = None  # the search under way
_last: CameraSearch | None = None  # the last one, or the one under way


def start_search(
    python: str,
    folder: Path,
    *,
    threads: int | None,
    features: str = "everywhere",
    replace: bool = False,
    improve: bool = False,
    wait: bool,
) -> CameraSearch:
    """Find the cameras of the photos in the folder, and write them into it. `replace`: also where it has cameras.

    `improve`: begin with the cameras that it has. `features`: as in `cameras_arguments`. With `wait` this function returns
    after that; else it returns at once. NoEngineError where the engine cannot be started.
    """
    global current, _last
    process = CameraProcess(python, folder, threads=threads, overwrite=replace, improve=improve, features=features)
    search = current = _last = CameraSearch(folder, process, replaces=replace, improves=improve)
    clock.follow(search, wait=wait)
    return search


def keep_failed_start(folder: Path, error: EngineError) -> CameraError:
    """Keep, for the panel, why the search in this folder could not be started. Returns the error."""
    global _last
    _last = CameraSearch(folder, None, failed=CameraError.of(error))
    return _last.failed


def last_search(folder: Path) -> CameraSearch | None:
    """The last search in this folder that has ended; None where there is none, or where one is under way."""
    ended = current is None and _last is not None and folder_key(_last.folder) == folder_key(folder)
    return _last if ended else None


def is_at_work_in(folder: Path) -> bool:
    """Whether the cameras of the photos in this folder are being found."""
    return current is not None and folder_key(current.folder) == folder_key(folder)


def why_not_usable(capture: Path) -> str:
    """What to do first, where the folder has photos but no cameras yet; an empty string for all other folders."""
    if is_at_work_in(capture):
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


@persistent
def on_file_loaded(*_: object) -> None:
    """Blender's handler after another file was opened: what was said of an ended search is forgotten."""
    global _last
    _last = current


def close_all() -> None:
    """Blender or the add-on ends: the search under way ends, too, and writes nothing."""
    global current, _last
    if current is not None:
        current.process.close()
    current = _last = None
    forget_looks()
