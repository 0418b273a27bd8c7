"""Runs the engine that finds the cameras of photos (`blender_nep cameras`). No bpy in this file."""

import errno
import tempfile
from pathlib import Path
from typing import Any

from ..command import EngineError, cameras_arguments
from ..exit_codes import OUTPUT_FAILED, STOPPED
from ..words import CAMERA_HINTS
from .short_command import CommandError, ShortCommand

NOT_PERMITTED = (errno.EACCES, errno.EPERM, errno.EROFS)


class CameraError(CommandError):
    """No cameras were found, or they could not be written."""

    hints = CAMERA_HINTS


class CameraProcess(ShortCommand):
    """An engine that finds the cameras of the photos in a folder, and writes them into that folder at its end.

    It can be stopped, and it stops when this program ends. Then it has written nothing.
    """

    error_type = CameraError
    retry = "Press the button again."
    outdated = "The installed engine is older than this add-on, and cannot find cameras."

    def __init__(self, python: str, photos: Path, **options: Any):
        """Start the engine. `options`: those of `cameras_arguments`. Raises NoEngineError where it cannot be started."""
        self.stopping = False
        super().__init__(python, cameras_arguments(photos, **options), keep_going=False)

    def stop(self) -> None:
        """Ask the engine to end and to write nothing."""
        self.stopping = True
        self._engine.request_stop()

    def _outcome(self) -> EngineError | None:
        error = super()._outcome()
        if error is not None and error.code == STOPPED and not error.name:  # it ended before it could say so
            return EngineError(STOPPED, "Stopped.", name="stopped.cameras")
        return error


def check_writable(folder: Path) -> None:
    """Raises CameraError where no file may be written into the folder.

    The engine writes at the end of its work, so an artist would learn of it after minutes. A folder that is not there is
    left to the engine.
    """
    try:
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        if error.errno in NOT_PERMITTED:
            reason = error.strerror or str(error)
            values = {"path": str(folder), "reason": reason}
            message = f"{folder} may not be written ({reason})"
            raise CameraError(OUTPUT_FAILED, message, name="output.not_permitted", values=values) from error
