"""Runs a command of the engine other than `reconstruct`, and follows it. No bpy in this file."""

from collections.abc import Mapping
from typing import ClassVar, Self

from ..command import EngineError, NoEngineError
from ..engine import Engine
from ..progress import Progress
from ..results.job_files import last_lines
from ..words import EngineMessage, Translate

UNKNOWN_COMMAND = "invalid choice: '{}'"
"""What an engine prints that does not know the command {}."""


class CommandError(EngineError):
    """The command failed. `hints`: name of an error -> its hint in the place of the one that speaks of a job."""

    hints: ClassVar[Mapping[str, str]] = {}

    @classmethod
    def of(cls, error: EngineError) -> Self:
        """The same error, with a hint that says how to go on with this command."""
        return cls(error.code, error.message, error.hint, error.log, error.name, error.values)

    def words(self, translate: Translate = str) -> tuple[str, str]:
        """(message, hint) that the panel shows."""
        message, hint = super().words(translate)
        return message, translate(self.hints[self.name]) if self.name in self.hints else hint


class ShortCommand:
    """An engine at work on a command. When `poll` returns True it has ended: `failed` says why, or is None.

    A kind of command is a class of its own, which names its errors, what an artist does where the engine ended and said no
    reason (`retry`), and what an older engine cannot do (`outdated`).
    """

    error_type: ClassVar[type[CommandError]] = CommandError
    retry: ClassVar[str] = ""
    outdated: ClassVar[str] = ""

    def __init__(self, python: str, arguments: list[str], *, keep_going: bool):
        """Start the engine. With `keep_going` it goes on when this program ends. Raises NoEngineError where it cannot."""
        self.progress = Progress()
        self.warnings: list[EngineMessage] = []
        self.found: list[EngineMessage] = []
        """Sentences on what the engine has found"""
        self.failed: CommandError | None = None
        self._command = arguments[0]
        self._engine = Engine.start(python, arguments, keep_going=keep_going)

    def poll(self) -> bool:
        """Read what the engine has said. Returns True when it has ended."""
        events, ended = self._engine.poll()
        for event in events:
            if event["event"] == "progress":
                self.progress = Progress.of(event)
            elif event["event"] == "warning":
                self.warnings.append(EngineMessage.of(event))
            elif event["event"] == "scene":
                self.found = [EngineMessage.of(line) for line in event.get("lines") or ()]
        if ended:
            error = self._outcome()
            self.failed = None if error is None else self.error_type.of(error)
            self.close()
        return ended

    def _outcome(self) -> EngineError | None:
        error = self._engine.outcome(self.retry)
        if error is not None and UNKNOWN_COMMAND.format(self._command) in last_lines(self._engine.log, 5):
            return NoEngineError(self.outdated)
        return error

    def close(self) -> None:
        """Stop following the engine. An engine that was started without `keep_going` then stops."""
        self._engine.close()
