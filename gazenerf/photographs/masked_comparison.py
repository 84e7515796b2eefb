"""The perceptual loss of masked pictures whose targets do not change, without what it need not compute.

A masked picture is black outside the mask, and so is its target: only the box around the mask is compared, and
the maps of a target are computed once.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch

from gazenerf.training.operations import FeatureMaps

MARGIN, STEP = 16, 16
"""Pixels around the box, and its sides are multiples of these where the picture allows, as pooling wants them."""

MOST = 16
"""Targets that are remembered."""


@dataclass(frozen=True)
class _Known:
    target: torch.Tensor
    box: tuple[slice, slice]
    share: float
    maps: Sequence[torch.Tensor]


class MaskedComparison:
    """`gazenerf.training.losses.perceptual_loss` of pictures on black, called with the same arguments.

    Means are over the whole picture, as there; they differ by what a network's borders see.
    """

    def __init__(self) -> None:
        self.known: list[_Known] = []

    def __call__(self, features: FeatureMaps, images: torch.Tensor, targets: torch.Tensor) -> torch.Tensor:
        """The loss of pictures (B, 3, H, W) against targets of the same shape."""
        known = self._of(features, targets)
        got = features(images[:, :, known.box[0], known.box[1]])
        terms = [(a.float() - b.float()).abs().mean() for a, b in zip(got, known.maps, strict=True)]
        return known.share * torch.stack(terms).sum()

    def _of(self, features: FeatureMaps, targets: torch.Tensor) -> _Known:
        for known in self.known:
            if known.target.shape == targets.shape and torch.equal(known.target, targets):
                return known
        box = _box(targets)
        part = targets[:, :, box[0], box[1]]
        with torch.no_grad():
            maps = [found.detach() for found in features(part)]
        share = part.shape[-1] * part.shape[-2] / (targets.shape[-1] * targets.shape[-2])
        self.known = [*self.known, _Known(targets.detach().clone(), box, share, maps)][-MOST:]
        return self.known[-1]


def _box(pictures: torch.Tensor) -> tuple[slice, slice]:
    """Rows and columns of (B, 3, H, W) around all that is not black."""
    shown = (pictures != 0).any(dim=1).any(dim=0)
    return _span(shown.any(dim=1)), _span(shown.any(dim=0))


def _span(shown: torch.Tensor) -> slice:
    whole = len(shown)
    places = shown.nonzero()
    if not len(places):
        return slice(0, whole)
    low, high = max(0, int(places[0]) - MARGIN), min(whole, int(places[-1]) + 1 + MARGIN)
    side = min(whole, -(-(high - low) // STEP) * STEP)
    low = min(low, whole - side)
    return slice(low, low + side)
