"""Sets of pixels, stored as runs of consecutive indices.

An index of eight bytes for each pixel would take most of the memory of a large capture.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import torch
from torch import Tensor


def random_places(count: int, size: int, generator: torch.Generator) -> Tensor:
    """Random places [count] int64 in 0..size - 1, in rising order, for a batch of pixels.

    Neighboring pixels follow each other. So their rays read nodes of the grids that are already in the processor's cache.
    """
    return torch.randint(size, (count,), generator=generator, device=generator.device).sort().values


class PixelSet:
    """A list of n pixel indices, stored as runs of consecutive indices.

    `pixels[k]` gives int64 indices; k is [m] int64 in 0..n-1, a slice or a mask [n] bool. `tensor` gives all indices.
    """

    def __init__(self, first: Tensor, length: Tensor) -> None:
        """first [R] int64: the first index of each run; length [R] int64: the number of its indices, at least 1."""
        self._first, self._length = first, length
        end = length.cumsum(0)
        self._before = end - length
        self._count = int(end[-1]) if len(end) else 0

    @classmethod
    def where(cls, flags: Tensor, offset: int = 0) -> PixelSet:
        """The set of all `offset` + k for which flags[k] is true; flags is [m] bool."""
        edge = torch.diff(
            flags.to(torch.int8), prepend=flags.new_zeros(1, dtype=torch.int8), append=flags.new_zeros(1, dtype=torch.int8)
        )
        first = (edge == 1).nonzero()[:, 0]
        return cls(first + offset, (edge == -1).nonzero()[:, 0] - first)

    @classmethod
    def of(cls, index: Tensor) -> PixelSet:
        """The set of the indices [n] int64, in their order."""
        new = torch.ones(len(index), dtype=torch.bool, device=index.device)
        new[1:] = index[1:] - index[:-1] != 1
        start = new.nonzero()[:, 0]
        return cls(index[start], torch.diff(start, append=start.new_tensor([len(index)])))

    @classmethod
    def joined(cls, parts: Sequence[PixelSet]) -> PixelSet:
        """The indices of all parts, one part after the other. There must be at least one part."""
        whole = GrowingPixelSet(parts[0].device)
        for part in parts:
            whole.add(part)
        return whole.finished()

    def empty(self) -> PixelSet:
        """A set of no pixels, on the same device."""
        return PixelSet(self._first[:0], self._length[:0])

    def state(self) -> Tensor:
        """First indices and lengths of the runs, [2, R] int64, as they are saved on the disk."""
        return torch.stack([self._first, self._length])

    @classmethod
    def from_state(cls, state: Tensor) -> PixelSet:
        """The inverse of `state`."""
        return cls(*state)

    def to(self, device: torch.device | str) -> PixelSet:
        """The same set on another device."""
        return PixelSet(self._first.to(device), self._length.to(device))

    @property
    def device(self) -> torch.device:
        """The device on which the indices are made."""
        return self._first.device

    def tensor(self) -> Tensor:
        """All indices [n] int64."""
        shift = torch.repeat_interleave(self._first - self._before, self._length, output_size=self._count)
        return shift.add_(torch.arange(self._count, device=self.device))

    def split(self, size: int) -> Iterator[Tensor]:
        """All indices in their order, at most `size` [m] int64 at a time."""
        return (self[start : start + size] for start in range(0, self._count, size))

    def __len__(self) -> int:
        return self._count

    def __getitem__(self, place: Tensor | slice) -> Tensor:
        if isinstance(place, slice):
            place = torch.arange(*place.indices(self._count), device=self.device)
        elif place.dtype == torch.bool:
            place = place.nonzero()[:, 0]
        run = torch.searchsorted(self._before, place, right=True) - 1
        return self._first[run] + (place - self._before[run])


class GrowingPixelSet:
    """Collects sets, one after the other, in a single piece of memory.

    A list of many small sets, made between large temporary arrays, would keep the heap from reusing the memory of those
    arrays: 3.8 GB for 240 million pixels, where this class takes 0.4 GB.
    """

    def __init__(self, device: torch.device | str) -> None:
        self._runs, self._used = torch.empty(2, 1024, dtype=torch.int64, device=device), 0

    def add(self, part: PixelSet) -> None:
        """Append the indices of `part`."""
        runs = part.state()
        end = self._used + runs.shape[1]
        if end > self._runs.shape[1]:
            larger = self._runs.new_empty(2, 2 * end)
            larger[:, : self._used] = self._runs[:, : self._used]
            self._runs = larger
        self._runs[:, self._used : end] = runs
        self._used = end

    def finished(self) -> PixelSet:
        """All indices that were added, as one set."""
        return PixelSet.from_state(self._runs[:, : self._used].clone())
