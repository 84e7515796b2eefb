"""Averaged weights: those of a run's last steps, which are saved and shown."""

from __future__ import annotations

import torch
from torch.optim.swa_utils import AveragedModel

from gazenerf.field.model import TwoStreamField


def kept_share(updates: int, decay: float) -> float:
    """Part of the average that an update keeps, after so many updates."""
    return min(decay, (updates + 1) / (updates + 10))


def average_weights(model: TwoStreamField, decay: float) -> AveragedModel:
    """Averaged weights that start as the model's own; after n updates a part min(decay, (n + 1) / (n + 10)) is kept."""

    def blend(
        averaged: tuple[torch.Tensor, ...] | list[torch.Tensor],
        current: tuple[torch.Tensor, ...] | list[torch.Tensor],
        updates: torch.Tensor | int,
    ) -> None:
        kept = kept_share(int(updates), decay)
        for mean, value in zip(averaged, current, strict=True):
            mean.lerp_(value, 1.0 - kept)

    found = AveragedModel(model, multi_avg_fn=blend)
    found.update_parameters(model)
    return found


@torch.no_grad()
def update_average(average: AveragedModel, model: TwoStreamField, updates: int, decay: float) -> None:
    """`average.update_parameters(model)` after `updates` of them, in one kernel and without asking the device."""
    means: list[torch.Tensor] = [*average.module.parameters()]
    values: list[torch.Tensor] = [*model.parameters()]
    torch._foreach_lerp_(means, values, 1.0 - kept_share(updates, decay))  # pyright: ignore[reportPrivateImportUsage]
    average.n_averaged += 1
