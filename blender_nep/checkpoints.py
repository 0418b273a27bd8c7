"""Saves and loads the checkpoints of a job.

All files are in the asset's folder `checkpoints/`. `run.json` is the fingerprint of the run. `STAGE.pt` is the last
checkpoint of a stage that has not ended, and `STAGE.previous.pt` is the one before. `STAGE.done.pt` is the result of a
stage. Files are written under a temporary name, flushed to the disk and renamed (`blender_nep.files`). So there is always
the old file or the new file, even if the process is killed.
"""

from __future__ import annotations

import os
import sys
import time
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch

from blender_nep.errors import Stopped
from blender_nep.files import output_errors, write_atomically
from blender_nep.messages import Message
from blender_nep.safety.plain_files import open_plain
from blender_nep.stop_request import INPUT_CLOSED, StopRequest

_NUMPY = "__numpy__"
DAMAGED = (ValueError, LookupError, TypeError, AttributeError, RuntimeError, ArithmeticError, AssertionError)
"""What is raised where a state is not what its class has written"""


def save_state(path: Path, state: dict) -> None:
    """Write a dict of tensors, arrays, numbers, strings, and containers of these. Raises OutputError."""
    write_atomically(path, lambda temporary: torch.save(_pack(state), temporary))


def load_state(path: Path) -> dict:
    """Read a file of `save_state`; its tensors are on the CPU. No code of the file is run. Raises ValueError if damaged."""
    try:
        _refuse_packed(path)
        return _unpack(torch.load(path, map_location="cpu", weights_only=True))
    except MemoryError:
        raise
    except Exception as error:  # the unpickler raises nearly anything on damaged bytes
        raise ValueError(f"{path.name} is damaged ({type(error).__name__})") from error


def _refuse_packed(path: Path) -> None:
    """Raises ValueError where a part of the file is compressed: torch writes none, and such a part may become gigabytes."""
    with open_plain(path, sys.maxsize) as file, zipfile.ZipFile(file) as archive:
        if any(part.compress_type != zipfile.ZIP_STORED for part in archive.infolist()):
            raise ValueError("a part of it is compressed")


def _pack(value: Any) -> Any:
    """The value with its arrays as marked tensors, so that a file can be read without unpickling arbitrary classes."""
    if isinstance(value, np.ndarray):
        return {_NUMPY: torch.from_numpy(np.array(value, order="C"))}
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, dict):
        return {k: _pack(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_pack(v) for v in value] if isinstance(value, list) else tuple(_pack(v) for v in value)
    if isinstance(value, torch.Tensor) and 0 in value.stride():  # one number that stands for many
        return value.contiguous()
    return value


def _unpack(value: Any) -> Any:
    if isinstance(value, dict):
        if _NUMPY in value:
            _check_tensor(value[_NUMPY])
            return value[_NUMPY].numpy()
        return {k: _unpack(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_unpack(v) for v in value] if isinstance(value, list) else tuple(_unpack(v) for v in value)
    if isinstance(value, torch.Tensor):
        _check_tensor(value)
    return value


def _check_tensor(value: torch.Tensor) -> None:
    """Raises ValueError for a tensor that no checkpoint has: a sparse one, or one that is larger than its numbers."""
    if value.layout != torch.strided or value.is_quantized or value.device.type != "cpu":
        raise ValueError("it holds a tensor of another kind")
    if value.numel() * value.element_size() > value.untyped_storage().nbytes():
        raise ValueError("it holds a tensor that is larger than its numbers")


class Checkpoint:
    """Saves the state of the current stage every `interval` seconds. The last two checkpoints are kept."""

    interval = 15.0
    """Seconds between two saves. If a save takes long, they become more, up to 25."""

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
        """Seconds that earlier runs spent in this stage, up to the loaded state."""
        self.loaded = False
        """Whether `load` gave a state, so that the stage goes on from its middle."""
        self._saved_for_stop = False

    @property
    def stopping(self) -> bool:
        """Whether a stop was asked for. Then the stage must save and raise Stopped."""
        return self._stop.requested

    def due(self) -> bool:
        """Whether the stage must save now."""
        return self.stopping or self._clock() - self._saved >= self._wait

    def save(self, state: dict) -> None:
        """Write `state` atomically, and keep the checkpoint before it. Raises OutputError."""
        start = self._clock()
        stopping = self.stopping
        with output_errors(self.path):
            if self.path.exists():
                os.replace(self.path, self.previous)
        save_state(self.path, {"seconds": self.seconds_before + start - self._started, "state": state})
        self._saved = self._clock()
        self._wait = min(max(self.interval, 20 * (self._saved - start)), 25.0)
        self._saved_for_stop |= stopping

    def keep(self) -> None:
        """Count the last save as one of now: the state is the same, so it is not written again."""
        self._saved = self._clock()
        self._saved_for_stop |= self.stopping

    def load(self) -> dict | None:
        """The newest readable state. None if there is none: then the stage starts from its beginning."""
        for path in (self.path, self.previous):
            if not path.exists():
                continue
            try:
                saved = load_state(path)
                self.seconds_before, state = float(saved["seconds"]), saved["state"]
                self.loaded = True
                if path == self.previous:  # else the next save would put the damaged one in its place
                    with output_errors(self.path):
                        self.path.unlink(missing_ok=True)
                return state
            except (ValueError, KeyError, TypeError) as error:
                self._warn(Message("job.checkpoint_damaged", {"file": path.name, "reason": str(error)}))
        return None

    def raise_if_stopped(self, *, saves: bool) -> None:
        """Raise Stopped if a stop was asked for. In a stage that `saves`, wait until its state was saved after that."""
        if self.stopping and (self._saved_for_stop or not saves):
            reason = self._stop.reason
            name = "stopped.input_closed" if reason == INPUT_CLOSED else ""
            raise Stopped(f"stopped ({reason}); the checkpoint is written", "Go on with --resume.", name, reason=reason)

    def seconds(self) -> float:
        """Seconds spent in this stage, with those of earlier runs."""
        return self.seconds_before + self._clock() - self._started

    def remove(self) -> None:
        """Remove the checkpoints of the stage. Call it when the result is on the disk."""
        for path in (self.path, self.previous):
            path.unlink(missing_ok=True)


class NoCheckpoint:
    """A checkpoint for learning without a folder: nothing is loaded or saved, and nobody can stop it."""

    stopping = False

    def load(self) -> None:
        """None: there is no state to go on from."""
        return None

    def due(self) -> bool:
        """False: nothing is saved."""
        return False
