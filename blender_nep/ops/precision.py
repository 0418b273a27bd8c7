"""Which precision the kernels compute in: float32 (the fields), or float64 where that is given (the tests)."""

from __future__ import annotations

from torch import Tensor


def at_least_float32(*values: Tensor) -> list[Tensor]:
    """bfloat16 and half as float32, differentiably; others as they are.

    A bfloat16 has 8 bits: good enough to store radiance in, too coarse to accumulate it or to tell where a surface is, and
    NumPy, and so Numba, does not know it. Fields may be stored in it; what is computed from them is float32.
    """
    return [value.float() if value.is_floating_point() and value.element_size() < 4 else value for value in values]
