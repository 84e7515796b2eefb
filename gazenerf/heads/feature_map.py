"""The feature map of a picture: its rays, and outlines that are not stairs. Shared by every path."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np
import torch
import torch.nn.functional as F

from gazenerf.field.config import FieldConfig
from gazenerf.geometry import Camera, camera_rays
from gazenerf.heads.interface import GeometryView


class RayFeatures(NamedTuple):
    """What is seen along rays.

    Attributes:
        features: (R, C) over the background.
        opacity: (R,).
        distance: (R,) expected, world units; NaN without a surface.
    """

    features: torch.Tensor
    opacity: torch.Tensor
    distance: torch.Tensor


Window = tuple[torch.Tensor, torch.Tensor]
"""Nearest and farthest distance (R,) at which a ray's surface is looked for."""

Composite = Callable[[torch.Tensor, torch.Tensor, torch.Tensor, Window], RayFeatures]
"""Rays (R, 3), (R, 3), background features (R, C) and where their surface may be, to what is seen along them."""

BESIDE = (0.15, 0.35)
"""World units before and behind the surfaces of a feature pixel and its neighbours that its finer rays may meet:
a surface seen edge-on recedes fast."""

INSIDE = np.array([[-0.25, -0.25], [0.25, -0.25], [-0.25, 0.25], [0.25, 0.25]])
"""Four rays of a feature pixel, from its own ray, in feature pixels."""


CROSS = ((3, 1), (1, 3))
"""Sides of the windows that together are a pixel and the four beside it."""


@dataclass(frozen=True)
class FeatureGrid:
    """Rays of the feature map of a picture.

    Attributes:
        camera: At the feature map's size.
        grid: (h, w, 2) image coordinates of the rays.
        rays_o, rays_d: (h * w, 3), x fastest.
    """

    camera: Camera
    grid: np.ndarray
    rays_o: torch.Tensor
    rays_d: torch.Tensor

    @classmethod
    def of(cls, camera: Camera, config: FieldConfig, device: torch.device | str = "cpu") -> FeatureGrid:
        """The grid behind a picture of the camera's size; at least 2 x 2, rounded up to whole feature pixels."""
        k = config.upsampling
        columns, rows = max(2, -(-camera.width // k)), max(2, -(-camera.height // k))
        small = camera.resized(columns, rows)
        grid = np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), axis=-1) + config.ray_offset
        return cls(small, grid, *camera_rays(small, grid, device))

    @property
    def shape(self) -> tuple[int, int]:
        """(h, w)."""
        return self.grid.shape[0], self.grid.shape[1]

    def outline(self, opacity: torch.Tensor) -> torch.Tensor:
        """(E,) indices of the feature pixels on an outline of opacity (h * w,)."""
        solid = (opacity >= 0.5).reshape(1, 1, *self.shape).float()

        def most(values: torch.Tensor) -> torch.Tensor:
            """The largest of each pixel and the four beside it."""
            along = (F.max_pool2d(values, side, stride=1, padding=(side[0] // 2, side[1] // 2)) for side in CROSS)
            return torch.maximum(*along)

        return (most(solid) != -most(-solid)).flatten().nonzero()[:, 0]

    def smooth_outline(self, composite: Composite, background: torch.Tensor, found: RayFeatures) -> RayFeatures:
        """Features and opacity along the outline averaged over four rays per feature pixel, in place.

        One ray decides for `upsampling` squared picture pixels whether they show the head, which
        draws outlines as stairs.
        """
        features, opacity, distance = found
        outline = self.outline(opacity)
        if not len(outline):
            return found
        inner = self.grid.reshape(-1, 2)[outline.cpu().numpy(), None] + INSIDE
        rays_o, rays_d = camera_rays(self.camera, inner, background.device)
        window = self._beside(distance)[:, outline].repeat_interleave(4, dim=1)
        fine, alpha, _ = composite(
            rays_o, rays_d, background[outline].repeat_interleave(4, dim=0), (window[0], window[1])
        )
        features[outline] = fine.reshape(len(outline), 4, -1).mean(1)
        opacity[outline] = alpha.reshape(-1, 4).mean(1)
        return found

    def geometry(self, seen: RayFeatures) -> GeometryView:
        """Opacity and distance of every feature pixel."""
        opacity, distance = (values.reshape(self.shape).cpu().numpy() for values in (seen.opacity, seen.distance))
        return GeometryView(self.camera, opacity, distance)

    def _beside(self, distance: torch.Tensor) -> torch.Tensor:
        """(2, h * w) window around the distances of each feature pixel and its eight neighbours."""
        far = distance.nan_to_num(-torch.inf).reshape(1, 1, *self.shape)
        near = (-distance).nan_to_num(-torch.inf).reshape(1, 1, *self.shape)
        grown = F.max_pool2d(torch.cat([near, far], dim=1), 3, stride=1, padding=1)[0].flatten(1)
        return torch.stack([-grown[0] - BESIDE[0], grown[1] + BESIDE[1]])


def to_picture(picture: torch.Tensor, camera: Camera) -> np.ndarray:
    """A picture (3, H', W') of at least the camera's size as (H, W, 3) float32 in [0, 1]."""
    image = np.ascontiguousarray(picture.permute(1, 2, 0).float().cpu().numpy())
    if image.shape[:2] != (camera.height, camera.width):
        image = cv2.resize(image, (camera.width, camera.height), interpolation=cv2.INTER_AREA)
    return np.clip(image, 0.0, 1.0)
