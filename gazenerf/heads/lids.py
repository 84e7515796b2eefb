"""The bundled head model's lids, for fields of distances."""

from __future__ import annotations

from functools import lru_cache

import cv2
import numpy as np
import torch

from gazenerf.data.surface_points import template_of
from gazenerf.field.lids import EXTENT, PLACED_ANEW, Lids, ShutLids
from gazenerf.geometry.gaze import outward
from gazenerf.head_model import load_head_model
from gazenerf.head_model.interface import FACE, HeadMesh
from gazenerf.head_model.lids import smoothstep
from gazenerf.head_model.model import EYE_RADIUS
from gazenerf.head_model.ray_scenes import interpolated, ray_scene, tensor
from gazenerf.subjects import Codes

SIZE = 161
"""Rows and columns of a map of an opening: a degree a cell, 0.2 mm on an eyeball."""

WITHIN, FARTHEST, AROUND = 0.97, 1.0, 4.0
"""Radii from an eyeball's centre where a ray that looks for a lid begins, how many it goes on, and within how many all
skin lies that it can meet: a scene of the whole head takes most of the time."""

SHUT = (0.1, 0.4)
"""Coefficients of eyeBlinkLeft and eyeBlinkRight at which an eye begins to count as shut, and does so in full."""

CELLS = 41
"""Points along a side of the cubes in which places about shut eyes are kept: 1.4 mm apart."""


def lids(codes: Codes, head: HeadMesh, jaw: float) -> Lids:
    """A person's lids.

    Args:
        codes: Of the person.
        head: With these codes, of the bundled head model, with the eyes straight ahead.
        jaw: How far the mouth of the field's template is open.
    """
    template_centres, openings = _template_openings(jaw)
    arrays = head.eye_centres, template_centres, openings, _openings(head), np.array(EYE_RADIUS)
    return Lids(*map(_tensor, arrays), shut=_shut_lids(codes, head, jaw))


def _tensor(values: np.ndarray) -> torch.Tensor:
    return torch.from_numpy(np.array(values, np.float32))


def _shut_lids(codes: Codes, head: HeadMesh, jaw: float) -> ShutLids | None:
    """Where the skin about shut eyes lies on the template; arguments as of `lids`."""
    model = load_head_model()
    blinks = [model.expression_names.index(f"eyeBlink{side}") for side in ("Left", "Right")]
    shares = smoothstep(*SHUT, codes.expression[blinks])
    if not shares.any():
        return None
    faces, reach = _skin_near_eyes(head), PLACED_ANEW[1] * EYE_RADIUS
    scene, template = ray_scene(head.vertices, faces), template_of(model, jaw)
    side = np.linspace(-reach, reach, CELLS)
    cube = np.stack(np.meshgrid(side, side, side, indexing="ij"), axis=-1)[..., ::-1]
    found = [
        interpolated(template.vertices, faces, scene.compute_closest_points(tensor(cube.reshape(-1, 3) + centre)))
        for centre in np.asarray(head.eye_centres)
    ]
    places = np.stack(found).reshape(2, CELLS, CELLS, CELLS, 3).transpose(0, 4, 1, 2, 3)
    return ShutLids(_tensor(shares), _tensor(places))


def _skin_near_eyes(head: HeadMesh) -> np.ndarray:
    """(F, 3) triangles of the skin within `AROUND` of an eyeball."""
    skin = head.part_faces(FACE)
    near = np.linalg.norm(head.vertices[:, None] - head.eye_centres, axis=-1).min(axis=1) < AROUND * EYE_RADIUS
    return skin[near[skin].any(axis=1)]


@lru_cache(maxsize=4)
def _template_openings(jaw: float) -> tuple[np.ndarray, np.ndarray]:
    """Eyeballs' centres (2, 3) and openings (2, 1, N, N) of the template; see `Lids`."""
    template = template_of(load_head_model(), jaw)
    return np.asarray(template.eye_centres), _openings(template)


def _openings(head: HeadMesh) -> np.ndarray:
    """(2, 1, N, N) openings of a head whose eyes look straight ahead; see `Lids`."""
    scene = ray_scene(head.vertices, _skin_near_eyes(head))
    angles = np.deg2rad(np.linspace(-EXTENT, EXTENT, SIZE))
    directions = outward(*np.meshgrid(angles, angles, indexing="ij"))
    found = []
    for centre in np.asarray(head.eye_centres):
        rays = np.concatenate([centre + WITHIN * EYE_RADIUS * directions, directions], axis=-1)
        opening = scene.cast_rays(tensor(rays))["t_hit"].numpy() > FARTHEST * EYE_RADIUS
        opening = _largest(opening).astype(np.uint8)
        inside, outside = (
            cv2.distanceTransform(side, cv2.DIST_L2, cv2.DIST_MASK_PRECISE) for side in (opening, 1 - opening)
        )
        found.append((inside - outside) * (angles[1] - angles[0]) * EYE_RADIUS)
    return np.stack(found)[:, None]


def _largest(opening: np.ndarray) -> np.ndarray:
    """(N, N) bool, the largest of the pieces that something (N, N) consists of: beside lids rays miss the skin, too."""
    _, pieces, about, _ = cv2.connectedComponentsWithStats(opening.astype(np.uint8))
    sizes = about[1:, cv2.CC_STAT_AREA]
    return pieces == 1 + int(sizes.argmax()) if len(sizes) else opening
