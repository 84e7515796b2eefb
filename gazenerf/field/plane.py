"""A plane of features around the head: what a stream knows of one person beyond its codes."""

from __future__ import annotations

import math

import torch
import torch.nn.functional as F
from torch import nn


class FeaturePlane(nn.Module):
    """Features by direction from the world's origin, which lies inside the head, added to a stream's hidden ones.

    Columns are azimuths from -180 to 180 degrees (0 is +Z, where the face looks; 90 is +X), rows elevations from -90 to
    90 degrees; values are interpolated between their centres.

    Args:
        values: (C, H, W) float32.
        mix: (K, C) float32 from values to the stream's hidden features.
    """

    def __init__(self, values: torch.Tensor, mix: torch.Tensor) -> None:
        super().__init__()
        self.values, self.mix = nn.Parameter(values), nn.Parameter(mix)

    def forward(self, points: torch.Tensor) -> torch.Tensor:
        """What is added to hidden features: points (B, N, 3) to (B, N, K)."""
        return self.at(plane_coordinates(points))

    def at(self, coordinates: torch.Tensor) -> torch.Tensor:
        """`forward` of points whose `plane_coordinates` (B, N, 2) are known."""
        if coordinates.numel() == 0:
            return self.mix.new_zeros(*coordinates.shape[:-1], len(self.mix))
        around = torch.cat([self.values[..., -1:], self.values, self.values[..., :1]], dim=-1)[None]
        width = self.values.shape[-1]
        scale = torch.tensor([width / (width + 2.0), 1.0], device=coordinates.device)
        grid = (coordinates * scale).reshape(1, 1, -1, 2)
        found = F.grid_sample(around, grid, mode="bilinear", padding_mode="border", align_corners=False)
        rows = found[0, :, 0].T.reshape(*coordinates.shape[:-1], -1)
        return F.linear(rows, self.mix)


def plane_coordinates(points: torch.Tensor) -> torch.Tensor:
    """(..., 2) azimuth over pi and elevation over pi/2, each -1 to 1, of points (..., 3)."""
    x, y, z = points.float().unbind(-1)
    azimuth = torch.atan2(x, z) / math.pi
    elevation = torch.atan2(y, torch.hypot(x, z).clamp(min=1e-9)) / (0.5 * math.pi)
    return torch.stack([azimuth, elevation], dim=-1)
