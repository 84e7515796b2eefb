"""The bundled head model's lids, for fields of distances."""

from __future__ import annotations

from functools import lru_cache

import cv2
import numpy as np
import torch

from gazenerf.data.surface_points import template_of
from gazenerf.field.lids import EXTENT, Lids
from gazenerf.head_model import load_head_model
from gazenerf.head_model.interface import FACE
from gazenerf.head_model.model import EYE_RADIUS
from gazenerf.head_model.ray_scenes import ray_scene, tensor
from gazenerf.subjects import Codes

SIZE = 161
"""Rows and columns of a map of an opening: a degree a cell, 0.2 mm on an eyeball."""

WITHIN, FARTHEST = 0.97, 1.0
"""Radii from an eyeball's centre where a ray that looks for a lid begins, and how many it goes on."""


def lids(codes: Codes, jaw: float) -> Lids | None:
    """A person's lids; None where the codes are not the bundled head model's.

    Args:
        codes: Of the person.
        jaw: How far the mouth of the field's template is open.
    """
    model = load_head_model()
    if codes.sizes != model.code_sizes:
        return None
    template_centres, openings = _openings(jaw)
    arrays = model.eye_centres(codes.identity), template_centres, openings, np.array(EYE_RADIUS)
    return Lids(*(torch.from_numpy(np.array(array, np.float32)) for array in arrays))


@lru_cache(maxsize=4)
def _openings(jaw: float) -> tuple[np.ndarray, np.ndarray]:
    """Eyeballs' centres (2, 3) and openings (2, 1, N, N) of the template; see `Lids`."""
    template = template_of(load_head_model(), jaw)
    skin = ray_scene(template.vertices, template.part_faces(FACE))
    angles = np.deg2rad(np.linspace(-EXTENT, EXTENT, SIZE))
    elevation, azimuth = np.meshgrid(angles, angles, indexing="ij")
    level = np.cos(elevation)
    outward = np.stack([np.sin(azimuth) * level, np.sin(elevation), np.cos(azimuth) * level], axis=-1)
    found = []
    for centre in template.eye_centres:
        rays = np.concatenate([centre + WITHIN * EYE_RADIUS * outward, outward], axis=-1)
        opening = skin.cast_rays(tensor(rays))["t_hit"].numpy() > FARTHEST * EYE_RADIUS
        pieces = cv2.connectedComponents(opening.astype(np.uint8))[1]
        opening = (pieces == pieces[SIZE // 2, SIZE // 2]).astype(np.uint8)
        inside, outside = (
            cv2.distanceTransform(side, cv2.DIST_L2, cv2.DIST_MASK_PRECISE) for side in (opening, 1 - opening)
        )
        found.append((inside - outside) * (angles[1] - angles[0]) * EYE_RADIUS)
    return np.asarray(template.eye_centres), np.stack(found)[:, None]
