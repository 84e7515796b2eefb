"""Teeth, gums and tongue, which a feature map is too coarse to tell apart, drawn where an open mouth shows them.

They are the head model's own, in the person's light. No training is needed: what the mouth shows is known.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from gazenerf.geometry import Camera, Gaze
from gazenerf.head_model import load_head_model
from gazenerf.head_model.interface import FACE, HAIR, MOUTH
from gazenerf.head_model.mouth import INNER_LIPS
from gazenerf.head_model.ray_scenes import interpolated, ray_scene, rays_of
from gazenerf.head_model.shading import shade
from gazenerf.heads.feature_map import FeatureGrid
from gazenerf.subjects import Codes

if TYPE_CHECKING:
    from gazenerf.heads.bound import BoundHead

ALONG_A_SIDE = 3
"""Rays along each side of a pixel that are averaged in it."""

MOST_RAYS = 1 << 20
"""Rays that are cast at once, about."""


@dataclass(frozen=True)
class MouthDetail:
    """What lies behind one person's lips, which no gaze moves.

    Attributes:
        vertices: (V, 3) of the head, world units.
        inside: (F, 3) triangles of teeth, gums and tongue.
        around: (F', 3) triangles of skin and hair, which hide them.
        colours: (V, 3) sRGB.
        lips: (L, 3) points around the opening.
    """

    vertices: np.ndarray
    inside: np.ndarray
    around: np.ndarray
    colours: np.ndarray
    lips: np.ndarray

    @cached_property
    def _scene(self) -> Any:
        return ray_scene(self.vertices, self.inside, self.around)

    def prepare(self) -> MouthDetail:
        """The same, with all that rays need, so that several threads can cast them."""
        self.seen(Camera.orbit(0.0, size=2))
        return self

    def seen(self, camera: Camera) -> tuple[np.ndarray, np.ndarray]:
        """The share of each pixel (H, W) that shows the inside of the mouth, and its sRGB colour (H, W, 3) there."""
        finer = ALONG_A_SIDE
        share = np.zeros((camera.height, camera.width))
        colour = np.zeros((camera.height, camera.width, 3))
        rows = max(1, MOST_RAYS // (finer * finer * camera.width))
        for top in range(0, camera.height, rows):
            part = camera.cropped(0, top, camera.width, min(rows, camera.height - top))
            fine = part.resized(part.width * finer, part.height * finer)
            found = self._scene.cast_rays(rays_of(fine))
            met = found["geometry_ids"].numpy() == 0
            each = np.zeros((*met.shape, 3))
            each[met] = interpolated(self.colours, self.inside, found, met)
            blocks = part.height, finer, part.width, finer
            count = met.reshape(blocks).sum(axis=(1, 3))
            total = each.reshape(*blocks, 3).sum(axis=(1, 3))
            share[top : top + rows] = count / finer**2
            colour[top : top + rows] = total / np.maximum(count, 1)[..., None]
        return share, colour


def mouth_detail(codes: Codes) -> MouthDetail | None:
    """The mouth of a person; None where the codes are not the bundled head model's."""
    model = load_head_model()
    if codes.sizes != model.code_sizes:
        return None
    head = model.mesh(codes, Gaze())
    lips = np.stack([head.landmarks[str(number)] for number in INNER_LIPS]).astype(np.float64)
    parts = head.part_faces(MOUTH), head.part_faces(FACE, HAIR)
    return MouthDetail(head.vertices, *parts, shade(head, codes.illumination), lips).prepare()


def with_mouth_detail(bounds: Sequence[BoundHead], pictures: torch.Tensor, grid: FeatureGrid) -> torch.Tensor:
    """Pictures of a head with teeth, gums and tongue in its mouth, where its field asks for detail of this kind.

    Args:
        bounds: One head at the gaze of each picture.
        pictures: (B, 3, h * k, w * k) sRGB, or one of them, before they are cut out by a matte.
        grid: The rays of their feature maps.
    """
    mouth = bounds[0].head.mouth_detail
    if mouth is None:
        return pictures
    height, width = pictures.shape[-2:]
    windows = [_window(mouth, camera.resized(width, height)) for camera in grid.cameras]
    if not any(windows):
        return pictures
    detailed = pictures.clone().reshape(-1, *pictures.shape[-3:])
    for picture, window in zip(detailed, windows, strict=True):
        if window is None:
            continue
        left, top, view = window
        share, colour = (torch.from_numpy(found.astype(np.float32)).to(picture) for found in mouth.seen(view))
        part = picture[:, top : top + view.height, left : left + view.width]
        part += (colour.permute(2, 0, 1) - part) * share
    return detailed.reshape(pictures.shape)


def _window(mouth: MouthDetail, camera: Camera) -> tuple[int, int, Camera] | None:
    """Left, top and camera of the part of a picture between the lips; None where it is outside or behind."""
    places, away = camera.project(mouth.lips)
    if (away <= 0.0).any():
        return None
    low = np.maximum(np.floor(places.min(axis=0)).astype(int), 0)
    high = np.minimum(np.ceil(places.max(axis=0)).astype(int), [camera.width, camera.height])
    if (high <= low).any():
        return None
    left, top = int(low[0]), int(low[1])
    return left, top, camera.cropped(left, top, int(high[0]) - left, int(high[1]) - top)
