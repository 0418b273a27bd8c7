"""The correction of an imported result's materials, while it is under way and when it has ended.

The engine changes the files of the asset. Undo cannot take that back, but it takes back the list of materials and the
packed images of the .blend. So both are read from the files again after an undo.
"""

from pathlib import Path

from bpy.app.handlers import persistent

from ...backend.engine.command import EngineError
from ...backend.engine.commands.correction_process import CorrectionError, CorrectionProcess
from ...backend.engine.results.job_files import is_asset
from ..folders import folder_key
from ..scene.imported_materials import Corrections, applied_corrections, reload_result, scenes_with
from . import clock

NOT_IN_FILE = "This file shows none of the result's textures any more. Import the result again to see the correction."


class MaterialCorrection:
    """A correction that is under way, or has ended; `clock.follow` follows it. At its end the textures are read again.

    `failed` says why it failed. `is_seen`: whether the file has an image whose pixels have changed.
    """

    def __init__(self, asset: Path, process: CorrectionProcess | None, failed: CorrectionError | None = None) -> None:
        """`process` is None for a correction that could not be started."""
        self.asset, self.process, self.failed = asset, process, failed
        self.is_seen = True

    def poll(self) -> bool:
        """Whether the engine has ended."""
        return self.process.poll()

    def displayed_state(self) -> object:
        """What the sidebar shows of the correction."""
        return self.process.progress

    def finish(self) -> None:
        """Bring the corrected textures and values into the file, where it still has this result."""
        global current
        current = None
        self.failed = self.process.failed
        if self.failed is None and scenes_with(self.asset):
            self.is_seen = reload_result(self.asset) > 0
            _remember(self.asset)


current: MaterialCorrection | None = None  # the correction under way
_last: MaterialCorrection | None = None  # the last one, or the one under way
_corrected: dict[Path, Corrections] = {}  # what was corrected since this file was opened: asset -> its corrections


def start_correction(python: str, asset: Path, corrections: Corrections, *, wait: bool) -> MaterialCorrection:
    """Give the materials of the asset these corrections, and no others.

    With `wait` this function returns after that; else it returns at once. NoEngineError where the engine cannot be started.
    """
    global current, _last
    current = _last = MaterialCorrection(asset, CorrectionProcess(python, asset, corrections))
    clock.follow(_last, wait=wait)
    return _last


def keep_failed_start(asset: Path, error: EngineError) -> CorrectionError:
    """Keep, for the panel, why the materials of this asset could not be corrected. Returns the error."""
    global _last
    _last = MaterialCorrection(asset, None, CorrectionError.of(error))
    return _last.failed


def last_correction(asset: Path) -> MaterialCorrection | None:
    """The last correction of this asset that has ended; None where there is none, or where one is under way."""
    ended = current is None and _last is not None and folder_key(_last.asset) == folder_key(asset)
    return _last if ended else None


def is_at_work_in(asset: Path) -> bool:
    """Whether the materials of this asset are being corrected."""
    return current is not None and folder_key(current.asset) == folder_key(asset)


def _remember(asset: Path) -> None:
    _corrected[asset] = applied_corrections(scenes_with(asset)[0].nep)


@persistent
def on_undone(*_: object) -> None:
    """Blender's handler after an undo or a redo: where it took a correction back, read the result again."""
    for asset, corrections in list(_corrected.items()):
        stale = [scene for scene in scenes_with(asset) if applied_corrections(scene.nep) != corrections]
        if stale and is_asset(asset):
            reload_result(asset)
            _remember(asset)


@persistent
def on_file_loaded(*_: object) -> None:
    """Blender's handler after another file was opened: that file may show an earlier state, which is not changed."""
    global _last
    _corrected.clear()
    _last = current


def close_all() -> None:
    """Blender or the add-on ends: nobody follows the correction under way any more. The engine brings it to its end."""
    global current, _last
    if current is not None:
        current.process.close()
    current = _last = None
    _corrected.clear()
