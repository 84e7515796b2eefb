"""STED's losses for a batch of pairs, weighted as they enter the sum."""

from __future__ import annotations

from dataclasses import dataclass

import torch
import torch.nn.functional as F

from gazenerf.baselines.sted.config import StedTrainConfig
from gazenerf.baselines.sted.critic import Critic, says
from gazenerf.baselines.sted.network import GAZE, HEAD, Factors, Sted
from gazenerf.training.gaze_estimator import GazeEstimator
from gazenerf.training.losses import angular_error, gaze_vectors
from gazenerf.training.operations import FeatureMaps


@dataclass(frozen=True)
class Labelled:
    """B pictures of which gaze and head are known.

    Attributes:
        pictures: (B, 3, S, S) in [-1, 1].
        gaze, head: (B, 2) radians; see `Sted.redirect`.
    """

    pictures: torch.Tensor
    gaze: torch.Tensor
    head: torch.Tensor


@dataclass(frozen=True)
class Judges:
    """Frozen networks that compare pictures; None leaves their loss out.

    Attributes:
        features: Pictures (B, 3, H, W) in [0, 1] to feature maps.
        estimator: Reads gaze and head.
    """

    features: FeatureMaps | None = None
    estimator: GazeEstimator | None = None


@dataclass(frozen=True)
class Pass:
    """What the networks make of a batch of pairs, from a to b.

    Attributes:
        a, b: Factors of both pictures.
        made: (B, 3, S, S) picture a with all angles of picture b.
        mixed: Factors of picture a, of which some are turned to the angles of picture b.
        mixed_again: What the encoder says of the picture of `mixed`.
    """

    a: Factors
    b: Factors
    made: torch.Tensor
    mixed: Factors
    mixed_again: Factors


def forward(model: Sted, first: Labelled, second: Labelled) -> Pass:
    """Encode both pictures and decode the first one as the second, and as a random mixture of both."""
    a, b = model.encoder(first.pictures), model.encoder(second.pictures)
    mixed = a.turned([torch.where(_coins(to), to, now) for to, now in zip(b.angles, a.angles, strict=True)])
    return Pass(a, b, model.decode(a.turned(b.angles)), mixed, model.encoder(model.decode(mixed)))


def _coins(like: torch.Tensor) -> torch.Tensor:
    """(B, 1) random bool."""
    return torch.rand(len(like), 1, device=like.device) < 0.5


def degrees(a: torch.Tensor, b: torch.Tensor) -> torch.Tensor:
    """Mean angle, degrees, between directions (B, 2) or vectors (B, 3)."""
    first, second = (gaze_vectors(item) if item.shape[-1] == 2 else item for item in (a, b))
    return torch.rad2deg(angular_error(first, second)).mean()


def unlike(a: Factors, b: Factors) -> torch.Tensor:
    """One minus the mean cosine between all that factors hold."""
    return 1.0 - F.cosine_similarity(a.flat, b.flat, dim=1).mean()


def generator_losses(
    found: Pass,
    first: Labelled,
    second: Labelled,
    critic: Critic,
    judges: Judges,
    config: StedTrainConfig,
    step: int,
) -> dict[str, torch.Tensor]:
    """What encoder and decoder are to lower, by name of its weight in `StedTrainConfig`."""
    parts = {"l1": F.l1_loss(found.made, second.pictures)}
    if config.labels:
        known = [(found.a, first), (found.b, second)]
        angles = [
            degrees(factors.angles[GAZE], truth.gaze) + degrees(factors.angles[HEAD], truth.head)
            for factors, truth in known
        ]
        parts["labels"] = 0.5 * torch.stack(angles).sum()
    if config.consistency:
        parts["consistency"] = unlike(found.a.straight(), found.b.straight())
    if config.mixed_embeddings:
        parts["mixed_embeddings"] = unlike(found.mixed, found.mixed_again)
    if config.mixed_labels:
        mixed, again = found.mixed.angles, found.mixed_again.angles
        parts["mixed_labels"] = degrees(mixed[GAZE], again[GAZE]) + degrees(mixed[HEAD], again[HEAD])
    if config.adversarial:
        warm = min(1.0, step / max(1, config.adversarial_warmup))
        parts["adversarial"] = warm * says(critic(found.made), decoded=False)
    parts |= _judged(found.made, second.pictures, judges, config)
    return {name: getattr(config, name) * value for name, value in parts.items()}


def _judged(
    made: torch.Tensor, wanted: torch.Tensor, judges: Judges, config: StedTrainConfig
) -> dict[str, torch.Tensor]:
    """How alike frozen networks find pictures (B, 3, S, S) in [-1, 1]."""
    parts = {}
    made, wanted = 0.5 * (made + 1.0), 0.5 * (wanted + 1.0)
    if config.features and judges.features is not None:
        with torch.no_grad():
            known = judges.features(wanted)
        seen = judges.features(made)
        parts["features"] = torch.stack([F.mse_loss(a, b) for a, b in zip(seen, known, strict=True)]).sum()
    if config.directions and judges.estimator is not None:
        with torch.no_grad():
            truth = judges.estimator.read(wanted)
        read = judges.estimator.read(made)
        parts["directions"] = degrees(read.gaze, truth.gaze) + degrees(read.towards, truth.towards)
    return parts


def critic_loss(critic: Critic, made: torch.Tensor, true: torch.Tensor, weight: float) -> torch.Tensor:
    """What the critic is to lower."""
    return 0.5 * weight * (says(critic(made.detach()), decoded=True) + says(critic(true), decoded=False))
