"""Signed distances from a part's surface, and the densities that they mean.

A density that is learned through pictures is free to be noise around the right surface. A distance is
not: it grows by one a unit everywhere, so the surface it crosses is smooth and its gradient is the normal.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch
import torch.nn.functional as F
from torch import nn

from gazenerf.field.config import FieldConfig
from gazenerf.field.encoding import positional_encoding

LAYERS, SKIP_AFTER = 6, 3
"""Hidden layers, and after how many of them points and codes enter again."""

OCTAVE_GAIN = 1.5
"""Amplitude of the first octave of the encoding; each octave has half of the one before, for a smooth distance."""

CODE_GAINS = (0.5, 1.0, 1.5)
"""Factors on identity, expression and gaze label as they enter."""


def laplace_density(distance: torch.Tensor, spread: float) -> torch.Tensor:
    """Density per world unit of signed distances, negative inside (Yariv et al. 2021, Eq. 2 and 3).

    The cumulative Laplace distribution of minus the distance, over its scale: half of its most at the
    surface, all of it a few times `spread` inside.

    Args:
        distance: (...) world units.
        spread: Scale of the distribution, world units.
    """
    inside = -distance / spread
    outer = 0.5 * torch.exp(inside.clamp(max=0.0))
    return torch.where(inside <= 0.0, outer, 1.0 - 0.5 * torch.exp(-inside.clamp(min=0.0))) / spread


class DistanceCondition(NamedTuple):
    """Codes and gaze of B images, folded into the biases (B, W) of the layers that they enter."""

    first: torch.Tensor
    skip: torch.Tensor


class DistanceNetwork(nn.Module):
    """Signed distance from one part's surface, for any shape code and gaze.

    It is the distance from the nearest of a few balls plus what an MLP adds. The balls are set before
    training, from the part's mean surface, and travel with the weights.

    Args:
        config: Sizes.
        name: Which stream of the field.
    """

    balls: torch.Tensor

    def __init__(self, config: FieldConfig, name: str) -> None:
        super().__init__()
        self.config, self.sees_gaze = config, config.sees_gaze(name)
        width, encoded = config.distance_width, 3 + 6 * config.distance_frequencies
        codes = config.identity + config.expression + (2 if self.sees_gaze else 0)
        inputs = [encoded, width, width, width + encoded, *[width] * (LAYERS - SKIP_AFTER - 1)]
        self.layers = nn.ModuleList(nn.Linear(size, width) for size in inputs)
        self.first_codes, self.skip_codes = nn.Linear(codes, width), nn.Linear(codes, width)
        self.last = nn.Linear(width, 1)
        self.register_buffer("balls", torch.tensor([[0.0, 0.0, 0.0, 1.0]]).repeat(2 if name == "eyes" else 1, 1))

    @torch.no_grad()
    def set_balls(self, balls: np.ndarray) -> None:
        """Begin at balls (K, 4), centre and radius in world units: two for eyes, one for any other part."""
        self.balls.copy_(torch.from_numpy(balls.astype(np.float32)))
        nn.init.zeros_(self.last.bias)

    def condition(self, shape_code: torch.Tensor, gaze_label: torch.Tensor) -> DistanceCondition:
        """Shape codes (B, .) and gaze labels (B, 2) folded into biases."""
        identity, expression, gaze = CODE_GAINS
        split = self.config.identity
        parts = [identity * shape_code[:, :split], expression * shape_code[:, split:]]
        with torch.autocast(shape_code.device.type, enabled=False):
            codes = torch.cat([*parts, gaze * gaze_label] if self.sees_gaze else parts, dim=-1).float()
            return DistanceCondition(self.first_codes(codes), self.skip_codes(codes))

    def forward(self, points: torch.Tensor, condition: DistanceCondition) -> torch.Tensor:
        """Distances (B, ...) at points (B, ..., 3), world units, negative inside; float32 whatever autocast says.

        Half a unit in float16 is exact to half a millimetre only, which would be the grain of the surface.
        """
        batch, rest = points.shape[0], points.shape[1:-1]
        flat = points.reshape(batch, -1, 3).float()
        with torch.autocast(points.device.type, enabled=False):
            encoded = positional_encoding(flat, self.config.distance_frequencies) * self._gains(flat)
            hidden = encoded
            for i, layer in enumerate(self.layers):
                if i == SKIP_AFTER:
                    hidden = torch.cat([hidden, encoded], dim=-1)
                hidden = layer(hidden)
                if i in (0, SKIP_AFTER):
                    hidden = hidden + (condition.first if i == 0 else condition.skip)[:, None]
                hidden = F.silu(hidden)
            return (self._ball_distance(flat) + self.last(hidden)[..., 0]).reshape(batch, *rest)

    def _gains(self, like: torch.Tensor) -> torch.Tensor:
        """(3 + 6 F,) factors on what the encoding gives."""
        octaves = torch.arange(self.config.distance_frequencies, device=like.device).repeat_interleave(6)
        return torch.cat([like.new_ones(3), OCTAVE_GAIN * 2.0**-octaves])

    def _ball_distance(self, points: torch.Tensor) -> torch.Tensor:
        """(B, N) distance of points (B, N, 3) from the nearest ball."""
        away = points[..., None, :] - self.balls[:, :3]
        return ((away.square().sum(-1) + 1e-9).sqrt() - self.balls[:, 3]).amin(-1)
