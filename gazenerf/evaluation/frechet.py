"""Frechet distances between the features of redirected pictures and those of their targets.

By Inception's features, as FID, where its weights are on this machine; else by the features of the LPIPS network, which
is another number and has another name.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import torch
from torch import nn

from gazenerf.errors import UserError
from gazenerf.evaluation.intervals import Estimate, jackknifed
from gazenerf.training.perceptual import PerceptualFeatures

HOW = "pip install gazenerf[frechet]"
INCEPTION_FILE = "weights-inception-2015-12-05-6726825d.pth"
"""What torch-fidelity keeps in torch's download cache."""

INCEPTION_SIZE = 2048

NAMES = {"fid": "FID", "frechet_alexnet": "Frechet distance of AlexNet features"}
"""Every distance's name in reports and in words."""


class Features(Protocol):
    """Features of pictures, and the name of the distance between them."""

    @property
    def name(self) -> str:
        """One of `NAMES`."""
        ...

    def __call__(self, pictures: torch.Tensor) -> torch.Tensor:
        """(B, D) of sRGB pictures (B, 3, H, W) in [0, 1]."""
        ...


@dataclass(frozen=True)
class InceptionFeatures:
    """The 2048 pooled features by which FID is defined.

    Attributes:
        network: torchmetrics' own.
    """

    network: nn.Module
    name: str = "fid"

    def __call__(self, pictures: torch.Tensor) -> torch.Tensor:
        """See `Features`."""
        return self.network((pictures * 255.0).round().to(torch.uint8))


@dataclass(frozen=True)
class AlexNetFeatures:
    """The mean of the last of the LPIPS network's five maps, 256 features.

    Attributes:
        network: AlexNet.
    """

    network: PerceptualFeatures
    name: str = "frechet_alexnet"

    def __call__(self, pictures: torch.Tensor) -> torch.Tensor:
        """See `Features`."""
        return self.network(pictures)[-1].mean((2, 3))


def load_features(left_out: dict[str, str]) -> Features:
    """Inception's features, or, where they are not there, those of the LPIPS network; why is put into `left_out`.

    Raises:
        UserError: neither is there.
    """
    _frechet_class()
    try:
        return InceptionFeatures(_inception())
    except UserError as error:
        left_out["FID"] = str(error)
    return AlexNetFeatures(PerceptualFeatures("alexnet", source="package"))


def _inception() -> nn.Module:
    path = Path(torch.hub.get_dir()) / "checkpoints" / INCEPTION_FILE
    if not path.is_file():
        raise UserError(f"no Inception weights at {path}; torch-fidelity downloads them")
    try:
        metric = _frechet_class()(INCEPTION_SIZE, feature_extractor_weights_path=str(path))
    except Exception as error:
        raise UserError(f"cannot load Inception ({error}); pip install torch-fidelity") from error
    return metric.inception.eval().requires_grad_(False)


def _frechet_class() -> Any:
    try:
        from torchmetrics.image.fid import FrechetInceptionDistance
    except (ImportError, OSError, RuntimeError) as error:
        raise UserError(f"no torchmetrics ({error}); {HOW}") from error
    return FrechetInceptionDistance


class _Given(nn.Module):
    """Stands where torchmetrics wants a network: what it is given are features."""

    def __init__(self, size: int) -> None:
        super().__init__()
        self.num_features = size

    def forward(self, features: torch.Tensor) -> torch.Tensor:
        return features


def frechet_distance(made: np.ndarray, truth: np.ndarray) -> float:
    """The distance between the normal distributions of features (N, D), by torchmetrics; N at least 2."""
    metric = _frechet_class()(_Given(made.shape[1]), normalize=True)
    metric.update(torch.from_numpy(truth.astype(np.float64)), real=True)
    metric.update(torch.from_numpy(made.astype(np.float64)), real=False)
    return float(metric.compute())


def frechet_estimate(features: Mapping[int, tuple[np.ndarray, np.ndarray]]) -> Estimate | None:
    """The distance over all people's pictures, and its interval by leaving out each person.

    Args:
        features: Person to the features (N, D) of redirected pictures and of targets.

    Returns:
        None for fewer than two pictures.
    """
    if sum(len(made) for made, _ in features.values()) < 2:
        return None

    def over(people: list[int]) -> float:
        made, truth = (np.concatenate([features[person][side] for person in people]) for side in (0, 1))
        return frechet_distance(made, truth)

    everybody = sorted(features)
    rests = [[person for person in everybody if person != left_out] for left_out in everybody]
    enough = all(sum(len(features[person][0]) for person in rest) >= 2 for rest in rests)
    return jackknifed(over(everybody), [over(rest) for rest in rests] if enough else [], len(everybody))
