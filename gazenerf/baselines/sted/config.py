"""Sizes of a STED, and what a training run of one does, as data."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any, TypeVar

from gazenerf.names import did_you_mean

Settings = TypeVar("Settings", "StedConfig", "StedTrainConfig")

_RANGES = {
    "image_size": (16, 1024),
    "growth": (1, 128),
    "layers": (1, 16),
    "appearance": (1, 8192),
    "one_d": (0, 64),
    "two_d": (2, 64),
    "width": (1, 256),
}
"""Lowest and highest value of each size."""


@dataclass(frozen=True)
class StedConfig:
    """A network's sizes; the defaults are the published ones.

    Attributes:
        image_size: Side of the pictures, a power of two. Blocks are as many as it takes to come down to 2 x 2 pixels.
        growth: Channels that each layer of a dense block adds.
        layers: Layers of a dense block.
        appearance: Size of the embedding that nothing turns.
        one_d, two_d: How many factors have one angle, and two; the last two are the head and the gaze.
        width: Columns of a factor's embedding.
    """

    image_size: int = 128
    growth: int = 32
    layers: int = 4
    appearance: int = 1024
    one_d: int = 4
    two_d: int = 4
    width: int = 16

    def __post_init__(self) -> None:
        for name, (low, high) in _RANGES.items():
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
                raise ValueError(f"{name} is {value!r}; whole numbers from {low} to {high} are possible")
        if self.image_size & (self.image_size - 1):
            raise ValueError(f"image_size must be a power of two, got {self.image_size}")

    @property
    def blocks(self) -> int:
        """Dense blocks of the encoder and of the decoder: 5 for 128 px as published, 7 for 512 px."""
        return self.image_size.bit_length() - 3

    @property
    def angles(self) -> tuple[int, ...]:
        """How many angles each factor has, in their order."""
        return (1,) * self.one_d + (2,) * self.two_d

    @property
    def embedding(self) -> int:
        """Numbers that the decoder is given."""
        return self.appearance + self.width * sum(count + 1 for count in self.angles)


@dataclass(frozen=True)
class StedTrainConfig:
    """One training run; the defaults are the published ones. Weights of zero switch a loss off; angles are in degrees.

    Attributes:
        network: Fields of `StedConfig` that differ from its defaults.
        steps, batch: Optimiser steps, and pairs of pictures a step.
        learning_rate: Of Adam at first, published as 5e-5 times `batch`; decay: its factor after every `decay_steps`.
        weight_decay: Of Adam.
        l1: Absolute difference between the redirected picture and the target.
        labels: Angle between the encoder's gaze and head and the labels, of both pictures.
        consistency: Embeddings of both pictures, turned to angles of zero, are alike.
        mixed_embeddings, mixed_labels: What the encoder says of a picture whose factors come from one or the other
            is what went into it.
        adversarial: Weight of the critic, which reaches it after `adversarial_warmup` steps.
        critic: Channels of the critic's first layer.
        features: Squared difference between the maps of a frozen network.
        directions: Angle between gazes, and between heads, that a frozen estimator reads off both pictures.
        backbone, stages: Which network gives `features`, and how many of its maps.
        seed: Seeds everything; step s of a resumed run draws what step s of an unbroken one does.
    """

    network: dict[str, Any] = dataclasses.field(default_factory=dict)
    steps: int = 206_865
    batch: int = 20
    learning_rate: float = 1e-3
    decay: float = 0.8
    decay_steps: int = 34_480
    weight_decay: float = 1e-4
    l1: float = 200.0
    labels: float = 5.0
    consistency: float = 2.0
    mixed_embeddings: float = 2.0
    mixed_labels: float = 2.0
    adversarial: float = 1.0
    adversarial_warmup: int = 20_000
    critic: int = 64
    features: float = 200.0
    directions: float = 2.0
    backbone: str = "vgg16"
    stages: int = 3
    seed: int = 1

    def __post_init__(self) -> None:
        if min(self.steps, self.batch, self.decay_steps, self.critic) < 1 or self.adversarial_warmup < 0:
            raise ValueError("steps, batch, decay_steps and critic are at least 1, adversarial_warmup at least 0")


PRESETS: dict[str, StedTrainConfig] = {
    "paper": StedTrainConfig(),
    "small": StedTrainConfig(
        network={"growth": 12, "appearance": 256},
        steps=3000,
        batch=6,
        learning_rate=3e-4,
        decay_steps=1000,
        adversarial_warmup=1500,
        features=0.0,
    ),
    "tiny": StedTrainConfig(
        network={"growth": 4, "layers": 2, "appearance": 16, "one_d": 1, "two_d": 2, "width": 4},
        steps=20,
        batch=2,
        adversarial_warmup=10,
        critic=4,
        features=0.0,
    ),
}
"""`paper` is the published run; `small` has fewer channels and steps and no feature loss; `tiny` is for tests."""


def to_dict(settings: StedConfig | StedTrainConfig) -> dict[str, Any]:
    """Plain values for JSON."""
    return dataclasses.asdict(settings)


def from_dict(kind: type[Settings], data: Any) -> Settings:
    """Read what `to_dict` wrote.

    Raises:
        ValueError: unknown or impossible values.
    """
    if not isinstance(data, dict):
        raise ValueError(f"settings are an object by name, not a {type(data).__name__}")
    known = {item.name: item.default for item in dataclasses.fields(kind)}
    if unknown := sorted(set(data) - set(known)):
        raise ValueError(f"unknown settings: {', '.join(unknown)}{did_you_mean(unknown[0], known)}")
    values = {}
    for name, value in data.items():
        default = known[name]
        if isinstance(default, float) and isinstance(value, int) and not isinstance(value, bool):
            value = float(value)
        wanted = dict if name == "network" else type(default)
        if not isinstance(value, wanted) or isinstance(value, bool):
            raise ValueError(f"{name} is a {wanted.__name__}, not {value!r}")
        values[name] = value
    return kind(**values)
