"""The correction of an imported result's materials, while it is under way and when it has ended.

The engine changes the files of the asset. Undo cannot take that back, but it takes back the list of materials and the
packed images of the .blend. So both are read from the files again after an undo.
"""

from pathlib import Path

from bpy.app.handlers import persistent

from ...backend.engine.commands.correction_process import CorrectionProcess
from ...backend.engine.results.job_files import is_asset
from ..scene.imported_materials import Corrections, applied_corrections, reload_result, scenes_with
from . import registry
from .engine_task import CommandTask

NOT_IN_FILE = "This file shows none of the result's textures any more. Import the result again to see the correction."


class MaterialCorrection(CommandTask):
    """A correction. At its end the textures are read again.

    `is_seen`: whether the file has an image whose pixels have changed. When Blender ends, the engine brings it to its end.
    """

    process_type = CorrectionProcess
    is_seen = True

    def finish(self) -> None:
        """Bring the corrected textures and values into the file, where it still has this result."""
        if self.failed is None and scenes_with(self.folder):
            self.is_seen = reload_result(self.folder) > 0
            _remember(self.folder)


_corrected: dict[Path, Corrections] = {}  # what was corrected since this file was opened: asset -> its corrections


def start_correction(python: str, asset: Path, corrections: Corrections, *, wait: bool) -> MaterialCorrection:
    """Give the materials of the asset these corrections, and no others.

    With `wait` this function returns after that; else it returns at once. NoEngineError where the engine cannot be started.
    """
    return registry.start(MaterialCorrection(asset, CorrectionProcess(python, asset, corrections)), wait=wait)


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
    _corrected.clear()
