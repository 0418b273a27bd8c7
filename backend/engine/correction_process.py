"""Runs the engine that redoes an asset's materials with corrections (`blender_nep materials`). No bpy in this file."""

from collections.abc import Mapping
from pathlib import Path

from .command import EngineError, NoEngineError, materials_arguments
from .engine import Engine
from .job_files import last_lines
from .progress import Progress
from .words import CORRECTION_HINTS, Said, Translate

RETRY = "Press Apply again."
OUTDATED = "The installed engine is older than this add-on, and cannot correct materials."
UNKNOWN_COMMAND = "invalid choice: 'materials'"  # what an engine prints that does not know the command


class CorrectionError(EngineError):
    """The materials could not be corrected."""

    @classmethod
    def of(cls, error: EngineError) -> "CorrectionError":
        """The same error, with a hint that says how to go on with a correction."""
        return cls(error.code, error.message, error.hint, error.log, error.name, error.values)

    def words(self, translate: Translate = str) -> tuple[str, str]:
        """(message, hint) that the panel shows."""
        message, hint = super().words(translate)
        return message, translate(CORRECTION_HINTS[self.name]) if self.name in CORRECTION_HINTS else hint


class CorrectionProcess:
    """An engine that corrects materials. When `poll` returns True it has ended: `failed` says why, or is None.

    There is no way to stop it: it needs seconds, and an asset of which only some textures are corrected helps nobody. So it
    goes on to its end also when this program ends.
    """

    def __init__(self, python: str, asset: Path, corrections: Mapping[int, Mapping[str, float]]):
        """Start the engine. Raises NoEngineError where it cannot be started."""
        self.progress = Progress()
        self.warnings: list[Said] = []
        self.failed: CorrectionError | None = None
        self._engine = Engine.start(python, materials_arguments(asset, corrections), keep_going=True)

    def poll(self) -> bool:
        """Read what the engine has said. Returns True when it has ended."""
        events, ended = self._engine.poll()
        for event in events:
            if event["event"] == "progress":
                self.progress = Progress.of(event)
            elif event["event"] == "warning":
                self.warnings.append(Said.of(event))
        if ended:
            error = self._engine.outcome(RETRY)
            if error is not None and UNKNOWN_COMMAND in last_lines(self._engine.log, 5):
                error = NoEngineError(OUTDATED)
            self.failed = None if error is None else CorrectionError.of(error)
            self.close()
        return ended

    def close(self) -> None:
        """Stop following the engine."""
        self._engine.close()
