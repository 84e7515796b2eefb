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


class Outline(NamedTuple):
    """The outline of what feature maps show.

    Attributes:
        pixels: (E,) indices of the feature pixels on it.
        quarters: (E, 4) opacity of each quarter of theirs.
        solid: (R,) bool, where one ray a feature pixel meets the head.
    """

    pixels: torch.Tensor
    quarters: torch.Tensor
    solid: torch.Tensor


class RayFeatures(NamedTuple):
    """What is seen along rays.

    Attributes:
        features: (R, C) over the background.
        opacity: (R,).
        distance: (R,) expected, world units; NaN without a surface.
        end: (R,) distance up to which the ray was sampled; NaN without a surface, None where it does not matter.
        matte: (2 h, 2 w) of a whole feature map, (B, 2 h, 2 w) of several: share of the head in each quarter of a
            feature pixel. Where it is given, features go on a little beyond the outline, and the picture is cut out
            by it.
        outline: What was found along the outline; None where there is none, or nobody looked.
    """

    features: torch.Tensor
    opacity: torch.Tensor
    distance: torch.Tensor
    end: torch.Tensor | None = None
    matte: torch.Tensor | None = None
    outline: Outline | None = None


Window = tuple[torch.Tensor, torch.Tensor]
"""Nearest and farthest distance (R,) at which a ray's surface is looked for."""

FAINT = 0.02
"""Opacity from which a feature pixel away from outlines shows anything of the head."""

SEEN_THROUGH = 0.03
"""Share of light left behind a surface from which what lies behind it is looked for: the rim of an ear is no hole."""


def add_behind(
    front: RayFeatures, background: torch.Tensor, look: Callable[[torch.Tensor, Window], RayFeatures]
) -> RayFeatures:
    """What lies behind thin surfaces takes the place of the background, in place.

    Args:
        front: What rays see of their first surface, over the background, with its `end`.
        background: (R, C).
        look: Numbers of rays (A,) and where to look, to what those rays see there over their background.
    """
    assert front.end is not None
    left = 1.0 - front.opacity
    rays = ((left > SEEN_THROUGH) & (front.opacity > 0.0) & front.end.isfinite()).nonzero()[:, 0]
    if not len(rays):
        return front
    start = front.end[rays]
    behind = look(rays, (start, torch.full_like(start, torch.inf)))
    front.features[rays] += left[rays, None] * (behind.features - background[rays])
    front.opacity[rays] += left[rays] * behind.opacity
    front.distance[rays] = torch.where(front.distance[rays].isnan(), behind.distance, front.distance[rays])
    return front


Composite = Callable[[torch.Tensor, torch.Tensor, torch.Tensor, Window, torch.Tensor], RayFeatures]
"""Rays (R, 3), (R, 3), background features (R, C), where their surface may be, and the number (R,) of the picture that
each belongs to, to what is seen along them."""

BESIDE = (0.15, 0.35)
"""World units before and behind the surfaces of a feature pixel and its neighbours that its finer rays may meet:
a surface seen edge-on recedes fast."""

INSIDE = np.array([[-0.25, -0.25], [0.25, -0.25], [-0.25, 0.25], [0.25, 0.25]])
"""Four rays of a feature pixel, from its own ray, in feature pixels."""


BAND = 2
"""Feature pixels beside an outline in which a matte decides what shows the head."""

BEYOND = BAND + 1
"""Feature pixels, at most, by which features go on beyond the solid head."""

PURE = 0.4
"""Opacity from which the feature of a pixel on an outline is known without its background."""

EDGE, CONTRAST = 0.7, 0.75
"""Share at which a matte ends the head, and its slope there, per picture pixel of its own pixels.

Rays that graze a soft surface see some of it beyond its outline, so that 0.5 would draw heads too large. On captures of
five people and the portrait field, 7 pixels about the outlines are drawn 1.4 dB better than by averaged features, and
heads as a whole 0.4 dB worse, because what is cut off shows the background.
"""

CROSS = ((3, 1), (1, 3))
"""Sides of the windows that together are a pixel and the four beside it."""


