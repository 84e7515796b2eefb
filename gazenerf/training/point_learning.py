"""What is learned from points rather than from pictures: one optimiser's steps, and the state from which they go on."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import torch
from torch import nn

from gazenerf.errors import UserError
from gazenerf.files import whole_file

LAST_RATE = 0.02
"""Share of the learning rate at which the cosine ends."""


class PointLearning(ABC):
    """Adam with a warm-up and a cosine, whose steps draw the same points again when they are repeated.

    Args:
        networks: Name to what is kept in the state.
        parameters: Of them, those that are learned.
        steps: Optimiser steps of the whole run.
        learning_rate: Its peak.
        seed: Of the steps.

    Attributes:
        step: Steps done.
        what, setting: What is learned, and the setting that is its learning rate, for messages.
        misfit: End of the message about a state that does not fit.
        warmup: Steps of linear warm-up.
    """

    what: str
    setting: str
    misfit: str
    warmup: int

    def __init__(
        self,
        networks: Mapping[str, nn.Module],
        parameters: Iterable[nn.Parameter],
        steps: int,
        learning_rate: float,
        seed: int,
    ) -> None:
        self._networks, self._parameters = networks, list(parameters)
        self._steps, self._rate, self._seed = steps, learning_rate, seed
        self._optimizer = torch.optim.Adam(self._parameters, lr=learning_rate)
        self.step = 0

    @abstractmethod
    def loss(self, generator: torch.Generator) -> torch.Tensor:
        """The loss of points that the generator draws."""

    def generator(self, step: int) -> torch.Generator:
        """Draws the points of a step."""
        return torch.Generator().manual_seed(self._seed * 1_000_003 + step)

    def advance(self) -> float:
        """One step; its loss.

        Raises:
            UserError: the loss is not finite.
        """
        for group in self._optimizer.param_groups:
            group["lr"] = self._rate * _share_of_rate(self.step, self._steps, self.warmup)
        loss = self.loss(self.generator(self.step))
        self._optimizer.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(self._parameters, 1.0)
        self._optimizer.step()
        self.step += 1
        value = float(loss.detach())
        if not math.isfinite(value):
            raise UserError(f"the loss of the {self.what} is not finite at step {self.step}; lower {self.setting}")
        return value

    def save(self, path: Path) -> None:
        """Write the state to resume from."""
        state = {
            "networks": {name: network.state_dict() for name, network in self._networks.items()},
            "optimizer": self._optimizer.state_dict(),
            "step": self.step,
        }
        with whole_file(path) as temporary:
            torch.save(state, temporary)

    def load(self, state: dict[str, Any], path: Path) -> None:
        """Go on from what `save` wrote to a file.

        Raises:
            UserError: it is of other networks.
        """
        try:
            for name, network in self._networks.items():
                network.load_state_dict(state["networks"][name])
            self._optimizer.load_state_dict(state["optimizer"])
        except (KeyError, ValueError, RuntimeError) as error:
            reason = " ".join(str(error).split())[:200]
            raise UserError(f"cannot resume from {path} ({reason}); {self.misfit}") from error
        self.step = int(state["step"])


def _share_of_rate(step: int, steps: int, warmup: int) -> float:
    """Share of the learning rate at a step: linear warm-up, then a cosine."""
    fallen = 0.5 * (1.0 + math.cos(math.pi * step / max(1, steps)))
    return min(1.0, (step + 1) / warmup) * (LAST_RATE + (1.0 - LAST_RATE) * fallen)
