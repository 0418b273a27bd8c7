"""The machine that a job runs on: device, cores, memory, versions."""

from __future__ import annotations

import importlib.metadata
import os
import platform
import sys

import torch

import blender_nep
from blender_nep.errors import UsageError


def choose_device(name: str) -> torch.device:
    """`auto`: cuda where torch has it. Raises UsageError when cuda is asked for and missing."""
    if name == "auto":
        name = "cuda" if torch.cuda.is_available() else "cpu"
    if name == "cuda" and not torch.cuda.is_available():
        raise UsageError("no CUDA device can be used", "Use --device cpu; everything runs on the CPU too.", "usage.no_cuda")
    return torch.device(name)


def usable_cores() -> int:
    """CPU cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def peak_memory() -> float | None:
    """Largest resident memory of this process in MB; None where the system does not tell."""
    if sys.platform == "win32":
        return None
    import resource

    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / (1 << 20 if sys.platform == "darwin" else 1 << 10)


def versions() -> dict[str, str]:
    """What this run was made with."""
    names = ("torch", "numpy", "numba", "trimesh", "xatlas", "embreex", "OpenEXR", "scikit-image")
    found = {"blender_nep": blender_nep.__version__, "python": platform.python_version()}
    return found | {name: importlib.metadata.version(name) for name in names}
