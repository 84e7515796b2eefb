"""Teeth, gums and tongue, which a feature map is too coarse to tell apart, drawn where an open mouth shows them.

They are the head model's own, in the person's light. No training is needed: what the mouth shows is known.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import torch

from gazenerf.geometry import Camera
from gazenerf.head_model.interface import FACE, HAIR, MOUTH, HeadMesh
from gazenerf.head_model.mouth import INNER_LIPS
from gazenerf.head_model.ray_scenes import interpolated, ray_scene, rays_of
from gazenerf.heads.feature_map import FeatureGrid

if TYPE_CHECKING:
    from gazenerf.heads.bound import BoundHead

ALONG_A_SIDE = 3
"""Rays along each side of a pixel that are averaged in it."""

MOST_RAYS = 1 << 20
"""Rays that are cast at once, about."""


class MouthScene(NamedTuple):
    """What lies behind a person's lips, which no gaze moves.

    Attributes:
        scene: Of teeth, gums and tongue, and of the skin and hair that may hide them; see `ray_scene`.
        inside: (F, 3) triangles of teeth, gums and tongue.
        lips: (L, 3) points around the opening.
    """

    scene: Any
    inside: np.ndarray
    lips: np.ndarray


@dataclass(frozen=True)
class MouthDetail:
    """A person's mouth, coloured.

    Attributes:
        shape: Of it.
        colours: (V, 3) sRGB of the head's vertices.
    """

    shape: MouthScene
    colours: np.ndarray

    def seen(self, camera: Camera) -> tuple[np.ndarray, np.ndarray]:
        """The share of each pixel (H, W) that shows the inside of the mouth, and its sRGB colour (H, W, 3) there."""
        finer = ALONG_A_SIDE
        share = np.zeros((camera.height, camera.width))
        colour = np.zeros((camera.height, camera.width, 3))
        rows = max(1, MOST_RAYS // (finer * finer * camera.width))
        for top in range(0, camera.height, rows):
            part = camera.cropped(0, top, camera.width, min(rows, camera.height - top))
            fine = part.resized(part.width * finer, part.height * finer)
            found = self.shape.scene.cast_rays(rays_of(fine))
            met = found["geometry_ids"].numpy() == 0
            each = np.zeros((*met.shape, 3))
            each[met] = interpolated(self.colours, self.shape.inside, found, met)
            blocks = part.height, finer, part.width, finer
            count = met.reshape(blocks).sum(axis=(1, 3))
            total = each.reshape(*blocks, 3).sum(axis=(1, 3))
            share[top : top + rows] = count / finer**2
            colour[top : top + rows] = total / np.maximum(count, 1)[..., None]
        return share, colour


def mouth_scene(head: HeadMesh) -> MouthScene:
    """The mouth of a head of the bundled head model.

    Only skin and hair farther to the front than its deepest point can hide it from a camera before the face; without
    the rest rays are prepared for in half the time.
    """
    lips = np.stack([head.landmarks[str(number)] for number in INNER_LIPS]).astype(np.float64)
    inside, outside = head.part_faces(MOUTH), head.part_faces(FACE, HAIR)
    before = head.vertices[:, 2] > head.vertices[np.unique(inside), 2].min()
    scene = ray_scene(head.vertices, inside, outside[before[outside].any(axis=1)])
    scene.cast_rays(rays_of(Camera.orbit(0.0, size=1)))  # prepares it, which two threads at once must not
    return MouthScene(scene, inside, lips)


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
    windows = [_window(mouth.shape.lips, camera.resized(width, height)) for camera in grid.cameras]
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


def _window(lips: np.ndarray, camera: Camera) -> tuple[int, int, Camera] | None:
    """Left, top and camera of the part of a picture between the lips; None where it is outside, or the camera is not
    before the face."""
    places, away = camera.project(lips)
    if (away <= 0.0).any() or camera.position[2] <= lips[:, 2].min():
        return None
    return camera.part_between(places.min(axis=0), places.max(axis=0))
