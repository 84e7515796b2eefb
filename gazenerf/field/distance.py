"""Signed distances from a part's surface, and the densities that they mean.

A density that is learned through pictures is free to be noise around the right surface. A distance is
not: it grows by one a unit everywhere, so the surface it crosses is smooth and its gradient is the normal.

Points are first moved to their places on one head, the template, where ears, lips and lids lie in the
same place whoever it is, as deformed and deep implicit templates do (Deng et al. 2021; Zheng et al. 2021).
"""

from __future__ import annotations

import itertools
import math
from typing import NamedTuple

import numpy as np
import torch
import torch.nn.functional as F
from torch import nn

from gazenerf.field.config import FieldConfig
from gazenerf.field.encoding import positional_encoding
from gazenerf.field.hair import HairVolume
from gazenerf.field.lids import Lids

LAYERS, SKIP_AFTER = 6, 3
"""Hidden layers, and after how many of them points and codes enter again."""

OCTAVE_GAIN, OCTAVE_FALL = 1.5, 1.3
"""Amplitude of the first octave of a distance's encoding, and by how much each has less than the one before."""

CODE_GAINS = (0.5, 1.0, 1.5)
"""Factors on identity, expression and gaze label as they enter."""

MOVING_LAYERS = 3
"""Hidden layers that move points to the template."""

MOVING_PASSES = 2
"""How often a point's place on the template is corrected: the move is known where it ends, not where it begins."""

GAZE_CODES, GAZE_GAIN, GAZE_WIDTH = 8, 3.0, 32
"""Values that a gaze becomes, beside which a displacement is linear, and how: gain of the label, width."""

DEEPEST = 15.0
"""Spreads from the surface up to which distances are told from float32 densities: deeper, those no longer differ."""


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


def laplace_distance(density: torch.Tensor, spread: float) -> torch.Tensor:
    """Signed distances, world units, whose `laplace_density` is given, at most `DEEPEST` spreads to both sides.

    Between points they are close to straight, where densities are steps: what is interpolated should be these.

    Args:
        density: (...) per world unit.
        spread: Scale of the distribution, world units.
    """
    least = 0.5 * math.exp(-DEEPEST)
    share = (density * spread).clamp(least, 1.0 - least)
    away = torch.log(2.0 * torch.minimum(share, 1.0 - share))
    return spread * torch.where(share < 0.5, -away, away)


def scaled_encoding(points: torch.Tensor, frequencies: int, fall: float) -> torch.Tensor:
    """`positional_encoding` of points (..., 3) whose octaves have amplitudes that fall by a factor each."""
    return positional_encoding(points, frequencies) * octave_gains(frequencies, fall, points.device)


def octave_gains(frequencies: int, fall: float, device: torch.device | str = "cpu") -> torch.Tensor:
    """(3 + 6 N,) factors on a point and on the octaves of its encoding, each a factor `fall` below the one before."""
    octaves = torch.arange(frequencies, device=device).repeat_interleave(6)
    return torch.cat([torch.ones(3, device=device), OCTAVE_GAIN * fall**-octaves])


class TemplateMove(nn.Module):
    """Where points of a person's head lie on the template, the mean head looking straight ahead.

    A displacement is linear in codes, as the head model's are: a point's features, which an MLP gives at its
    place on the template, times a matrix that the codes give. Gaze enters by values that are learned of it. The
    place is found by a few passes from the point itself.

    Args:
        config: Sizes.
        sees_gaze: Whether the part moves with the gaze.
    """

    def __init__(self, config: FieldConfig, sees_gaze: bool) -> None:
        super().__init__()
        width = config.distance_template
        self.config = config
        sizes = [3 + 6 * config.template_frequencies, *[width] * MOVING_LAYERS]
        self.layers = nn.ModuleList(nn.Linear(a, b) for a, b in itertools.pairwise(sizes))
        learned = nn.Linear(2, GAZE_WIDTH), nn.SiLU(), nn.Linear(GAZE_WIDTH, GAZE_CODES)
        self.gaze = nn.Sequential(*learned) if sees_gaze else None
        codes = config.identity + config.expression + (GAZE_CODES if sees_gaze else 0)
        self.matrix = nn.Linear(codes, 3 * width)
        if not self.matrix.weight.is_meta:
            nn.init.normal_(self.matrix.weight, std=0.01 / width**0.5)
            nn.init.zeros_(self.matrix.bias)

    def condition(self, codes: torch.Tensor, gaze_label: torch.Tensor) -> torch.Tensor:
        """(B, 3, W) matrices of shape codes (B, .) and gaze labels (B, 2)."""
        if self.gaze is not None:
            codes = torch.cat([codes, self.gaze(GAZE_GAIN * gaze_label)], dim=-1)
        return self.matrix(codes).reshape(len(codes), 3, -1)

    def forward(self, points: torch.Tensor, matrix: torch.Tensor) -> torch.Tensor:
        """Places (B, N, 3) on the template of points (B, N, 3), world units; matrices of `condition`."""
        places = points
        for _ in range(MOVING_PASSES):
            hidden = scaled_encoding(places, self.config.template_frequencies, self.config.template_fall)
            for layer in self.layers:
                hidden = F.silu(layer(hidden))
            places = points + hidden @ matrix.mT
        return places


