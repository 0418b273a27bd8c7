"""Runs within this process: its threads, and rows that are learned once."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numba
import torch

from benchmarks.harness import read_row, write_row
from blender_nep.errors import NepError, Stopped


def use_threads(count: int) -> None:
    """For torch and Numba."""
    torch.set_num_threads(count)
    numba.set_num_threads(min(count, numba.config.NUMBA_NUM_THREADS))


def resumed(file: Path, row: dict, run: Callable[[], dict]) -> dict:
    """What `file` holds; where there is none, `row` with what run() gives or its message, written there. A run that is
    stopped leaves no row."""
    if not file.is_file():
        try:
            row = row | run()
        except Stopped:
            raise
        except NepError as error:
            row = row | {"error": str(error)}
        write_row(file, row)
    return read_row(file)
