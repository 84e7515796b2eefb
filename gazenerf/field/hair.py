"""Hair about a field's face: a volume of signed distances around a person's head, joined to those that a network gives.

Its features are those that the stream has at its roots: painted hair is drawn on along the locks.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
import torch.nn.functional as F


class HairVolume(NamedTuple):
    """One person's hair.

    Attributes:
        low, high: (3,) corners, world units, of the box that the others fill; beyond it the nearest cell counts.
        values: (1, 2, D, H, W) along z, y, x: signed distance from the hair's surface, world units, negative inside;
            and the logarithm of how bright its locks are, in sRGB, over what is drawn at the roots.
        roots: (1, 3, d, h, w) places of the roots on the template, world units.
    """

    low: torch.Tensor
    high: torch.Tensor
    values: torch.Tensor
    roots: torch.Tensor

    def to(self, device: torch.device | str) -> HairVolume:
        """The same on a device."""
        return HairVolume(*(value.to(device) for value in self))

    def distance(self, points: torch.Tensor) -> torch.Tensor:
        """(...) signed distances at points (..., 3)."""
        return self._at(points, self.values[:, :1])[..., 0]

    def brightness(self, points: torch.Tensor) -> torch.Tensor:
        """(...) logarithms of the locks' brightness at points (..., 3)."""
        return self._at(points, self.values[:, 1:])[..., 0]

    def root_places(self, points: torch.Tensor) -> torch.Tensor:
        """(..., 3) places on the template of the roots of hair at points (..., 3)."""
        return self._at(points, self.roots)

    def _at(self, points: torch.Tensor, values: torch.Tensor) -> torch.Tensor:
        grid = (2.0 * (points.float() - self.low) / (self.high - self.low) - 1.0).reshape(1, 1, 1, -1, 3)
        found = F.grid_sample(values, grid, mode="bilinear", padding_mode="border", align_corners=True)
        return found[0, :, 0, 0].T.reshape(*points.shape[:-1], values.shape[1])
