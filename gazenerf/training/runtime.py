"""Where a step runs: one device through torch, several through Lightning Fabric."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from typing import Any

import torch
from torch import nn

from gazenerf.errors import UserError
from gazenerf.training.optimizers import Optimizers


def fast_bfloat16(device: torch.device) -> bool:
    """Whether bfloat16 matrix products pay on a device: any recent GPU, a CPU with matrix tiles."""
    if device.type == "cuda":
        return torch.cuda.is_bf16_supported()
    supported = getattr(torch.cpu, "_is_amx_tile_supported", lambda: False)
    return bool(supported())


class Runtime:
    """Moves, casts and steps an objective on one device or several.

    Args:
        device: `auto`, `cpu` or `cuda`.
        devices: How many; more than one needs the `lightning` package.
        precision: `auto`, `float32` or `bfloat16`.

    Raises:
        UserError: the device is not there, or several were asked for without Lightning Fabric.
    """

    def __init__(self, device: str = "auto", devices: int = 1, precision: str = "auto") -> None:
        if device == "auto":
            device = "cuda" if torch.cuda.is_available() else "cpu"
        if device == "cuda" and not torch.cuda.is_available():
            raise UserError("no CUDA device is visible; use --device cpu")
        self.fabric: Any = None
        self.rank, self.world = 0, 1
        if devices > 1:
            try:
                from lightning.fabric import Fabric  # pyright: ignore[reportMissingImports]
            except ImportError as error:
                raise UserError("training on several devices needs: pip install gazenerf[multi-gpu]") from error
            self.fabric = Fabric(accelerator=device, devices=devices)
            self.fabric.launch()
            self.rank, self.world = int(self.fabric.global_rank), int(self.fabric.world_size)
            self.device = torch.device(self.fabric.device)
        else:
            self.device = torch.device(device)
        if precision not in ("auto", "float32", "bfloat16"):
            raise UserError(f"unknown precision {precision!r}; use auto, float32 or bfloat16")
        self.bfloat16 = precision == "bfloat16" or (precision == "auto" and fast_bfloat16(self.device))

    def setup(self, objective: nn.Module, optimizers: Optimizers) -> nn.Module:
        """The objective, wrapped for this runtime; the optimisers are wrapped in place."""
        if self.fabric is None:
            return objective.to(self.device)
        wrapped, *optimizers.members = self.fabric.setup(objective, *optimizers.members)
        return wrapped

    @contextlib.contextmanager
    def autocast(self) -> Iterator[None]:
        """Mixed precision where it pays."""
        with torch.autocast(self.device.type, dtype=torch.bfloat16, enabled=self.bfloat16):
            yield

    def backward(self, loss: torch.Tensor) -> None:
        """Gradients of a loss, averaged over devices."""
        if self.fabric is None:
            loss.backward()
        else:
            self.fabric.backward(loss)
