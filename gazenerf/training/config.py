"""What a training run does, as data: losses, sampling, schedule. Presets are named."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

from gazenerf.names import did_you_mean
from gazenerf.training.losses import PIXEL_ERRORS
from gazenerf.training.optimizers import OPTIMIZERS


@dataclass(frozen=True)
class TrainConfig:
    """One training run. Weights of zero switch a term off.

    Attributes:
        field_preset: Name of the field's own preset (`gazenerf.field.config.PRESETS`).
        field_overrides: Fields of `FieldConfig` that differ from the preset.
        steps: Optimiser steps.
        batch: Pictures per step.
        optimizer: `adam` as in the paper, or `muon` for the hidden layers (see `optimizers`).
        muon_learning_rate: Muon's learning rate over Adam's.
        learning_rate: Peak learning rate of Adam (paper Sec. 4.2: 1e-4, constant).
        final_learning_rate: Where the cosine ends; equal to `learning_rate` keeps it constant.
        density_learning_rate: How much faster the density layers learn.
        warmup: Steps of linear warm-up.
        shell: Half width, world units, of the shell of samples around the captured surface; None
            samples the published slabs.
        shell_samples: Samples per ray inside the shell.
        shell_noise: Standard deviation of the shell's centre, world units, so that a field learns
            to be queried around a surface it found itself.
        reconstruction, perceptual, functional, disentanglement: The paper's lambdas (Sec. 4.2).
        pixel_error: What differences between pictures cost: `l1` as in the paper's Eq. 5, or `l2`, their squares, as in
            HeadNeRF (Sec. 4.4).
        functional_content: Initial weight of the gaze term and its growth an epoch.
        code_weights: w of identity, expression, texture, illumination in the disentanglement loss.
        learn_codes: Learn per-picture offsets to the four codes.
        learn_cameras: Learn per-picture Euler angles and translations of the camera.
        depth, surface, opacity, empty, eyeball: Geometry terms for captures that know depth and eyeballs.
        background_weight: The same error outside the head mask (the paper has none).
        level_background: Save the background as what it is along its upper edge, for captures before one colour: where
            heads always hide it, it is never learned.
        eyes_weight: The same error inside the eye mask of the merged picture (the paper has none).
        geometry_decay: Geometry weights end at this share of their start.
        geometry_steps: Steps in which a field of geometry `distance` learns its surfaces from points of the head
            model's people, before the first picture; then they are held.
        geometry_people: How many people are drawn for that.
        geometry_learning_rate: Peak learning rate of those steps.
        perceptual_backbone: `vgg16`, `alexnet` or `none`.
        perceptual_stages: How many of the backbone's five maps are compared, shallow ones first.
        perceptual_start: Share of the run before the perceptual term starts.
        window: Height and width, feature pixels, of a window that a step renders of each picture instead of the whole:
            many small steps instead of few large ones. None renders whole pictures.
        window_eyes, window_mouth: Shares of the windows that lie around the eyes and around the mouth.
        streams_every: The face-only picture is rendered every this many steps.
        ema: Decay of the averaged weights that are saved; 0 saves the last ones.
        gradient_clip: Largest gradient norm.
        seed: Seeds everything; step s of a resumed run draws what step s of an unbroken one does.
    """

    field_preset: str = "small"
    field_overrides: dict[str, Any] = dataclasses.field(default_factory=dict)
    steps: int = 2600
    batch: int = 2
    optimizer: str = "muon"
    muon_learning_rate: float = 1.5
    learning_rate: float = 1e-3
    final_learning_rate: float = 3e-5
    density_learning_rate: float = 3.0
    warmup: int = 50
    shell: float | None = 0.15
    shell_samples: int = 6
    shell_noise: float = 0.02
    reconstruction: float = 1.0
    pixel_error: str = "l1"
    perceptual: float = 0.03
    functional: float = 0.0
    disentanglement: float = 0.0
    functional_content: float = 1e-3
    code_weights: tuple[float, float, float, float] = (1e-3, 1.0, 1e-3, 1e-3)
    learn_codes: bool = False
    learn_cameras: bool = False
    depth: float = 0.3
    surface: float = 0.4
    opacity: float = 0.3
    empty: float = 0.005
    eyeball: float = 0.01
    background_weight: float = 0.5
    level_background: bool = True
    eyes_weight: float = 1.0
    geometry_decay: float = 0.3
    geometry_steps: int = 5000
    geometry_people: int = 700
    geometry_learning_rate: float = 1.5e-3
    perceptual_backbone: str = "alexnet"
    perceptual_stages: int = 5
    perceptual_start: float = 0.3
    window: tuple[int, int] | None = None
    window_eyes: float = 0.5
    window_mouth: float = 0.0
    streams_every: int = 4
    ema: float = 0.998
    gradient_clip: float = 10.0
    seed: int = 1

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return dataclasses.asdict(self)

    @classmethod
    def from_dict(cls, data: dict[str, Any]) -> TrainConfig:
        """Read what `to_dict` wrote.

        Raises:
            ValueError: an unknown setting.
        """
        known = {item.name for item in dataclasses.fields(cls)}
        if unknown := sorted(set(data) - known):
            raise ValueError(f"unknown training settings: {', '.join(unknown)}{did_you_mean(unknown[0], known)}")
        values = dict(data)
        if values.get("optimizer", "adam") not in OPTIMIZERS:
            raise ValueError(f"optimizer must be one of {', '.join(OPTIMIZERS)}")
        if values.get("pixel_error", "l1") not in PIXEL_ERRORS:
            raise ValueError(f"pixel_error must be one of {', '.join(PIXEL_ERRORS)}")
        if not 1 <= int(values.get("perceptual_stages", 5)) <= 5:
            raise ValueError("perceptual_stages goes from 1 to 5")
        if values.get("window") is not None:
            values["window"] = _window(values["window"])
        shares = [float(values.get(name, default)) for name, default in (("window_eyes", 0.5), ("window_mouth", 0.0))]
        if not 0.0 <= min(shares) <= sum(shares) <= 1.0:
            raise ValueError("window_eyes and window_mouth go from 0 to 1, and so does their sum")
        if "code_weights" in values:
            values["code_weights"] = tuple(values["code_weights"])
        return cls(**values)


def _window(value: Any) -> tuple[int, int]:
    """The height and width of a window.

    Raises:
        ValueError: it is something else, or too small for anything to be left within its margins.
    """
    two = isinstance(value, list | tuple) and len(value) == 2 and all(type(side) is int for side in value)
    if not two or min(value) < SMALLEST_WINDOW:
        raise ValueError(f"window must be [height, width] in feature pixels, {SMALLEST_WINDOW} or more each")
    return value[0], value[1]


SMALLEST_WINDOW = 8
"""Feature pixels of a window's side."""

