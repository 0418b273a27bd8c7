"""Freed memory stays in the process, so that the next step need not clear its pages again."""

import os
import platform
import subprocess
import sys

import pytest

from blender_nep.job.heap import keep_freed_memory

STEPS = """
import resource, sys
import numpy as np
from blender_nep.job.heap import keep_freed_memory

def faults():
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt

if sys.argv[1] == "keep":
    assert keep_freed_memory()
def step():
    grids = [np.empty(12 << 20, np.uint8) for _ in range(5)]
    for grid in grids:
        grid[::4096] = 1

step()
before = faults()
for _ in range(10):
    step()
print(faults() - before)
"""


def page_faults(mode: str) -> int:
    """Page faults of ten steps. Each step fills 60 MB. NumPy asks for no huge pages, because they make few faults."""
    env = os.environ | {"NUMPY_MADVISE_HUGEPAGE": "0"}
    command = [sys.executable, "-c", STEPS, mode]
    return int(subprocess.run(command, capture_output=True, text=True, check=True, env=env).stdout)


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="the C library is not glibc")
def test_a_step_finds_the_memory_of_the_last_one():
    assert 10 * page_faults("keep") < page_faults("as it is")


def test_another_c_library_is_left_alone(monkeypatch):
    monkeypatch.setattr(platform, "libc_ver", lambda: ("", ""))
    assert not keep_freed_memory()
