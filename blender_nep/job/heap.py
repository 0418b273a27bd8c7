"""Keeps the C library from giving freed memory back to the system after every step of learning.

A step allocates and frees gradients of whole grids, 60 MB in all. By default, glibc gives that memory back at the end of the
step. The system then clears the same pages again for the next step. That took 7 % of a step (docs/lab/speed.md).
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