PRESETS: dict[str, TrainConfig] = {
    "small": TrainConfig(),
    "tiny": TrainConfig(
        field_preset="tiny",
        steps=60,
        geometry_steps=40,
        geometry_people=8,
        batch=1,
        shell=0.25,
        shell_samples=8,
        warmup=10,
        perceptual=0.0,
        perceptual_backbone="none",
    ),
    "paper": TrainConfig(
        field_preset="paper",
        steps=200_000,
        optimizer="adam",
        learning_rate=1e-4,
        final_learning_rate=1e-4,
        density_learning_rate=1.0,
        warmup=0,
        shell=None,
        perceptual=1.0,
        functional=1.0,
        disentanglement=1.0,
        learn_codes=True,
        learn_cameras=True,
        depth=0.0,
        surface=0.0,
        opacity=0.0,
        empty=0.0,
        eyeball=0.0,
        background_weight=0.0,
        level_background=False,
        eyes_weight=0.0,
        perceptual_backbone="vgg16",
        perceptual_start=0.0,
        streams_every=1,
        ema=0.0,
    ),
    "portrait": TrainConfig(
        field_preset="portrait",
        steps=3600,
        batch=10,
        warmup=100,
        perceptual=0.0179,
        perceptual_backbone="vgg16",
        perceptual_stages=4,
        perceptual_start=0.2,
    ),
}
"""`paper` follows Sec. 4.2; `small` is for a CPU, `portrait` for a GPU and pictures of 512 px; `tiny` is for tests."""
