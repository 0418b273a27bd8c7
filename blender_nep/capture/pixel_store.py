"""Where the pixels of all photos lie: in memory, or in a file that the operating system maps into it.

The file has no name (or, on Windows, goes with its last handle): however the process ends, nothing is left behind. Its
pages stay in memory as long as nobody needs the room.
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
        """rows [n, *shape], converted."""
        end = self._filled + len(rows)
        self._rows[self._filled : end] = torch.from_numpy(rows)
        self._filled = end

    def finished(self) -> Tensor:
        """[count, *shape], once all is appended."""
        return self._rows


class FileStore:
    """The same in a file of `folder`; `finished` gives a tensor on the CPU that is read as it is used."""

    def __init__(self, count: int, shape: tuple[int, ...], dtype: np.dtype | type, folder: Path) -> None:
        """Raises OutputError."""
        self._shape, self._dtype, self._folder = (count, *shape), np.dtype(dtype), folder
        with output_errors(folder):
            folder.mkdir(parents=True, exist_ok=True)
            self._file = tempfile.TemporaryFile(dir=folder, prefix=".pixels.", buffering=0)

    def append(self, rows: np.ndarray) -> None:
        """rows [n, *shape], converted. Raises OutputError when the disk is full."""
        left = np.ascontiguousarray(rows, self._dtype).reshape(-1).view(np.uint8).data
        with output_errors(self._folder):
            while left:  # written, not mapped: a full disk would end the process by a signal
                left = left[self._file.write(left) :]

    def finished(self) -> Tensor:
        """[count, *shape], once all is appended."""
        with output_errors(self._folder), self._file:
            mapped = mmap.mmap(self._file.fileno(), 0, access=mmap.ACCESS_COPY)
        if hasattr(mmap, "MADV_RANDOM"):  # a step reads some thousand single pixels: nothing around them is wanted
            mapped.madvise(mmap.MADV_RANDOM)
        return torch.from_numpy(np.frombuffer(mapped, self._dtype).reshape(self._shape))


@dataclass(frozen=True)
class PixelMemory:
    """How much room the pixels may take. Defaults: half a gigabyte, or two in a file or on another device."""

    most: int = 256_000_000
    """Pixels kept of all photos together; each takes 8 bytes in a file or on another device, masks included."""
    in_memory: int = 32_000_000
    """Up to so many are kept in memory, in float32; more of them in half precision in a file."""
    folder: Path | None = None
    """Of that file; None: they are kept in memory all the same"""

    def stores(self, count: int, masks: bool, device: torch.device | str) -> PixelStores:
        """For `count` pixels. Raises OutputError."""
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
        """A photo [n, 3], [n], [n]. One without a mask ends the keeping of masks. Raises OutputError."""
        self.radiance.append(radiance)
        self.valid.append(valid)
        if mask is None:
            self.mask = None
        elif self.mask is not None:
            self.mask.append(mask)

    def finished(self) -> tuple[Tensor, Tensor, Tensor | None]:
        """All of them, once every photo is there."""
        return self.radiance.finished(), self.valid.finished(), None if self.mask is None else self.mask.finished()