class DistanceCondition(NamedTuple):
    """Codes and gaze of B images: biases (B, W) of the layers that they enter, and of the move (B, 3, W').

    `hair` and `lids` are those of all of them, None where there are none.
    """

    first: torch.Tensor
    skip: torch.Tensor
    move: torch.Tensor
    hair: HairVolume | None = None
    lids: Lids | None = None


class Placed(NamedTuple):
    """What is known of points (B, N, 3), float32, world units.

    Attributes:
        distance: (B, N) signed, hair and lids included.
        places: (B, N, 3) on the template.
        featured: (B, N, 3) places whose features are theirs: the same, but those of its roots for hair.
    """

    distance: torch.Tensor
    places: torch.Tensor
    featured: torch.Tensor


class DistanceNetwork(nn.Module):
    """Signed distance from one part's surface, for any shape code and gaze.

    Points are moved to the template; there it is the distance from the nearest of a few balls plus what an MLP
    adds, which knows the codes too, since a move does not keep distances. The balls are set before training, from
    the part's surface on the template, and travel with the weights.

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
        self.move = TemplateMove(config, self.sees_gaze)
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
            move = self.move.condition(torch.cat(parts, dim=-1).float(), gaze_label.float())
            return DistanceCondition(self.first_codes(codes), self.skip_codes(codes), move)

    def places(self, points: torch.Tensor, condition: DistanceCondition) -> torch.Tensor:
        """Where points (B, N, 3) lie on the template, world units."""
        with torch.autocast(points.device.type, enabled=False):
            places = self.move(points.float(), condition.move)
            return places if condition.lids is None else condition.lids.placed(places, points.float())

    def forward(self, points: torch.Tensor, condition: DistanceCondition) -> torch.Tensor:
        """Distances (B, ...) at points (B, ..., 3), world units, negative inside; float32 whatever autocast says.

        Half a unit in float16 is exact to half a millimetre only, which would be the grain of the surface.
        """
        batch, rest = points.shape[0], points.shape[1:-1]
        return self.placed(points.reshape(batch, -1, 3), condition).distance.reshape(batch, *rest)

    def placed(self, points: torch.Tensor, condition: DistanceCondition) -> Placed:
        """Distances at points (B, N, 3), and their places on the template."""
        hair, lids = condition.hair, condition.lids
        with torch.autocast(points.device.type, enabled=False):
            places = self.move(points.float(), condition.move)
            distance = self.at(places, condition)
            if lids is not None:
                places = lids.placed(places, points.float())
                distance = lids.over(distance, points.float())
            if hair is None:
                return Placed(distance, places, places)
            of_hair = hair.distance(points)
            roots = torch.where((of_hair < distance)[..., None], hair.root_places(points), places)
            return Placed(torch.minimum(distance, of_hair), places, roots)

    def at(self, places: torch.Tensor, condition: DistanceCondition) -> torch.Tensor:
        """Distances (B, N) of points whose places on the template (B, N, 3) are known, float32, world units."""
        encoded = scaled_encoding(places, self.config.distance_frequencies, OCTAVE_FALL)
        hidden = encoded
        for i, layer in enumerate(self.layers):
            if i == SKIP_AFTER:
                hidden = torch.cat([hidden, encoded], dim=-1)
            hidden = layer(hidden)
            if i in (0, SKIP_AFTER):
                hidden = hidden + (condition.first if i == 0 else condition.skip)[:, None]
            hidden = F.silu(hidden)
        return self._ball_distance(places) + self.last(hidden)[..., 0]

    def _ball_distance(self, points: torch.Tensor) -> torch.Tensor:
        """(B, N) distance of points (B, N, 3) from the nearest ball."""
        away = points[..., None, :] - self.balls[:, :3]
        return ((away.square().sum(-1) + 1e-9).sqrt() - self.balls[:, 3]).amin(-1)
