"""The bundled head model's lids, for fields of distances."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import lru_cache
from typing import Any

import cv2
import numpy as np
import torch
from scipy.ndimage import distance_transform_edt

from gazenerf.data.surface_points import template_of
from gazenerf.field.lids import EXTENT, Lids
from gazenerf.geometry import Gaze
from gazenerf.geometry.gaze import outward
from gazenerf.head_model import load_head_model
from gazenerf.head_model.interface import FACE
from gazenerf.head_model.lids import LID_LIMIT, LID_PITCH, LID_YAW, smoothstep
from gazenerf.head_model.model import EYE_RADIUS
from gazenerf.head_model.ray_scenes import interpolated, ray_scene, tensor
from gazenerf.subjects import Codes

SIZE, SKIN_SIZE = 161, 81
"""Rows and columns of maps of openings, a degree a cell or 0.2 mm on an eyeball, and of maps of skin."""

WITHIN, FARTHEST, AROUND = 0.97, 1.0, 5.0
"""Radii from an eyeball's centre where a ray that looks for a lid begins, how many it goes on, and within how many of
the template's all skin lies that it can meet: a scene of the whole head takes most of the time."""

FARTHEST_SKIN, CROSSINGS, STEP = 2.2, 4, 1e-4
"""Radii from an eyeball's centre within which its skin is placed, how often rays go through skin until then at most,
and world units by which they go on after it."""

FILLED = 2.0
"""Cells beyond the skin that are told as it is."""

KEYS = (3, 1)
"""Steps of pitch and of yaw, to either side, from the eyes straight ahead to where lids follow no further."""

SHUT = (0.1, 0.4)
"""Coefficients of eyeBlinkLeft and eyeBlinkRight at which an eye begins to count as shut, and does so in full."""


def between(gaze: Gaze) -> tuple[list[Gaze], list[float]]:
    """Up to four gazes between whose lids those at a gaze lie, and their weights, which add up to 1.

    They are on a grid as far as lids follow: the head model's skin goes nearly linearly from one to the next.
    """
    places = []
    for angle, most, steps in ((gaze.pitch, LID_LIMIT * LID_PITCH, KEYS[0]), (gaze.yaw, LID_LIMIT * LID_YAW, KEYS[1])):
        place = float(np.clip(angle / most, -1.0, 1.0)) * steps
        low = math.floor(place)
        share = place - low
        places.append([(most * (low + i) / steps, weight) for i, weight in ((0, 1.0 - share), (1, share)) if weight])
    pairs = [(Gaze(pitch, yaw), up * left) for pitch, up in places[0] for yaw, left in places[1]]
    return [key for key, _ in pairs], [weight for _, weight in pairs]


def lids(codes: Codes, gaze: Gaze, jaw: float) -> Lids:
    """A person's lids at a gaze.

    Skin is placed where lids are lower than straight ahead, or shut: elsewhere a network tells its place as well.

    Args:
        codes: Of the person.
        gaze: Head frame.
        jaw: How far the mouth of the field's template is open.
    """
    model = load_head_model()
    head, template = model.mesh(replace(codes, hair=codes.hair[:0]), gaze), template_of(model, jaw)
    blinks = [model.expression_names.index(f"eyeBlink{side}") for side in ("Left", "Right")]
    shut = smoothstep(*SHUT, codes.expression[blinks])
    lowered = np.ones(2) if gaze.pitch < 0.0 else shut
    faces = _skin_near_eyes()
    scene = ray_scene(head.vertices, faces)
    openings, skins = [], []
    for centre, share in zip(np.asarray(head.eye_centres), lowered, strict=True):
        openings.append(_from_border(_opening(scene, centre))[None])
        skin = np.zeros((2, 5, SKIN_SIZE, SKIN_SIZE))
        if share or gaze.pitch == 0.0:  # between which and a lower gaze they count
            skin = _skins(scene, centre, faces, template.vertices)
            skin[:, 4] *= share
        skins.append(skin)
    arrays = head.eye_centres, np.stack(openings), np.stack(skins), shut, np.array(EYE_RADIUS)
    return Lids(*(torch.from_numpy(np.array(values, np.float32)) for values in arrays))


