"""A torch device that behaves like a graphics card, for machines that have none.

Its tensors lie in ordinary memory, but torch refuses most of what it refuses for a graphics card: an operation on tensors of
both devices, a random generator of the other device, and a NumPy array of such a tensor. So a forgotten `.cpu()` or a
forgotten `device=` fails here as it would fail there. Kernels of the CPU refuse the tensors too, because Numba wants arrays.
What remains for a real graphics card to show is speed, and the rounding of its kernels.

The device is called `meta`, because torch accepts no invented name; torch's own `meta` tensors, which have no values, are
not used here.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import contextmanager
from typing import Any

import torch
from torch.utils._python_dispatch import TorchDispatchMode, return_and_correct_aliasing
from torch.utils._pytree import tree_iter, tree_map

DEVICE = torch.device("meta")
"""The device of the tensors."""

_COPIES = {torch.ops.aten.copy_.default, torch.ops.aten._to_copy.default}
_INDEXED = {torch.ops.aten.index.Tensor, torch.ops.aten.index_put.default, torch.ops.aten.index_put_.default}
"""A tensor of the graphics card may be copied from and to the CPU, and may be indexed by tensors of the CPU."""
_JOINS = {torch.ops.aten.cat.default, torch.ops.aten.stack.default}
"""These do not take a single number of the CPU either."""


class CardTensor(torch.Tensor):
    """A tensor of the device; `inner` holds its values."""

    inner: torch.Tensor
    __torch_function__ = torch._C._disabled_torch_function_impl  # type: ignore[assignment]  # operations are enough

    @staticmethod
    def __new__(cls, inner: torch.Tensor) -> CardTensor:
        return torch.Tensor._make_wrapper_subclass(  # type: ignore[attr-defined]  # torch documents it for subclasses
            cls,
            inner.size(),
            strides=inner.stride(),
            storage_offset=inner.storage_offset(),
            dtype=inner.dtype,
            device=DEVICE,
        )

    def __init__(self, inner: torch.Tensor) -> None:
        self.inner = inner

    def tolist(self) -> Any:
        """torch refuses this for subclasses."""
        return self.inner.tolist()

    def new_tensor(self, data: Any, dtype: torch.dtype | None = None) -> torch.Tensor:
        """torch would make a tensor of its own `meta` device."""
        return torch.tensor(data, dtype=dtype or self.dtype, device=DEVICE)

    def __getitem__(self, index: Any) -> torch.Tensor:
        """torch would make an index of its own `meta` device from a list."""
        parts = index if isinstance(index, tuple) else (index,)
        return super().__getitem__(tuple(torch.tensor(part) if isinstance(part, list) else part for part in parts))

    @classmethod
    def __torch_dispatch__(cls, operation, types, arguments=(), keywords=None):
        return _do(operation, arguments, dict(keywords or {}))


class _Mode(TorchDispatchMode):
    """Sees every operation, also those that make a tensor on the device."""

    def __torch_dispatch__(self, operation, types, arguments=(), keywords=None):
        return _do(operation, arguments, dict(keywords or {}))


_PLAIN = torch.Generator
_generators: list[torch.Generator] = []
"""All generators of the device. torch hands an operation a new Python object of a generator, so `_cdata` is compared."""


class _Generator(_PLAIN):
    """A random generator of the device. For another device, a plain one is made in its place."""

    device = property(lambda self: DEVICE)  # type: ignore[assignment]  # of the base class

    def __new__(cls, device: torch.device | str = "cpu") -> torch.Generator:
        if torch.device(device).type != DEVICE.type:
            return _PLAIN(device)
        generator = super().__new__(cls)
        _generators.append(generator)
        return generator


def _do(operation, arguments, keywords):
    """Do the operation with the values, and hold the result if it belongs to the device."""
    tensors = [value for value in tree_iter((arguments, keywords)) if isinstance(value, torch.Tensor)]
    held = [value for value in tensors if isinstance(value, CardTensor)]
    device = keywords.get("device")
    on_device = bool(held) if device is None else device.type == DEVICE.type
    if operation not in _COPIES:
        _refuse_both_devices(operation, arguments, tensors, held)
    generator = keywords.get("generator")
    if generator is not None and any(own._cdata == generator._cdata for own in _generators) != on_device:
        raise RuntimeError(f"{operation}: expected a generator of the tensor's device")
    inner_arguments, inner_keywords = tree_map(_inner, (arguments, keywords))
    if device is not None:
        inner_keywords["device"] = torch.device("cpu")
    result = operation(*inner_arguments, **inner_keywords)
    if operation is torch.ops.aten.copy_.default:
        return arguments[0]
    if not on_device:
        return result
    result = tree_map(_held, result)
    return return_and_correct_aliasing(operation, arguments, keywords, result) if held else result


def _inner(value: Any) -> Any:
    return value.inner if isinstance(value, CardTensor) else value


def _held(value: Any) -> Any:
    return CardTensor(value) if isinstance(value, torch.Tensor) else value


def _refuse_both_devices(operation, arguments: Sequence, tensors: list[torch.Tensor], held: list[torch.Tensor]) -> None:
    """Raises RuntimeError for an operation on tensors of both devices. A single number of the CPU may take part, but not be
    joined to tensors. Raises NotImplementedError for a tensor of torch's own `meta` device.
    """
    if any(value.device == DEVICE and not isinstance(value, CardTensor) for value in tensors):
        raise NotImplementedError(f"{operation}: torch has made a tensor without values behind the pretended device's back")
    if not held:
        return
    if operation in _INDEXED and isinstance(arguments[0], CardTensor):
        tensors = [value for value in tree_iter((arguments[0], arguments[2:])) if isinstance(value, torch.Tensor)]
    least = 0 if operation in _JOINS else 1
    if any(not isinstance(value, CardTensor) and value.dim() >= least for value in tensors):
        raise RuntimeError(f"{operation}: expected all tensors to be on the same device, but found {DEVICE} and cpu")


def _made_on_the_cpu_first(make):
    """`torch.tensor` or `torch.as_tensor` for the device: they make tensors in a way that no dispatch mode sees."""

    def made(data, dtype=None, device=None):
        if device is None or torch.device(device).type != DEVICE.type:
            return make(data, dtype=dtype, device=device)
        return make(data, dtype=dtype, device=None if isinstance(data, CardTensor) else "cpu").to(DEVICE)

    return made


@contextmanager
def pretended_gpu(monkeypatch):
    """In this context, `torch.device("meta")` is the pretended graphics card."""
    monkeypatch.setattr(torch, "Generator", _Generator)
    for name in ("tensor", "as_tensor"):
        monkeypatch.setattr(torch, name, _made_on_the_cpu_first(getattr(torch, name)))
    with _Mode():
        yield DEVICE
