"""Muon for many small matrices: all of one shape are orthogonalised together."""

from __future__ import annotations

import math
from typing import Any

import torch


class BatchedMuon(torch.optim.Muon):
    """`torch.optim.Muon` with `adjust_lr_fn="match_rms_adamw"`, Nesterov momentum and no weight decay.

    The framework's own takes one matrix after another, about forty small kernels each, and a GPU waits for
    their launches. Here the Newton-Schulz iteration runs on stacks of equal shape. Its states are the framework's.
    On a CPU it computes in float32, not in bfloat16 as the framework does: a processor without instructions for
    bfloat16 multiplies matrices of 256 x 256 sixty times more slowly in it.

    Args:
        params: Matrices.
        lr: Learning rate of Adam, to whose update size the steps are scaled.
    """

    def __init__(self, params: Any, lr: float) -> None:
        super().__init__(params, lr=lr, weight_decay=0.0, adjust_lr_fn="match_rms_adamw")

    @torch.no_grad()
    def step(self, closure: Any = None) -> Any:
        """One step; as of any optimiser."""
        loss = None
        if closure is not None:
            with torch.enable_grad():
                loss = closure()
        for group in self.param_groups:
            shapes: dict[tuple[int, ...], list[torch.Tensor]] = {}
            for value in group["params"]:
                if value.grad is not None:
                    shapes.setdefault(tuple(value.shape), []).append(value)
            for values in shapes.values():
                self._move(values, group)
        return loss

    def _move(self, values: list[torch.Tensor], group: dict[str, Any]) -> None:
        """Step matrices of one shape."""
        gradients = [value.grad for value in values if value.grad is not None]
        for value in values:
            if "momentum_buffer" not in self.state[value]:
                self.state[value]["momentum_buffer"] = torch.zeros_like(value)
        buffers = [self.state[value]["momentum_buffer"] for value in values]
        torch._foreach_lerp_(buffers, gradients, 1.0 - group["momentum"])  # pyright: ignore[reportPrivateImportUsage]
        ahead = torch._foreach_lerp(gradients, buffers, group["momentum"])  # pyright: ignore[reportPrivateImportUsage]
        directions = orthogonalised(torch.stack(list(ahead)), group["ns_coefficients"], group["ns_steps"], group["eps"])
        rate = group["lr"] * 0.2 * math.sqrt(max(values[0].shape))
        steps = list(directions.to(values[0].dtype).unbind())
        torch._foreach_add_(values, steps, alpha=-rate)  # pyright: ignore[reportPrivateImportUsage]


def orthogonalised(
    matrices: torch.Tensor, coefficients: tuple[float, float, float], steps: int, eps: float
) -> torch.Tensor:
    """Matrices (K, M, N) with their singular values moved to about one, by Newton-Schulz iterations.

    They are computed in bfloat16, on a CPU in float32.
    """
    a, b, c = coefficients
    tall = matrices.shape[1] > matrices.shape[2]
    x = matrices.float() if matrices.device.type == "cpu" else matrices.bfloat16()
    x = x.mT if tall else x
    x = x / torch.linalg.vector_norm(x, dim=(1, 2), keepdim=True).clamp(min=eps)
    for _ in range(steps):
        gram = x @ x.mT
        x = torch.baddbmm(x, torch.baddbmm(gram, gram, gram, beta=b, alpha=c), x, beta=a)
    return x.mT if tall else x
