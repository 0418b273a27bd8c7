"""Runs the engine that writes the pages of a batch (`blender_nep gallery`). No bpy in this file."""

from pathlib import Path

from ..command import ENGINE_MODULE, EngineError, NoEngineError, gallery_arguments
from ..results.job_files import last_lines
from ..started_process import StartedProcess
from .short_command import UNKNOWN_COMMAND

COMMAND, PAGE = "gallery", "index.html"
OUTDATED = "The installed engine is older than this add-on, and writes no gallery."


class GalleryProcess:
    """An engine that writes the pages of the batch in `folder`. It needs seconds, and goes on when this program ends.

    When `poll` returns True it has ended: `failed` says why, or is None.
    """

    def __init__(self, python: str, folder: Path):
        """Start the engine. Raises NoEngineError where it cannot be started."""
        self.page = folder / PAGE
        self.failed: EngineError | None = None
        try:
            command = [python, "-I", "-m", ENGINE_MODULE, *gallery_arguments(folder)]
            self._process = StartedProcess(command, keep_going=True)
        except OSError as error:
            raise NoEngineError(f"The engine cannot be started: {error}.") from error

    def poll(self) -> bool:
        """Whether the engine has ended."""
        if self._process.running():
            return False
        if self._process.code:
            said = last_lines(self._process.folder / "engine.log", 5)
            self.failed = EngineError(self._process.code, "The gallery cannot be written.", log=said)
            if UNKNOWN_COMMAND.format(COMMAND) in said:
                self.failed = NoEngineError(OUTDATED)
        self.close()
        return True

    def close(self) -> None:
        """Stop following the engine, which goes on."""
        self._process.close()
