"""A GPU that is not there: tensors that count as another device's, refuse to meet the CPU's, and compute on the CPU.

Code that runs on these tensors, with its own control flow, would run on a GPU: what it makes without
naming a device, reads by NumPy or mixes with the CPU's tensors fails here as it would there.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from typing import Any
from unittest import mock

import torch
from torch import nn
from torch.overrides import TorchFunctionMode
from torch.utils._pytree import tree_leaves

GPU = torch.device("cuda", 0)

_FACTORIES = {
    torch.zeros, torch.ones, torch.empty, torch.full, torch.arange, torch.linspace, torch.eye, torch.tensor, torch.rand,
    torch.randn, torch.as_tensor,
}  # fmt: skip
_TO_NUMPY = {torch.Tensor.numpy, torch.Tensor.__array__}


class OnGPU(torch.Tensor):
    """A tensor of the pretended device."""

    @classmethod
    def __torch_function__(
        cls, func: Callable[..., Any], types: Any, args: tuple[Any, ...] = (), kwargs: dict[str, Any] | None = None
    ) -> Any:
        kwargs = kwargs or {}
        if func == torch.Tensor.device.__get__:  # type: ignore[attr-defined]
            return GPU
        if func in _TO_NUMPY:
            raise TypeError(f"{func.__name__} of a tensor on the GPU; copy it by .cpu() first")
        if func is torch.Tensor.cpu or (func is torch.Tensor.to and _target(args, kwargs) == "cpu"):
            return _plain(args[0])
        if func is torch.Tensor.to and _target(args, kwargs) == "cuda":
            return super().__torch_function__(func, types, *_without_device(args, kwargs))
        kwargs = {name: value for name, value in kwargs.items() if name != "device"}
        for other in tree_leaves((args, kwargs)):
            if isinstance(other, torch.Tensor) and not isinstance(other, OnGPU) and other.dim():
                name = getattr(func, "__name__", str(func))
                raise RuntimeError(f"{name}: a CPU tensor {tuple(other.shape)} meets one on the GPU")
        return super().__torch_function__(func, types, args, kwargs)


class _Making(TorchFunctionMode):
    """Factories and copies that name the pretended device give its tensors."""

    def __torch_function__(
        self, func: Callable[..., Any], types: Any, args: tuple[Any, ...] = (), kwargs: dict[str, Any] | None = None
    ) -> Any:
        kwargs = kwargs or {}
        if func in _FACTORIES and torch.device(kwargs.get("device") or "cpu").type == "cuda":
            return func(*args, **{**kwargs, "device": "cpu"}).as_subclass(OnGPU)
        plain = bool(args) and isinstance(args[0], torch.Tensor) and not isinstance(args[0], OnGPU)
        if func is torch.Tensor.to and plain and _target(args, kwargs) == "cuda":
            args, kwargs = _without_device(args, kwargs)
            return func(*args, **kwargs).as_subclass(OnGPU)
        return func(*args, **kwargs)


def _target(args: tuple[Any, ...], kwargs: dict[str, Any]) -> str | None:
    """The kind of device that `Tensor.to` was asked for, None where it was not."""
    for value in (*args[1:], *kwargs.values()):
        if isinstance(value, torch.Tensor):
            return value.device.type
        if isinstance(value, torch.device) or (isinstance(value, str) and value.split(":")[0] in ("cpu", "cuda")):
            return torch.device(value).type
    return None


def _without_device(args: tuple[Any, ...], kwargs: dict[str, Any]) -> tuple[tuple[Any, ...], dict[str, Any]]:
    """The arguments of `Tensor.to` but for the device; of a tensor to be like, its type is kept."""

    def kept(value: Any) -> Any:
        return value.dtype if isinstance(value, torch.Tensor) else value

    def is_device(value: Any) -> bool:
        return isinstance(value, torch.device) or (isinstance(value, str) and value.split(":")[0] in ("cpu", "cuda"))

    rest = tuple(kept(value) for value in args[1:] if not is_device(value))
    named = {name: kept(value) for name, value in kwargs.items() if not is_device(value)}
    return (args[0], *(rest or (args[0].dtype,))), named


def _plain(tensor: torch.Tensor) -> torch.Tensor:
    with torch._C.DisableTorchFunctionSubclass():
        return tensor.as_subclass(torch.Tensor)


def move(module: nn.Module) -> nn.Module:
    """The module with its weights on the pretended device, in place."""
    for part in module.modules():
        for name, value in part._parameters.items():
            if value is not None:
                part._parameters[name] = nn.Parameter(value.detach().as_subclass(OnGPU), requires_grad=False)
        for name, value in part._buffers.items():
            if value is not None:
                part._buffers[name] = value.as_subclass(OnGPU)
    return module


class _Threads(ThreadPoolExecutor):
    """Threads in which there is the pretended GPU, too; PyTorch's modes are a thread's own."""

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        def there() -> Any:
            with _Making():
                return fn(*args, **kwargs)

        return super().submit(there)


@contextmanager
def pretended_gpu() -> Iterator[None]:
    """Within the block there is a GPU, also in threads of `gazenerf.workers`."""
    with mock.patch("gazenerf.workers.ThreadPoolExecutor", _Threads), _Making():
        yield
