"""Values with their optimiser, as what a learner can put down and take up again."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import torch


class Optimised:
    """Named values that an optimiser moves.

    Args:
        values: Name to what is learned.
        optimizer: Of these values.
    """

    def __init__(self, values: Mapping[str, torch.Tensor], optimizer: torch.optim.Optimizer) -> None:
        self.values, self.optimizer = dict(values), optimizer

    def descend(self, loss: torch.Tensor) -> float:
        """One step down a loss; its value before."""
        self.optimizer.zero_grad(set_to_none=True)
        loss.backward()
        self.optimizer.step()
        return float(loss.detach())

    def state(self) -> dict[str, Any]:
        """Everything that the next steps depend on."""
        values = {name: value.detach() for name, value in self.values.items()}
        return {"values": values, "optimizer": self.optimizer.state_dict()}

    def restore(self, state: Mapping[str, Any]) -> None:
        """Go on from what `state` gave.

        Raises:
            ValueError: it is of other values.
        """
        found = state["values"]
        if {name: value.shape for name, value in found.items()} != {n: v.shape for n, v in self.values.items()}:
            raise ValueError("it is of other weights")
        with torch.no_grad():
            for name, value in self.values.items():
                value.copy_(found[name])
        self.optimizer.load_state_dict(state["optimizer"])
