"""All that pictures of a head show and a feature map is too coarse for: of skin, eyes and mouth."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import torch

from gazenerf.heads.eye_detail import with_eye_detail
from gazenerf.heads.feature_map import FeatureGrid, RayFeatures
from gazenerf.heads.interface import Part
from gazenerf.heads.mouth_detail import with_mouth_detail
from gazenerf.heads.surface_detail import with_detail

if TYPE_CHECKING:
    from gazenerf.heads.bound import BoundHead


def detailed(
    bounds: Sequence[BoundHead], pictures: torch.Tensor, grid: FeatureGrid, seen: RayFeatures, part: Part = "head"
) -> torch.Tensor:
    """Pictures of a part of a head with all detail of it that its field asks for.

    Args:
        bounds: One head at the gaze of each picture, the same object where gazes are the same.
        pictures: (B, 3, h * k, w * k) sRGB, or one of them, before they are cut out by a matte.
        grid: The rays of their feature maps.
        seen: Along these rays.
        part: What they show.
    """
    if part != "eyes":
        pictures = with_detail(bounds, pictures, grid, seen)
        pictures = with_mouth_detail(bounds, pictures, grid)
    return pictures if part == "face" else with_eye_detail(bounds, pictures, grid, seen, lids=part == "head")
