"""Keeps the C library from giving freed memory back to the system after every step of learning.

A step allocates and frees gradients of whole grids. By default, glibc gives the end of its heap back to the system when they
are freed. Then the system must clear 12 MB of pages again in every step. That took 6 to 8 % of a step (docs/lab/speed.md).
"""

from __future__ import annotations

import ctypes
import platform
import sys

_TRIM_THRESHOLD, _MMAP_THRESHOLD = -1, -3
"""Names of parameters of mallopt, in malloc.h of glibc."""
KEPT = 256 << 20
"""Up to so many free bytes at the end of the heap are kept."""
MAPPED_FROM = 32 << 20
"""Allocations of at least so many bytes get pages of their own, which go back when they are freed. glibc allows no more."""


def keep_freed_memory() -> bool:
    """Tell glibc to keep freed memory for later allocations. False if the C library is another one; nothing changes then."""
    if sys.platform != "linux" or platform.libc_ver()[0] != "glibc":
        return False
    mallopt = ctypes.CDLL(None).mallopt
    return bool(mallopt(_TRIM_THRESHOLD, KEPT)) and bool(mallopt(_MMAP_THRESHOLD, MAPPED_FROM))
