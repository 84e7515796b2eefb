"""Detail of the skin, finer than a feature map holds, which lies on the surface of a field and is added to pictures."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import nn

from gazenerf.field.config import FieldConfig
from gazenerf.field.plane import plane_coordinates

EXTENT = (90.0, 67.5)
"""Degrees of azimuth and of elevation on either side of where the face looks that detail covers."""

AROUND_EYES = (40.0, 14.0)
"""The same that lashes cover."""

DARK = 0.03
"""sRGB that is added before logarithms are taken, so that black has one."""


class SurfaceDetail(nn.Module):
    """Values by direction from the world's origin, which lies inside the head.

    Columns are azimuths, rows elevations, both within an extent; see `FeaturePlane`. Values are interpolated between
    their centres; beyond the extent they are 0.

    Args:
        values: (3, H, W) float32, or one for all channels (1, H, W).
        extent: As `EXTENT`.
    """

    def __init__(self, values: torch.Tensor, extent: tuple[float, float] = EXTENT) -> None:
        super().__init__()
        self.values, self.extent = nn.Parameter(values), extent

    def forward(self, places: torch.Tensor) -> torch.Tensor:
        """The values (B, 3, H', W') at places (B, H', W', 3) of the surface, world units."""
        values = self.values.expand(len(places), -1, -1, -1)
        at = detail_coordinates(places, self.extent)
        return F.grid_sample(values, at, mode="bilinear", align_corners=False)


class TextureDetail(nn.Module):
    """The skin's colour by direction, as `SurfaceDetail` has it, linear in texture codes and of low rank.

    What of it a picture lacks is told by `gazenerf.heads.skin_bands`.

    Args:
        config: Sizes.

    Attributes:
        maps: (R, H, W), each a map over directions.
        mix: (3, 1 + T, R): how much of each map the mean and every texture code give to each linear RGB channel.
        share: (H, W) in [0, 1], how much detail is drawn in each direction: none beside the skin.
    """

    def __init__(self, config: FieldConfig) -> None:
        super().__init__()
        rank, rows, columns = config.detail
        self.maps = nn.Parameter(torch.zeros(rank, rows, columns))
        self.mix = nn.Parameter(torch.zeros(3, 1 + config.texture, rank))
        self.share = nn.Parameter(torch.zeros(rows, columns))

    def albedo(self, texture: torch.Tensor) -> torch.Tensor:
        """(3, H, W) linear RGB, not clipped, of a texture code (T,)."""
        weights = self.mix[:, 0] + torch.einsum("ctr,t->cr", self.mix[:, 1:], texture)
        return torch.einsum("cr,rhw->chw", weights, self.maps)


def detail_coordinates(places: torch.Tensor, extent: tuple[float, float] = EXTENT) -> torch.Tensor:
    """(..., 2) azimuth and elevation, -1 to 1 within an extent, of places (..., 3)."""
    whole = torch.tensor([180.0 / extent[0], 90.0 / extent[1]], device=places.device)
    return plane_coordinates(places) * whole