@dataclass(frozen=True)
class FeatureGrid:
    """Rays of the feature maps of B pictures of one size.

    Attributes:
        cameras: At the feature map's size.
        grid: (h, w, 2) image coordinates of the rays.
        rays_o, rays_d: (B * h * w, 3), picture after picture, x fastest.
    """

    cameras: tuple[Camera, ...]
    grid: np.ndarray
    rays_o: torch.Tensor
    rays_d: torch.Tensor

    @classmethod
    def of(cls, camera: Camera, config: FieldConfig, device: torch.device | str = "cpu", *more: Camera) -> FeatureGrid:
        """The grid behind a picture of the camera's size; at least 2 x 2, rounded up to whole feature pixels.

        Args:
            camera: Of the picture.
            config: Of the field.
            device: Where the rays lie.
            more: Cameras of further pictures of the same size.
        """
        k = config.upsampling
        columns, rows = max(2, -(-camera.width // k)), max(2, -(-camera.height // k))
        small = tuple(one.resized(columns, rows) for one in (camera, *more))
        grid = np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), axis=-1) + config.ray_offset
        if not more:
            return cls(small, grid, *camera_rays(small[0], grid, device))
        origins, directions = zip(*(camera_rays(one, grid, device) for one in small), strict=True)
        return cls(small, grid, torch.cat(origins), torch.cat(directions))

    @property
    def shape(self) -> tuple[int, int]:
        """(h, w)."""
        return self.grid.shape[0], self.grid.shape[1]

    @property
    def pictures(self) -> torch.Tensor:
        """(B * h * w,) the number of the picture that each ray belongs to."""
        count = self.shape[0] * self.shape[1]
        return torch.arange(len(self.cameras), device=self.rays_o.device).repeat_interleave(count)

    def rays_within(self, outline: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Four rays (4 E, 3), (4 E, 3) in each of some feature pixels (E,), ascending, and their pictures (4 E,)."""
        count = self.shape[0] * self.shape[1]
        places = outline.cpu().numpy()
        inner = self.grid.reshape(-1, 2)[places % count, None] + INSIDE
        picture, device = places // count, self.rays_o.device
        numbers = (outline // count).repeat_interleave(len(INSIDE))
        if len(self.cameras) == 1:
            return *camera_rays(self.cameras[0], inner, device), numbers
        found = [camera_rays(camera, inner[picture == i], device) for i, camera in enumerate(self.cameras)]
        return torch.cat([rays[0] for rays in found]), torch.cat([rays[1] for rays in found]), numbers

    def outline(self, opacity: torch.Tensor) -> torch.Tensor:
        """(E,) indices of the feature pixels on an outline of opacity (B * h * w,)."""
        solid = (opacity >= 0.5).reshape(-1, 1, *self.shape).float()

        def most(values: torch.Tensor) -> torch.Tensor:
            """The largest of each pixel and the four beside it."""
            along = (F.max_pool2d(values, side, stride=1, padding=(side[0] // 2, side[1] // 2)) for side in CROSS)
            return torch.maximum(*along)

        return (most(solid) != -most(-solid)).flatten().nonzero()[:, 0]

    def smooth_outline(
        self, composite: Composite, background: torch.Tensor, found: RayFeatures, cut: bool = False
    ) -> RayFeatures:
        """Features and opacity along the outline from four rays per feature pixel, in place.

        One ray decides for `upsampling` squared picture pixels whether they show the head, which
        draws outlines as stairs.

        Args:
            composite: What is seen along rays.
            background: (B * h * w, C).
            found: One ray per feature pixel.
            cut: Leave the outline to a matte instead of mixing head and background in features, which the
                up-sampler has not learned and draws as stairs, too.
        """
        opacity, distance = found.opacity, found.distance
        outline = self.outline(opacity)
        if not len(outline):
            return found
        solid = opacity >= 0.5
        rays_o, rays_d, pictures = self.rays_within(outline)
        window = self._beside(distance)[:, outline].repeat_interleave(4, dim=1)
        fine = composite(
            rays_o, rays_d, background[outline].repeat_interleave(4, dim=0), (window[0], window[1]), pictures
        )
        found.features[outline] = fine.features.reshape(len(outline), 4, -1).mean(1)
        quarters = fine.opacity.reshape(-1, 4)
        opacity[outline] = quarters.mean(1)
        found = found._replace(outline=Outline(outline, quarters, solid))
        return self.with_matte(found, background) if cut else found

    def with_matte(self, found: RayFeatures, background: torch.Tensor) -> RayFeatures:
        """Features that go on beyond the outline, with the matte that ends them; as they are without an outline.

        Args:
            found: From `smooth_outline`.
            background: (B * h * w, C) that is behind them.
        """
        if found.outline is None:
            return found
        outline, quarters, solid = found.outline
        near = torch.zeros_like(solid)
        near[outline] = True
        near = grown(near.reshape(-1, *self.shape), BAND)
        matte = torch.where(near.flatten(), solid.float(), (found.opacity > FAINT).float())
        matte = matte[:, None].repeat(1, 4)
        matte[outline] = quarters.to(matte.dtype)
        quarters = matte.reshape(-1, *self.shape, 4).permute(0, 3, 1, 2)
        matte = F.pixel_shuffle(quarters, 2)[:, 0]
        matte = matte[0] if len(matte) == 1 else matte
        beyond = self._beyond(found.features, found.opacity, background, outline, near)
        return found._replace(features=beyond, matte=matte)

    def _beyond(
        self,
        features: torch.Tensor,
        opacity: torch.Tensor,
        background: torch.Tensor,
        outline: torch.Tensor,
        near: torch.Tensor,
    ) -> torch.Tensor:
        """(B * h * w, C) features that near an outline (B, h, w) are the head's own, on either side of it."""
        known = opacity >= 0.5
        known[outline] = opacity[outline] >= PURE
        pure = features.clone()
        alpha = opacity[outline].clamp(min=PURE)[:, None]
        pure[outline] = background[outline] + (features[outline] - background[outline]) / alpha
        rows, columns = self.shape
        values = F.pad(pure.reshape(-1, rows, columns, pure.shape[1]), (0, 0, 1, 1, 1, 1)).flatten(0, 2)
        known, wanted = (F.pad(mask, (1, 1, 1, 1)).flatten() for mask in (known.reshape(near.shape), near))
        around = torch.tensor([y * (columns + 2) + x for y in (-1, 0, 1) for x in (-1, 0, 1)], device=known.device)
        for _ in range(BEYOND):
            beside = (wanted & ~known).nonzero() + around
            share = known[beside].to(values.dtype)
            total = share.sum(1)
            reached = total > 0.0
            beside, share, total = beside[reached], share[reached], total[reached]
            here = beside[:, len(around) // 2]
            values[here] = (values[beside] * share[..., None]).sum(1) / total[:, None]
            known[here] = True
        values = values.reshape(-1, rows + 2, columns + 2, values.shape[1])
        return values[:, 1:-1, 1:-1].flatten(0, 2)

    def geometry(self, seen: RayFeatures) -> list[GeometryView]:
        """Opacity and distance of every feature pixel, a view for each picture."""
        opacity, distance = (values.reshape(-1, *self.shape).cpu().numpy() for values in (seen.opacity, seen.distance))
        return [GeometryView(*view) for view in zip(self.cameras, opacity, distance, strict=True)]

    def _beside(self, distance: torch.Tensor) -> torch.Tensor:
        """(2, B * h * w) window around the distances of each feature pixel and its eight neighbours."""
        far = distance.nan_to_num(-torch.inf).reshape(-1, 1, *self.shape)
        near = (-distance).nan_to_num(-torch.inf).reshape(-1, 1, *self.shape)
        grown = F.max_pool2d(torch.cat([near, far], dim=1), 3, stride=1, padding=1).transpose(0, 1).flatten(1)
        return torch.stack([-grown[0] - BESIDE[0], grown[1] + BESIDE[1]])


def grown(mask: torch.Tensor, by: int) -> torch.Tensor:
    """(..., h, w) bool: the pixels of masks, and those at most so many from one of them along each axis."""
    whole = mask.reshape(-1, 1, *mask.shape[-2:]).float()
    return (F.max_pool2d(whole, 2 * by + 1, stride=1, padding=by) > 0).reshape(mask.shape)


def cut_out(picture: torch.Tensor, behind: torch.Tensor, matte: torch.Tensor) -> torch.Tensor:
    """A picture (3, H, W) where a matte (2 h, 2 w) is, over the picture behind (3, H, W); or B of both over it."""
    return torch.lerp(behind, picture, matte_share(matte, picture))


def matte_share(matte: torch.Tensor, picture: torch.Tensor) -> torch.Tensor:
    """(1, H, W) share in [0, 1] of the head in a picture (3, H, W) with a matte (2 h, 2 w); (B, 1, H, W) of B of both.

    The matte is smoothed and sharpened again, so that its contour is a line and not a row of squares.
    """
    rows = F.pad(matte.reshape(-1, 1, *matte.shape[-2:]).float(), (1, 1, 1, 1), mode="replicate")
    smooth = F.avg_pool2d(F.avg_pool2d(rows, 2, stride=1), 2, stride=1)
    share = F.interpolate(smooth, size=picture.shape[-2:], mode="bilinear", align_corners=False)
    share = share if picture.dim() == 4 else share[0]
    slope = max(0.5 / (1.0 - EDGE), CONTRAST * 2.0 * picture.shape[-2] / matte.shape[-2])
    return ((share - EDGE) * slope + 0.5).clamp(0.0, 1.0)


def to_picture(picture: torch.Tensor, camera: Camera) -> np.ndarray:
    """A picture (3, H', W') of at least the camera's size as (H, W, 3) float32 in [0, 1]."""
    image = np.ascontiguousarray(picture.permute(1, 2, 0).float().cpu().numpy())
    if image.shape[:2] != (camera.height, camera.width):
        image = cv2.resize(image, (camera.width, camera.height), interpolation=cv2.INTER_AREA)
    return np.clip(image, 0.0, 1.0)
