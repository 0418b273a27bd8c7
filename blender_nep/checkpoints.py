"""Checkpoints of a job.

Everything lies in the asset's `checkpoints/`: `run.json` (what is being run), `STAGE.pt` (a stage that is under way, with
the state before it as `STAGE.previous.pt`) and `STAGE.done.pt` (a stage's result). Files are written under a temporary
name, flushed to the disk and renamed (`blender_nep.files`), so that a kill at any moment leaves the old one or the new one.
"""

from __future__ import annotations

import os
import pickle
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch

from blender_nep.errors import Stopped
from blender_nep.files import output_errors, write_atomically
from blender_nep.messages import Message
from blender_nep.stop_request import INPUT_CLOSED, StopRequest

_NUMPY = "__numpy__"


def save_state(path: Path, state: dict) -> None:
    """Write a dict of tensors, arrays, numbers, strings and containers of them. Raises OutputError."""
    write_atomically(path, lambda temporary: torch.save(_pack(state), temporary))


def load_state(path: Path) -> dict:
    """Read what save_state wrote, tensors on the CPU. No code is run from the file. Raises ValueError if torn."""
    try:
        return _unpack(torch.load(path, map_location="cpu", weights_only=True))
    except (RuntimeError, EOFError, pickle.UnpicklingError, KeyError, OSError, ValueError, TypeError) as error:
        raise ValueError(f"{path.name} is damaged ({type(error).__name__})") from error


def _pack(value: Any) -> Any:
    """Arrays as marked tensors, so that a file can be read without unpickling arbitrary classes."""
    if isinstance(value, np.ndarray):
        return {_NUMPY: torch.from_numpy(np.array(value, order="C"))}
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, dict):
        return {k: _pack(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_pack(v) for v in value] if isinstance(value, list) else tuple(_pack(v) for v in value)
    return value


def _unpack(value: Any) -> Any:
    if isinstance(value, dict):
        if _NUMPY in value:
            return value[_NUMPY].cpu().numpy()
        return {k: _unpack(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_unpack(v) for v in value] if isinstance(value, list) else tuple(_unpack(v) for v in value)
    return value


class Checkpoint:
    """The state of one stage that is under way: due every `interval` seconds, the last two are kept."""

    interval = 15.0
    """Seconds between two saves; a save that takes long stretches it, up to 25."""

    def __init__(
        self,
        folder: Path,
        stage: str,
        stop: StopRequest,
        warn: Callable[[Message], None],
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.path = folder / f"{stage}.pt"
        self.previous = folder / f"{stage}.previous.pt"
        self._stop, self._warn, self._clock = stop, warn, clock
        self._started = self._saved = clock()
        self._wait = self.interval
        self.seconds_before = 0.0
        """Seconds that earlier, killed runs spent in this stage up to the loaded state."""
        self.loaded = False
        """Whether `load` gave a state: the stage is resumed in its middle."""
        self._saved_for_stop = False

    @property
    def stopping(self) -> bool:
        """True when the loop should save and raise Stopped."""
        return self._stop.requested

    def due(self) -> bool:
        """Whether the loop should save now."""
        return self.stopping or self._clock() - self._saved >= self._wait

    def save(self, state: dict) -> None:
        """Write `state` atomically, keeping the one before. Raises OutputError."""
        start = self._clock()
        stopping = self.stopping
        with output_errors(self.path):
            if self.path.exists():
                os.replace(self.path, self.previous)
        save_state(self.path, {"seconds": self.seconds_before + start - self._started, "state": state})
        self._saved = self._clock()
        self._wait = min(max(self.interval, 20 * (self._saved - start)), 25.0)
        self._saved_for_stop |= stopping

    def load(self) -> dict | None:
        """The newest readable state, or None when the stage starts from its beginning."""
        for path in (self.path, self.previous):
            if not path.exists():
                continue
            try:
                saved = load_state(path)
                self.seconds_before, state = float(saved["seconds"]), saved["state"]
                self.loaded = True
                return state
            except (ValueError, KeyError, TypeError) as error:
                self._warn(Message("job.checkpoint_damaged", {"file": path.name, "reason": str(error)}))
        return None

    def raise_if_stopped(self, *, saves: bool) -> None:
        """Raise Stopped once a stop was asked for and, in a stage that `saves`, its state is on the disk."""
        if self.stopping and (self._saved_for_stop or not saves):
            reason = self._stop.reason
            name = "stopped.input_closed" if reason == INPUT_CLOSED else ""
            raise Stopped(f"stopped ({reason}); the checkpoint is written", "Go on with --resume.", name, reason=reason)

    def seconds(self) -> float:
        """Seconds spent in this stage, earlier runs included."""
        return self.seconds_before + self._clock() - self._started

    def remove(self) -> None:
        """Drop the stage's states: its result is on the disk."""
        for path in (self.path, self.previous):
            path.unlink(missing_ok=True)


class NoCheckpoint:
    """For learning without a folder: nothing to go on from, nothing to save, nobody to stop it."""

    stopping = False

    def load(self) -> None:
        """There is no state."""
        return None

    def due(self) -> bool:
        """Never."""
        return False
