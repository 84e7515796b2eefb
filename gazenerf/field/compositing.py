"""Volume rendering of one medium, and of two in the same place.

`composite_stream` and `composite_streams` are the only places where samples become what a ray sees:
the published pass, the renderer and training all call them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch

EPSILON = 1e-10

Project = Callable[[torch.Tensor, torch.Tensor], torch.Tensor]
"""Sums of hidden features along rays (..., R, K) and of their weights (..., R) to features (..., R, C)."""


def transmittance(alpha: torch.Tensor) -> torch.Tensor:
    """(..., S) share of light that reaches each sample, as published: products of 1 - alpha + 1e-10."""
    passed = torch.cumprod(1.0 - alpha + EPSILON, dim=-1)
    return torch.cat([torch.ones_like(passed[..., :1]), passed[..., :-1]], dim=-1)


def composite(density: torch.Tensor, deltas: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Weights of the samples of rays through one medium.

    Args:
        density: (..., S) per world unit.
        deltas: (..., S) interval lengths, world units.

    Returns:
        weights (..., S) and opacity (...), their sum.
    """
    alpha = 1.0 - torch.exp(-density * deltas)
    weights = transmittance(alpha) * alpha
    return weights, weights.sum(-1)


def composite_joint(
    density_face: torch.Tensor, density_eyes: torch.Tensor, deltas: torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Weights of the samples of rays through face and eyes as one medium (this project's merge).

    The density is the sum; each sample's weight is shared between the streams by density. The
    nearer surface therefore hides the farther one, whichever stream it belongs to.

    Args:
        density_face, density_eyes: (..., S) at the same samples.
        deltas: (..., S).

    Returns:
        weights_face (..., S), weights_eyes (..., S), opacity (...).
    """
    total = density_face + density_eyes
    weights, opacity = composite(total, deltas)
    share = density_eyes / total.clamp(min=EPSILON)
    return weights * (1.0 - share), weights * share, opacity


@dataclass(frozen=True)
class StreamSamples:
    """What one stream holds at the samples of rays.

    Attributes:
        density: (..., R, S) per world unit.
        features: (..., R, S, K), final ones or hidden ones that `project` completes.
        project: Applied after compositing, once per ray; None where the features are final.
    """

    density: torch.Tensor
    features: torch.Tensor
    project: Project | None = None

    def along(self, weights: torch.Tensor) -> torch.Tensor:
        """Features of rays (..., R, C) from weights of their samples (..., R, S)."""
        with torch.autocast(weights.device.type, enabled=False):  # in the precision of the features
            summed = (weights.to(self.features.dtype).unsqueeze(-2) @ self.features).squeeze(-2)
        return summed if self.project is None else self.project(summed, weights.sum(-1)).float()

    def rays(self, index: torch.Tensor) -> StreamSamples:
        """The samples of some rays: a mask or numbers of the first dimension."""
        return StreamSamples(self.density[index], self.features[index], self.project)


@dataclass(frozen=True)
class Composited:
    """What rays see of a medium, without what is behind it.

    Attributes:
        features: (..., R, C).
        opacity: (..., R).
        weights: (..., R, S) of the samples.
        weights_eyes: (..., R, S) the eyes' share of them where the medium is face and eyes, else None.
    """

    features: torch.Tensor
    opacity: torch.Tensor
    weights: torch.Tensor
    weights_eyes: torch.Tensor | None = None

    def over(self, background: torch.Tensor) -> torch.Tensor:
        """(..., R, C) with the features behind it (..., R, C) added."""
        return self.features + (1.0 - self.opacity[..., None]) * background


def composite_stream(samples: StreamSamples, deltas: torch.Tensor) -> Composited:
    """One stream along rays whose samples stand for lengths `deltas` (..., R, S), world units."""
    weights, opacity = composite(samples.density, deltas)
    return Composited(samples.along(weights), opacity, weights)


def composite_streams(
    face: StreamSamples, eyes: StreamSamples, deltas: torch.Tensor, turn: Callable[[torch.Tensor], torch.Tensor]
) -> Composited:
    """Face and eyes along the same rays as one medium; see `composite_joint`.

    Args:
        face, eyes: At the same samples.
        deltas: (..., R, S) world units.
        turn: Turns the eyes' features (..., R, C) by the gaze (paper Sec. 3.2).
    """
    weights_face, weights_eyes, opacity = composite_joint(face.density, eyes.density, deltas)
    features = face.along(weights_face) + turn(eyes.along(weights_eyes))
    return Composited(features, opacity, weights_face + weights_eyes, weights_eyes)
