"""The precision in which the kernels compute: float32 for the fields, or float64 where the input is float64 (in tests)."""

from __future__ import annotations

from torch import Tensor


def at_least_float32(*values: Tensor) -> list[Tensor]:
    """The values with bfloat16 and half converted to float32, differentiably; other types stay as they are.

    A bfloat16 has 8 bits of precision. That is enough to store radiance, but too coarse to sum it or to place a surface.
    NumPy, and so Numba, does not know bfloat16. Fields may be stored in bfloat16; computations with them are in float32.
    """
    return [value.float() if value.is_floating_point() and value.element_size() < 4 else value for value in values]
