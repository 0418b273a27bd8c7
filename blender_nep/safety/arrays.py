"""Checks arrays of files that somebody else may have made, before compiled code takes them: that checks no indices."""

from __future__ import annotations

from typing import Any

import numpy as np


def check_array(
    name: str, values: Any, shape: tuple[int | None, ...], *, low: float | None = None, high: float | None = None
) -> int:
    """Raises ValueError unless `values` is an array or tensor of this shape, whose numbers are finite and in low..high.

    None in `shape`: any length. Where `low` is an int, the numbers must be whole ones, such as indices. Returns the first
    length.
    """
    array = (
        values if isinstance(values, np.ndarray) else values.detach().cpu().numpy() if hasattr(values, "detach") else None
    )
    if array is None or array.dtype.kind not in "fiub":
        raise ValueError(f"{name} is no array of numbers")
    if array.ndim != len(shape) or any(n is not None and n != m for n, m in zip(shape, array.shape, strict=True)):
        raise ValueError(f"{name} has the shape {array.shape}")
    if isinstance(low, int) and array.dtype.kind not in "iu":
        raise ValueError(f"{name} holds no whole numbers")
    if array.size:
        least, most = array.min(), array.max()
        inside = (low is None or least >= low) and (high is None or most <= high)
        if not (np.isfinite(least) and np.isfinite(most) and inside):
            raise ValueError(f"{name} holds numbers from {least} to {most}")
    return len(array)
