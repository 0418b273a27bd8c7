"""Kernels are compiled once for all processes of a machine."""

import fcntl
import importlib.util
import os

import numpy as np
import pytest

from blender_nep.ops import compilation

MODULE = """
from blender_nep.ops.compilation import kernel

@kernel(fastmath=True)
def total(values):
    found = 0.0
    for value in values:
        found += value
    return found
"""


@pytest.fixture
def processes(tmp_path):
    """The kernel as two processes import it, and its lock, held."""
    (tmp_path / "sums.py").write_text(MODULE)
    kernels = []
    for _ in range(2):
        spec = importlib.util.spec_from_file_location("sums", tmp_path / "sums.py")
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        kernels.append(module.total)
    lock = os.open(os.path.join(kernels[0].stats.cache_path, "sums.total.lock"), os.O_RDWR | os.O_CREAT)
    fcntl.flock(lock, fcntl.LOCK_EX)
    return kernels, lock


def test_a_process_waits_for_a_kernel_that_another_compiles(processes, monkeypatch):
    (waiting, compiling), lock = processes

    def other_process(_seconds: float) -> None:
        os.close(lock)
        assert compiling(np.ones(3)) == 3

    monkeypatch.setattr(compilation.time, "sleep", other_process)
    assert waiting(np.ones(3)) == 3
    assert (sum(compiling.stats.cache_misses.values()), sum(waiting.stats.cache_misses.values())) == (1, 0)


def test_a_process_that_holds_the_lock_for_ever_stops_no_other(processes, monkeypatch):
    (waiting, _), lock = processes
    monkeypatch.setattr(compilation, "_LONGEST_WAIT_S", 0.0)
    assert waiting(np.ones(3)) == 3
    os.close(lock)
