"""Small fields with random weights or known geometry, for tests."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch import nn

from gazenerf.field.config import PRESETS, FieldConfig
from gazenerf.field.model import TwoStreamField
from gazenerf.field.streams import Stream, StreamCondition
from gazenerf.subjects import Codes, Subject

PARITY = Path(__file__).parents[1].parent / "shared" / "parity"


def parity_file(name: str) -> Path:
    path = PARITY / name
    if not path.is_file():
        pytest.skip(f"no published vectors at {path}")
    return path


def tiny_config(**changes: Any) -> FieldConfig:
    return FieldConfig.from_dict(PRESETS["tiny"].to_dict() | {"samples": 12} | changes)


def make_field(config: FieldConfig, seed: int = 0) -> TwoStreamField:
    """Random weights whose every part matters: biases, background and density vary too."""
    torch.manual_seed(seed)
    field = TwoStreamField(config).eval().requires_grad_(False)
    for name, value in field.named_parameters():
        if name.endswith("bias") or name == "renderer.background_features":
            value += 0.3 * torch.randn_like(value)
    for stream in field.streams.values():
        assert isinstance(stream, Stream)
        stream.density.weight *= 0.3
        stream.density.bias.fill_(0.2)
    return field


def make_subject(config: FieldConfig, seed: int = 1) -> Subject:
    rng = np.random.default_rng(seed)
    return Subject("someone", Codes(*(0.5 * rng.standard_normal(n).astype(np.float32) for n in config.code_sizes)))


class BallStream(Stream):
    """A stream whose density is a ball, so that pictures have a known geometry."""

    def __init__(self, config: FieldConfig, centre: tuple[float, float, float], radius: float) -> None:
        super().__init__(config)
        self.centre, self.radius, self.softness = centre, radius, 0.002

    def query(
        self, points: torch.Tensor, condition: StreamCondition, features: bool = True
    ) -> tuple[torch.Tensor, torch.Tensor]:
        inside = self.radius - (points - points.new_tensor(self.centre)).norm(dim=-1)
        density = 200.0 * torch.sigmoid(inside / self.softness)
        return density, points.new_ones(*points.shape[:-1], self.config.hidden // 2 if features else 0)


@dataclass(frozen=True)
class ShiftedCondition(StreamCondition):
    """A condition that also moves the ball up, world units."""

    shift: float = 0.0


class SoftStream(BallStream):
    """A ball that is soft enough for a lattice, with colours; `drift` moves it with the pitch."""

    width, drift = 0.02, 0.0

    def density_of(self, inside: torch.Tensor) -> torch.Tensor:
        return 10.0 * torch.nn.functional.softplus(inside / self.width)

    def condition(
        self, shape_code: torch.Tensor, appearance_code: torch.Tensor, gaze_label: torch.Tensor
    ) -> StreamCondition:
        plain = super().condition(shape_code, appearance_code, gaze_label)
        return ShiftedCondition(**vars(plain), shift=self.drift * float(gaze_label[0, 0]))

    def query(
        self, points: torch.Tensor, condition: StreamCondition, features: bool = True
    ) -> tuple[torch.Tensor, torch.Tensor]:
        assert isinstance(condition, ShiftedCondition)
        x, y, z = self.centre
        inside = self.radius - (points - points.new_tensor([x, y + condition.shift, z])).norm(dim=-1)
        density = self.density_of(inside)
        if not features:
            return density, points.new_empty(0)
        directions = torch.linspace(-3, 3, 3 * (self.config.hidden // 2), device=points.device).reshape(3, -1)
        return density, torch.sin(points @ directions)


def soft_field(drift: float = 0.0, **changes: Any) -> TwoStreamField:
    """A face ball and an eye ball, soft; the face moves by `drift` world units a radian of pitch."""
    config = tiny_config(**changes)
    field = make_field(config)
    face = SoftStream(config, (0.0, 0.0, 0.0), FACE_RADIUS)
    face.drift = drift
    field.streams = nn.ModuleDict({"face": face, "eyes": SoftStream(config, EYE_CENTRE, EYE_RADIUS)})
    return field.eval().requires_grad_(False)


FACE_RADIUS, EYE_CENTRE, EYE_RADIUS = 1.0, (0.3, 0.2, 0.85), 0.3


def make_balls() -> TwoStreamField:
    """A face ball with an eye ball that bulges out of it, both opaque, guided sampling."""
    config = tiny_config()
    field = make_field(config)
    field.streams = nn.ModuleDict(
        {
            "face": BallStream(config, (0.0, 0.0, 0.0), FACE_RADIUS),
            "eyes": BallStream(config, EYE_CENTRE, EYE_RADIUS),
        }
    )
    return field.eval().requires_grad_(False)
