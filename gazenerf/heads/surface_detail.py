"""Detail of a person's skin in pictures: where every pixel lies on the surface, and what is added there."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import torch
import torch.nn.functional as F

from gazenerf.field.detail import DARK
from gazenerf.heads.feature_map import FeatureGrid, RayFeatures

if TYPE_CHECKING:
    from gazenerf.heads.bound import BoundHead

FOLD = 6.0
"""Widths of a feature pixel by which distances of it and its neighbours differ where one surface ends before another:
between them no detail is added, since it is not known to which a pixel belongs."""


HAIR_END, HAIR_FADES = 0.025, 0.02
"""World units: what lies so far from the hair's surface is skin, and over how much the one becomes the other."""


def with_detail(
    bounds: Sequence[BoundHead], pictures: torch.Tensor, grid: FeatureGrid, seen: RayFeatures
) -> torch.Tensor:
    """Pictures of a head with the detail of the skin, where its field has any: by texture code, or the person's own.

    A feature pixel's place on the surface follows from its distance; places of pixels are interpolated between them.

    Args:
        bounds: One head at the gaze of each picture, the same object where gazes are the same.
        pictures: (B, 3, h * k, w * k) sRGB, or one of them, before they are cut out by a matte.
        grid: The rays of their feature maps.
        seen: Along these rays.
    """
    head = bounds[0].head
    skin, lashes, own, hair = head.texture_detail, head.field.lashes, head.field.detail, head.hair
    if skin is None and lashes is None and own is None and hair is None:
        return pictures
    points = grid.rays_o + seen.distance.nan_to_num()[:, None] * grid.rays_d
    places = torch.empty_like(points)
    of_picture = places.reshape(len(bounds), -1, 3)
    for bound in {id(bound): bound for bound in bounds}.values():
        same = [number for number, other in enumerate(bounds) if other is bound]
        found = surface_places(bound, points.reshape(of_picture.shape)[same].reshape(-1, 3))
        of_picture[same] = found.reshape(len(same), -1, 3)
    if hair is not None:
        places = torch.cat([places, points], dim=1)
    places = places.reshape(-1, *grid.shape, places.shape[1]).permute(0, 3, 1, 2)
    distance = seen.distance.reshape(-1, 1, *grid.shape)
    known = distance.isfinite()
    far, near = distance.nan_to_num(-torch.inf), (-distance).nan_to_num(-torch.inf)
    apart = F.max_pool2d(far, 3, stride=1, padding=1) + F.max_pool2d(near, 3, stride=1, padding=1)
    width = distance.nan_to_num() / grid.cameras[0].fx
    share = (known & (apart < FOLD * width)).float() * seen.opacity.reshape(distance.shape).clamp(0.0, 1.0)
    coarse = torch.cat([known.float(), share, places * known], dim=1)
    fine = F.interpolate(coarse, size=pictures.shape[-2:], mode="bilinear", align_corners=False)
    share, found = fine[:, 1:2], (fine[:, 2:] / fine[:, :1].clamp(min=1e-6)).permute(0, 2, 3, 1)
    at, points = found[..., :3], found[..., 3:]
    detailed = pictures.reshape(-1, *pictures.shape[-3:])
    brighter, on_skin = torch.zeros_like(share), at
    if hair is not None:
        on_hair = ((HAIR_END - hair.distance(points)) / HAIR_FADES).clamp(0.0, 1.0)[:, None]
        brighter = hair.brightness(points)[:, None] * on_hair
        on_skin = torch.where(on_hair[:, 0, ..., None] > 0.5, hair.root_places(points), at)
    if skin is not None:
        brighter = brighter + skin(on_skin)
    if lashes is not None:
        brighter = brighter + lashes(at)
    if skin is not None or lashes is not None or hair is not None:
        detailed = (detailed + DARK) * (brighter * share).exp() - DARK
    if own is not None:
        detailed = detailed + own(at) * share
    return detailed.reshape(pictures.shape)


def surface_places(bound: BoundHead, points: torch.Tensor) -> torch.Tensor:
    """Where the face has the features of points (N, 3) at a gaze: there, or on the template; (N, 3).

    On the template lids have the places of lids that look straight ahead, so that their detail moves with them.
    """
    name = "face" if "face" in bound.conditions else "head"
    stream, condition = bound.field.stream(name), bound.conditions[name]
    return torch.cat([stream.places(chunk[None], condition)[0] for chunk in points.split(bound.head.chunk)])
