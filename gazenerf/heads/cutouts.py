"""What a picture shows without what is behind it: for transparent pictures and for backgrounds of another colour.

A field composites features over a learned background, so its pictures hold that background along outlines. A cutout
is the head alone, (H, W, 4) float32: sRGB times opacity, and opacity. Where a matte ends the head, its features go on
beyond the outline and the up-sampled picture is the head's own colour there; elsewhere the background's share is taken
out of the picture again by the opacity of the feature map.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Protocol, runtime_checkable

import cv2
import numpy as np
import torch
import torch.nn.functional as F

from gazenerf.geometry import Camera
from gazenerf.heads.feature_map import RayFeatures, matte_share
from gazenerf.heads.interface import BoundField, Part, RenderedView
from gazenerf.heads.shown_background import without_shown_background

BLEED = 8
"""Pixels beside what is seen to which its colours go on in a transparent picture, so that programs that resize or
compress colours without their opacity mix no black into the outline."""


@runtime_checkable
class CutOutField(Protocol):
    """A bound head that knows its cutouts."""

    def render_cut_out(self, camera: Camera, parts: tuple[Part, ...] = ("head",)) -> RenderedView:
        """As `BoundField.render`, with `cutouts`."""
        ...


def render_cut_out(bound: BoundField, camera: Camera, parts: tuple[Part, ...] = ("head",)) -> RenderedView:
    """Pictures of parts with their cutouts, of any bound head.

    Where it does not know them, they follow from its pictures, its background and the opacity it gives with them.
    """
    if isinstance(bound, CutOutField):
        view = bound.render_cut_out(camera, parts)
        found = {
            part: cutout if part == "eyes" else without_shown_background(cutout, bound.background)
            for part, cutout in view.cutouts.items()
        }
        return replace(view, cutouts=found)
    view = bound.render(camera, parts)
    behind = torch.from_numpy(np.asarray(bound.background, np.float32))[:, None, None]
    found = {}
    for part in parts:
        seen = view.geometry[part] if part in view.geometry else bound.render_geometry(camera, part)
        picture = torch.from_numpy(np.ascontiguousarray(view.images[part], dtype=np.float32)).permute(2, 0, 1)
        alone = _without(picture[None], behind, torch.from_numpy(np.asarray(seen.opacity, np.float32))[None, None])
        found[part] = alone[0].permute(1, 2, 0).numpy()
    return RenderedView(view.camera, view.images, view.geometry, found)


def cut_outs_of(seen: RayFeatures, uncut: torch.Tensor, behind: torch.Tensor, shape: tuple[int, int]) -> torch.Tensor:
    """(B, 4, H, W) cutouts of pictures.

    Args:
        seen: Along the rays of B feature maps.
        uncut: (B, 3, H, W) their up-sampled pictures before a matte, or (3, H, W) of one.
        behind: (3, H, W) picture of the background alone; not looked at where there is a matte.
        shape: (h, w) of the feature maps.
    """
    pictures = uncut.reshape(-1, *uncut.shape[-3:])
    if seen.matte is None:
        return _without(pictures, behind, seen.opacity.reshape(len(pictures), 1, *shape))
    share = matte_share(seen.matte, pictures)
    return torch.cat([share * pictures, share], dim=1)


def _without(pictures: torch.Tensor, behind: torch.Tensor, opacity: torch.Tensor) -> torch.Tensor:
    """(B, 4, H, W) pictures (B, 3, H, W) less what is behind, where opacity (B, 1, h, w) lets it through."""
    share = F.interpolate(opacity.float(), size=pictures.shape[-2:], mode="bilinear", align_corners=False)
    share = share.clamp(0.0, 1.0)
    alone = (pictures - (1.0 - share) * behind).clamp(min=0.0)
    return torch.cat([torch.minimum(alone, share), share], dim=1)


def over(cutout: np.ndarray, colour: tuple[int, int, int]) -> np.ndarray:
    """(H, W, 3) float32 sRGB picture of a cutout (H, W, 4) over a colour of 8 bits a channel."""
    return cutout[..., :3] + (1.0 - cutout[..., 3:]) * (np.asarray(colour, np.float32) / 255.0)


def transparent(cutout: np.ndarray) -> np.ndarray:
    """(H, W, 4) uint8 picture of a cutout (H, W, 4), colours not multiplied by opacity, as PNG and WebP hold them."""
    share = cutout[..., 3:]
    colours = np.divide(cutout[..., :3], share, out=np.zeros_like(cutout[..., :3]), where=share > 0.5 / 255.0)
    pixels = np.concatenate([colours, share], axis=2)
    pixels = np.clip(np.round(255.0 * pixels), 0, 255).astype(np.uint8)
    return _bled(pixels)


def _bled(pixels: np.ndarray) -> np.ndarray:
    """The picture (H, W, 4) with the nearest seen colours `BLEED` pixels beyond what is seen, and no colour beyond."""
    unseen = (pixels[..., 3] == 0).astype(np.uint8)
    if unseen.all() or not unseen.any():
        return pixels
    distance, nearest = cv2.distanceTransformWithLabels(unseen, cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL)
    colour_of = np.zeros((int(nearest.max()) + 1, 3), np.uint8)
    seen = unseen == 0
    colour_of[nearest[seen]] = pixels[seen][:, :3]
    beside = ~seen & (distance <= BLEED)
    pixels[beside, :3] = colour_of[nearest[beside]]
    return pixels
