"""The two ways in which tasks ask the engine: a short command, and a question about a capture."""

from pathlib import Path
from typing import ClassVar

from ...backend.engine.command import EngineError
from ...backend.engine.commands.capture_query import CaptureQuery
from ...backend.engine.commands.short_command import CommandError, ShortCommand
from . import registry
from .registry import Task


class CommandTask(Task):
    """A short command that works on the files of a folder. `failed` says why it failed."""

    process_type: ClassVar[type[ShortCommand]]

    def __init__(self, folder: Path, process: ShortCommand | None, failed: CommandError | None = None) -> None:
        """`process` is None for a command that could not be started."""
        super().__init__(folder)
        self.process, self.failed, self.ended = process, failed, process is None

    @classmethod
    def keep_failed_start(cls, folder: Path, error: EngineError) -> CommandError:
        """Keep, for the panel, why the command could not be started in this folder. Returns the error."""
        return registry.keep(cls(folder, None, cls.process_type.error_type.of(error))).failed

    def poll(self) -> bool:
        ended = self.process.poll()
        self.failed = self.process.failed
        return ended

    def displayed_state(self) -> object:
        return self.process.progress

    def close(self) -> None:
        if self.process is not None:
            self.process.close()


class QueryTask(Task):
    """A question about a capture, for the open .blend file. `error` says why there is no answer."""

    def __init__(self, capture: Path, query: CaptureQuery) -> None:
        super().__init__(capture)
        self.query = query

    @property
    def error(self) -> EngineError | None:
        return self.query.error

    def poll(self) -> bool:
        return self.query.poll()

    def close(self) -> None:
        self.query.close()

    def outlives_file(self) -> bool:
        return False
