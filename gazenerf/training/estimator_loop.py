"""The epochs in which an estimator learns: a cosine schedule, and a state after each epoch to resume from."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import nn

from gazenerf.errors import UserError
from gazenerf.files import whole_file

WARM_STEPS = 50
LEAST_SHARE = 0.02
"""Of the learning rate, at the end."""


@dataclass(frozen=True)
class EpochSettings:
    """How long and how fast.

    Attributes:
        epochs: Passes over the pictures.
        batch: Pictures a step.
        learning_rate: Of AdamW, at its highest.
        seed: Of order and augmentation, 0 or more.
    """

    epochs: int
    batch: int
    learning_rate: float
    seed: int = 0

    def steps(self, pictures: int) -> int:
        """Steps of all epochs."""
        return self.epochs * math.ceil(pictures / self.batch)


def train_epochs(
    network: nn.Module,
    loss_of: Callable[[torch.Tensor], torch.Tensor],
    pictures: int,
    settings: EpochSettings,
    *,
    about: dict[str, Any] | None = None,
    state: str | Path | None = None,
    on_step: Callable[[int], None] = lambda _: None,
    on_epoch: Callable[[int, float], None] = lambda *_: None,
) -> dict[str, Any]:
    """Train a network in place, from its weights or from `state` when that file is there.

    Args:
        network: In training mode while it learns.
        loss_of: Indices of pictures (B,) to their loss.
        pictures: How many there are.
        settings: See `EpochSettings`.
        about: What else tells this run from another.
        state: Written after every epoch, to resume from.
        on_step: Called with the steps that are done.
        on_epoch: Called with (epochs done, mean loss).

    Returns:
        What tells this run from another.

    Raises:
        UserError: the state file belongs to another run or is damaged, or the loss is not finite.
    """
    run = {**asdict(settings), "pictures": pictures, **(about or {})}
    optimizer = torch.optim.AdamW(network.parameters(), lr=settings.learning_rate, weight_decay=1e-3)
    first = _resumed(network, optimizer, run, state)
    steps = math.ceil(pictures / settings.batch)
    for epoch in range(first, settings.epochs):
        network.train()
        torch.manual_seed(settings.seed * 7919 + epoch + 1)
        order = torch.randperm(pictures)
        losses = []
        for step in range(steps):
            rows = order[step * settings.batch : (step + 1) * settings.batch]
            if len(rows) >= 2:
                _set_rate(optimizer, settings, epoch, step, steps)
                losses.append(_step(network, optimizer, loss_of(rows), epoch))
            on_step(epoch * steps + step + 1)
        if state is not None:
            _save(network, optimizer, epoch + 1, run, state)
        on_epoch(epoch + 1, float(np.mean(losses)))
    network.eval()
    return run


def labels_hash(*labels: torch.Tensor) -> str:
    """SHA-256, 16 digits, of what pictures are labelled with; tells runs on other data apart."""
    return hashlib.sha256(b"".join(label.numpy().tobytes() for label in labels)).hexdigest()[:16]


def _set_rate(optimizer: torch.optim.Optimizer, settings: EpochSettings, epoch: int, step: int, steps: int) -> None:
    share = (epoch + step / steps) / settings.epochs
    warm = min(1.0, (epoch * steps + step + 1) / WARM_STEPS)
    fall = LEAST_SHARE + (1.0 - LEAST_SHARE) * 0.5 * (1 + math.cos(math.pi * share))
    for group in optimizer.param_groups:
        group["lr"] = settings.learning_rate * warm * fall


def _step(network: nn.Module, optimizer: torch.optim.Optimizer, loss: torch.Tensor, epoch: int) -> float:
    if not torch.isfinite(loss):
        raise UserError(f"the loss is not finite in epoch {epoch + 1}; lower the learning rate")
    optimizer.zero_grad(set_to_none=True)
    loss.backward()
    torch.nn.utils.clip_grad_norm_(network.parameters(), 2.0)
    optimizer.step()
    return float(loss.detach())


def _save(
    network: nn.Module, optimizer: torch.optim.Optimizer, epoch: int, run: dict[str, Any], state: str | Path
) -> None:
    saved = {"estimator": network.state_dict(), "optimizer": optimizer.state_dict(), "epoch": epoch, "run": run}
    with whole_file(state) as temporary:
        torch.save(saved, temporary)


def _resumed(
    network: nn.Module, optimizer: torch.optim.Optimizer, run: dict[str, Any], state: str | Path | None
) -> int:
    """The epochs that are done already."""
    if state is None or not Path(state).is_file():
        return 0
    try:
        saved = torch.load(state, map_location="cpu", weights_only=True)
        if saved["run"] != run:
            raise UserError(f"{state} belongs to another run; delete it or repeat that run's settings")
        network.load_state_dict(saved["estimator"])
        optimizer.load_state_dict(saved["optimizer"])
        return int(saved["epoch"])
    except UserError:
        raise
    except Exception as error:
        raise UserError(f"cannot resume from {state}: {' '.join(str(error).split())[:160]}; delete it") from error