@lru_cache(maxsize=1)
def _skin_near_eyes() -> np.ndarray:
    """(F, 3) triangles of the skin within `AROUND` of an eyeball of the template."""
    head = template_of(load_head_model())
    skin = head.part_faces(FACE)
    near = np.linalg.norm(head.vertices[:, None] - head.eye_centres, axis=-1).min(axis=1) < AROUND * EYE_RADIUS
    return skin[near[skin].any(axis=1)]


def _directions(size: int) -> np.ndarray:
    """(size, size, 3) directions of a map's cells; see `Lids`."""
    angles = np.deg2rad(np.linspace(-EXTENT, EXTENT, size))
    return outward(*np.meshgrid(angles, angles, indexing="ij"))


def _opening(scene: Any, centre: np.ndarray) -> np.ndarray:
    """(SIZE, SIZE) bool, in which directions no lid lies before an eyeball."""
    directions = _directions(SIZE)
    rays = np.concatenate([centre + WITHIN * EYE_RADIUS * directions, directions], axis=-1)
    return _largest(scene.cast_rays(tensor(rays))["t_hit"].numpy() > FARTHEST * EYE_RADIUS)


def _from_border(opening: np.ndarray) -> np.ndarray:
    """(SIZE, SIZE) distance from the border of an opening, world units, positive within it."""
    inside, outside = (
        cv2.distanceTransform(side.astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE) for side in (opening, ~opening)
    )
    return (inside - outside) * np.deg2rad(2.0 * EXTENT / (SIZE - 1)) * EYE_RADIUS


def _skins(scene: Any, centre: np.ndarray, faces: np.ndarray, template: np.ndarray) -> np.ndarray:
    """(2, 5, SKIN_SIZE, SKIN_SIZE) the first and the last skin in each direction; see `Lids.skins`.

    Of those within `FARTHEST_SKIN` that rays from the eyeball's centre leave by the front. Directions without any have
    what the nearest has that is not more than `FILLED` cells away.

    Args:
        scene: Of the skin near the eyes.
        centre: (3,) of the eyeball.
        faces: (F, 3) of the scene.
        template: (V, 3) vertices.
    """
    directions = _directions(SKIN_SIZE).reshape(-1, 3)
    reached = np.full(len(directions), WITHIN * EYE_RADIUS)
    found, met = np.zeros((2, len(directions), 5)), np.zeros(len(directions), bool)
    going = np.arange(len(directions))
    for _ in range(CROSSINGS):
        along = directions[going]
        hits = scene.cast_rays(tensor(np.concatenate([centre + reached[going, None] * along, along], axis=-1)))
        reached[going] += hits["t_hit"].numpy() + STEP
        near = reached[going] < FARTHEST_SKIN * EYE_RADIUS
        left = near & ((hits["primitive_normals"].numpy() * along).sum(-1) > 0.0)
        skin = going[left]
        here = np.column_stack([interpolated(template, faces, hits, left), reached[skin], np.ones(len(skin))])
        first = ~met[skin]
        found[0, skin[first]], found[1, skin], met[skin] = here[first], here, True
        going = going[near]
    if met.any():
        from_skin = distance_transform_edt(~met.reshape(SKIN_SIZE, SKIN_SIZE), return_indices=True)
        assert isinstance(from_skin, tuple)
        away, nearest = from_skin
        found = found[:, np.ravel_multi_index(tuple(nearest), (SKIN_SIZE, SKIN_SIZE)).ravel()]
        found[:, away.ravel() > FILLED, 4] = 0.0
    return np.moveaxis(found.reshape(2, SKIN_SIZE, SKIN_SIZE, 5), -1, 1)


def _largest(opening: np.ndarray) -> np.ndarray:
    """(N, N) bool, the largest of the pieces that something (N, N) consists of: beside lids rays miss the skin, too."""
    _, pieces, about, _ = cv2.connectedComponentsWithStats(opening.astype(np.uint8))
    sizes = about[1:, cv2.CC_STAT_AREA]
    return pieces == 1 + int(sizes.argmax()) if len(sizes) else opening
