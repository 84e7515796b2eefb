"""The models that the paper compares, and its loss ladder, as changes of a preset.

A model says what a field is (Sec. 4.4, Sec. 4.5) and which pixel error and functional loss it learns by. The ladder
adds the paper's four losses one after the other (supplementary, "Ablations on loss components").
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

from gazenerf.errors import UserError
from gazenerf.field.config import ABLATIONS
from gazenerf.names import did_you_mean
from gazenerf.training.config import TrainConfig


@dataclass(frozen=True)
class Model:
    """One row of the paper's tables.

    Attributes:
        row: The paper's name of it.
        field: Values of `FieldConfig` that differ from the preset's.
        training: Values of `TrainConfig` that differ from the preset's.
    """

    row: str
    field: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    training: Mapping[str, Any] = dataclasses.field(default_factory=dict)


_WITHOUT: dict[str, Any] = {"functional": 0.0}

MODELS: dict[str, Model] = {
    "gazenerf": Model("GazeNeRF (Two-stream + rotation + L_F)"),
    "headnerf": Model("HeadNeRF", ABLATIONS["vanilla"], {**_WITHOUT, "pixel_error": "l2"}),
    "vanilla": Model("vanilla-GazeNeRF", ABLATIONS["vanilla"], _WITHOUT),
    "vanilla+rotation": Model("vanilla-GazeNeRF+rotation", ABLATIONS["vanilla+rotation"], _WITHOUT),
    "two-stream": Model("Two-stream", ABLATIONS["two-stream"], _WITHOUT),
    "two-stream+rotation": Model("Two-stream+rotation", ABLATIONS["two-stream+rotation"], _WITHOUT),
    "vanilla+functional": Model("vanilla-GazeNeRF+L_F", ABLATIONS["vanilla"], {"functional": 1.0}),
}
"""Name to model. `gazenerf` is the preset as it is: the paper's losses with `paper`, no functional loss with others."""

STED = "sted"
"""The name of the paper's other baseline, which is no field; see `gazenerf.baselines.sted`."""

LADDER: dict[str, tuple[str, ...]] = {
    "R": (),
    "R+P": ("perceptual",),
    "R+P+D": ("perceptual", "disentanglement"),
    "R+P+D+F": ("perceptual", "disentanglement", "functional"),
}
"""Step to the losses that it has beside the reconstruction: perceptual, disentanglement, functional."""

_LOSSES = LADDER["R+P+D+F"]


def as_model(config: TrainConfig, name: str) -> TrainConfig:
    """A preset's run with the field and losses of a model.

    Raises:
        UserError: there is no such model.
    """
    if name not in MODELS:
        raise UserError(f"unknown model {name!r}{did_you_mean(name, MODELS)}; there are {', '.join(MODELS)}")
    model = MODELS[name]
    return replace(config, field_overrides={**config.field_overrides, **model.field}, **model.training)


def with_losses(config: TrainConfig, step: str) -> TrainConfig:
    """The same run with the losses of one step of the ladder: the run's own weights, or 1 (paper Sec. 4.2) where it
    has none. Losses that are not the paper's stay.

    Raises:
        UserError: there is no such step.
    """
    if step not in LADDER:
        raise UserError(f"unknown losses {step!r}{did_you_mean(step, LADDER)}; there are {', '.join(LADDER)}")
    weights = {name: (getattr(config, name) or 1.0) if name in LADDER[step] else 0.0 for name in _LOSSES}
    return replace(config, **weights)


def check_losses(config: TrainConfig) -> None:
    """Refuse losses that a run could not have.

    Raises:
        UserError: see above.
    """
    if config.disentanglement and not config.learn_codes:
        raise UserError(
            "the disentanglement loss pulls learned codes back, and this preset learns none; choose --preset paper, or "
            "add --set learn_codes=true"
        )
    if config.perceptual and config.perceptual_backbone == "none":
        raise UserError(
            "the perceptual loss compares features of a network, and this preset has none; add --set "
            "perceptual_backbone=alexnet (or vgg16)"
        )
