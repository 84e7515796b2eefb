"""Detail of a person's skin in pictures: where every pixel lies on the surface, and what is added there."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch
import torch.nn.functional as F

from gazenerf.field.detail import DARK
from gazenerf.heads.feature_map import FeatureGrid, RayFeatures

if TYPE_CHECKING:
    from gazenerf.heads.head import Head

FOLD = 6.0
"""Widths of a feature pixel by which distances of it and its neighbours differ where one surface ends before another:
between them no detail is added, since it is not known to which a pixel belongs."""


def with_detail(head: Head, pictures: torch.Tensor, grid: FeatureGrid, seen: RayFeatures) -> torch.Tensor:
    """Pictures of a head with the detail of the skin, where its field has any: by texture code, or the person's own.

    A feature pixel's place on the surface follows from its distance; places of pixels are interpolated between them.

    Args:
        head: Drawn by the pictures.
        pictures: (B, 3, h * k, w * k) sRGB, or one of them, before they are cut out by a matte.
        grid: The rays of their feature maps.
        seen: Along these rays.
    """
    skin, own = head.texture_detail, head.field.detail
    if skin is None and own is None:
        return pictures
    places = surface_places(head, grid.rays_o + seen.distance.nan_to_num()[:, None] * grid.rays_d)
    places = places.reshape(-1, *grid.shape, 3).permute(0, 3, 1, 2)
    distance = seen.distance.reshape(-1, 1, *grid.shape)
    known = distance.isfinite()
    far, near = distance.nan_to_num(-torch.inf), (-distance).nan_to_num(-torch.inf)
    apart = F.max_pool2d(far, 3, stride=1, padding=1) + F.max_pool2d(near, 3, stride=1, padding=1)
    width = distance.nan_to_num() / grid.cameras[0].fx
    share = (known & (apart < FOLD * width)).float() * seen.opacity.reshape(distance.shape).clamp(0.0, 1.0)
    coarse = torch.cat([places * known, known.float(), share], dim=1)
    fine = F.interpolate(coarse, size=pictures.shape[-2:], mode="bilinear", align_corners=False)
    at, share = (fine[:, :3] / fine[:, 3:4].clamp(min=1e-6)).permute(0, 2, 3, 1), fine[:, 4:]
    detailed = pictures.reshape(-1, *pictures.shape[-3:])
    if skin is not None:
        detailed = (detailed + DARK) * (skin(at) * share).exp() - DARK
    if own is not None:
        detailed = detailed + own(at) * share
    return detailed.reshape(pictures.shape)


def surface_places(head: Head, points: torch.Tensor) -> torch.Tensor:
    """Where the face has the features of points (N, 3): there, or on the template; (N, 3).

    They are those of eyes that look straight ahead: only lids move with the gaze, where no detail is kept.
    """
    name = "face" if "face" in head.field.streams else "head"
    stream, condition = head.field.stream(name), head.straight[name]
    return torch.cat([stream.places(chunk[None], condition)[0] for chunk in points.split(head.chunk)])
