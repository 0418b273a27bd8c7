"""Facts of the machine that a job runs on: device, cores, memory, versions of packages."""

from __future__ import annotations

import importlib.metadata
import os
import platform
import sys

import torch

import blender_nep
from blender_nep.errors import UsageError


def choose_device(name: str) -> torch.device:
    """The torch device of this name. `auto` means cuda if torch can use it, else cpu.

    Raises UsageError when `name` is cuda and torch cannot use it.
    """
    if name == "auto":
        name = "cuda" if torch.cuda.is_available() else "cpu"
    if name == "cuda" and not torch.cuda.is_available():
        raise UsageError("no CUDA device can be used", "Use --device cpu; everything runs on the CPU too.", "usage.no_cuda")
    return torch.device(name)


def usable_cores() -> int:
    """CPU cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def peak_memory() -> float | None:
    """Largest resident memory of this process so far, in MB; None on Windows."""
    if sys.platform == "win32":
        return None
    import resource

    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / (1 << 20 if sys.platform == "darwin" else 1 << 10)


def versions() -> dict[str, str]:
    """{package: version} of blender_nep, Python and the libraries that decide the result."""
    names = ("torch", "numpy", "numba", "trimesh", "xatlas", "embreex", "OpenEXR", "scikit-image")
    found = {"blender_nep": blender_nep.__version__, "python": platform.python_version()}
    return found | {name: importlib.metadata.version(name) for name in names}
