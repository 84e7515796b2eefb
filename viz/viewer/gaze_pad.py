"""A gaze pad in the scene before the face: the trained range as a border, and where a pointer in it looks."""

from __future__ import annotations

import numpy as np

from gazenerf.geometry import Gaze
from gazenerf.geometry.paths import GazeRange

RADIUS = 1.6
"""World units from the middle between the eyes to the pad, which is a part of a sphere."""

STEPS = 24
"""Pieces of each side of the border."""


def pad_point(eyes: np.ndarray, gaze: Gaze) -> np.ndarray:
    """(3,) where a gaze from the middle between the eyes (3,) meets the pad, world units."""
    return eyes + RADIUS * gaze.vector()


def pad_lines(eyes: np.ndarray, limits: GazeRange) -> np.ndarray:
    """(N, 2, 3) float32 segments of the border of the range and of its middle lines, world units."""
    share = np.linspace(-1.0, 1.0, STEPS + 1)
    sides = [(share, 1.0), (share, -1.0), (1.0, share), (-1.0, share), (share, 0.0), (0.0, share)]
    found = []
    for pitch, yaw in sides:
        angles = np.broadcast_arrays(np.asarray(pitch) * limits.pitch, np.asarray(yaw) * limits.yaw)
        line = np.stack([pad_point(eyes, Gaze(float(p), float(y))) for p, y in zip(*angles, strict=True)])
        found.append(np.stack([line[:-1], line[1:]], axis=1))
    return np.concatenate(found).astype(np.float32)


def pointed_gaze(
    eyes: np.ndarray, camera: np.ndarray, pointer: np.ndarray, limits: GazeRange, now: Gaze
) -> Gaze | None:
    """The gaze toward the place of the pad under a pointer, within the range.

    Args:
        eyes: (3,) middle between the eyes, world units.
        camera: (3,) centre of projection.
        pointer: (3,) another point on the ray through the pointer.
        limits: The border.
        now: The present gaze.

    Returns:
        Of the two places where the ray meets the sphere the one nearer to the present gaze; where it misses, the
        one that it comes nearest to. None where the ray has no direction.
    """
    ray = pointer - camera
    length = float(np.linalg.norm(ray))
    if not np.isfinite(length) or length < 1e-9:
        return None
    ray, offset = ray / length, camera - eyes
    along = -float(offset @ ray)
    under = RADIUS**2 - float(offset @ offset) + along**2
    reach = float(np.sqrt(max(under, 0.0)))
    places = [offset + (along + sign * reach) * ray for sign in (-1.0, 1.0)]
    best = max(places, key=lambda place: place @ now.vector())
    return limits.clip(Gaze.from_vector(best)) if np.linalg.norm(best) > 1e-9 else None
