"""Stores the pixels of all photos in memory, or in a file that the operating system maps into memory.

The file has no name; on Windows it is deleted when its last handle is closed. So nothing is left on the disk, however the
process ends. The pages of the file stay in memory as long as no other program needs that memory.
"""

from __future__ import annotations

import mmap
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from blender_nep.files import output_errors


class MemoryStore:
    """Rows [count, *shape] that are appended one after the other, in the device's memory."""

    def __init__(self, count: int, shape: tuple[int, ...], dtype: np.dtype | type, device: torch.device | str) -> None:
        kind = torch.from_numpy(np.empty(0, dtype)).dtype
        self._rows, self._filled = torch.empty((count, *shape), dtype=kind, device=device), 0

    def append(self, rows: np.ndarray) -> None:
        """Append rows [n, *shape], converted to the store's type."""
        end = self._filled + len(rows)
        self._rows[self._filled : end] = torch.from_numpy(rows)
        self._filled = end

    def finished(self) -> Tensor:
        """All rows [count, *shape]. Call it when everything is appended."""
        return self._rows


class FileStore:
    """Rows [count, *shape] that are appended one after the other, in a file in `folder`.

    `finished` gives a tensor on the CPU. Its values are read from the file when they are used.
    """

    def __init__(self, count: int, shape: tuple[int, ...], dtype: np.dtype | type, folder: Path) -> None:
        """Make the file. Raises OutputError."""
        self._shape, self._dtype, self._folder = (count, *shape), np.dtype(dtype), folder
        with output_errors(folder):
            folder.mkdir(parents=True, exist_ok=True)
            self._file = tempfile.TemporaryFile(dir=folder, prefix=".pixels.", buffering=0)

    def append(self, rows: np.ndarray) -> None:
        """Append rows [n, *shape], converted to the store's type. Raises OutputError when the disk is full."""
        left = np.ascontiguousarray(rows, self._dtype).reshape(-1).view(np.uint8).data
        with output_errors(self._folder):
            while left:  # write() reports a full disk; with a mapped file, a signal would end the process
                left = left[self._file.write(left) :]

    def finished(self) -> Tensor:
        """All rows [count, *shape]. Call it once, when everything is appended. Raises OutputError."""
        with output_errors(self._folder), self._file:
            mapped = mmap.mmap(self._file.fileno(), 0, access=mmap.ACCESS_COPY)
        if hasattr(mmap, "MADV_RANDOM"):  # a step reads some thousand single pixels; reading ahead would be wasted
            mapped.madvise(mmap.MADV_RANDOM)
        return torch.from_numpy(np.frombuffer(mapped, self._dtype).reshape(self._shape))


@dataclass(frozen=True)
class PixelMemory:
    """How much memory the pixels may take. Defaults: half a gigabyte in memory; two in a file or on another device."""

    most: int = 256_000_000
    """Largest number of pixels of all photos together. Each takes 8 bytes in half precision, mask included."""
    in_memory: int = 32_000_000
    """Up to this many pixels are kept in memory as float32. If there are more, all are kept in half precision in a file."""
    folder: Path | None = None
    """The folder of that file. None: the pixels are always kept in memory."""

    def stores(self, count: int, masks: bool, device: torch.device | str) -> PixelStores:
        """The stores for `count` pixels, with a store for masks if `masks`. Raises OutputError."""
        few = count <= self.in_memory

        def store(shape: tuple[int, ...], dtype: type) -> MemoryStore | FileStore:
            if few or self.folder is None or torch.device(device).type != "cpu":
                return MemoryStore(count, shape, dtype, device)
            return FileStore(count, shape, dtype, self.folder)

        radiance = store((3,), np.float32 if few else np.float16)
        return PixelStores(radiance, store((), np.bool_), store((), np.uint8) if masks else None)


@dataclass
class PixelStores:
    """Radiance, validity and mask of all pixels, photo by photo."""

    radiance: MemoryStore | FileStore
    valid: MemoryStore | FileStore
    mask: MemoryStore | FileStore | None

    def append(self, radiance: np.ndarray, valid: np.ndarray, mask: np.ndarray | None) -> None:
        """Append the pixels of a photo: radiance [n, 3], valid [n], mask [n] or None. Raises OutputError.

        If one photo has no mask, the masks of all photos are dropped.
        """
        self.radiance.append(radiance)
        self.valid.append(valid)
        if mask is None:
            self.mask = None
        elif self.mask is not None:
            self.mask.append(mask)

    def finished(self) -> tuple[Tensor, Tensor, Tensor | None]:
        """Radiance [N, 3], validity [N] and mask [N] or None of all pixels. Raises OutputError.

        Call it once, when every photo is appended.
        """
        return self.radiance.finished(), self.valid.finished(), None if self.mask is None else self.mask.finished()
