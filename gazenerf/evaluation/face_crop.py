"""The part of a head that face benchmarks judge: the NoW benchmark's ball about the nose."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gazenerf.head_model.interface import HeadMesh

OUTER_CORNERS, INNER_CORNERS, NOSE_BASE = ("36", "45"), ("39", "42"), "33"
"""Names of the standard landmarks that place the ball."""

RADIUS_SHARE, LIFT = 1.4, 0.3


@dataclass(frozen=True)
class FaceCrop:
    """A ball about the nose, in the frame and units of the mesh that it was made from.

    Attributes:
        centre: (3,).
        radius: Of the ball.
    """

    centre: np.ndarray
    radius: float

    def contains(self, points: np.ndarray) -> np.ndarray:
        """(...,) bool: which points (..., 3) lie inside or on the ball."""
        return np.linalg.norm(np.asarray(points) - self.centre, axis=-1) <= self.radius

    def scaled(self, factor: float) -> FaceCrop:
        """The same ball in other units, such as `mesh.metres_per_unit` for metres."""
        return FaceCrop(self.centre * factor, self.radius * factor)


def face_crop(mesh: HeadMesh) -> FaceCrop | None:
    """The face crop of the NoW benchmark (Sanyal et al. 2019).

    The ball's radius is 1.4 times half the sum of the outer eye distance and the nose length (from
    the middle between the inner eye corners to the nose base); its centre is the nose base, moved by
    0.3 of the nose length toward that middle.

    Returns:
        None where the mesh lacks one of the five landmarks.
    """
    if not {*OUTER_CORNERS, *INNER_CORNERS, NOSE_BASE} <= set(mesh.landmarks):
        return None
    outer, inner = (
        [np.asarray(mesh.landmarks[name], dtype=np.float64) for name in names]
        for names in (OUTER_CORNERS, INNER_CORNERS)
    )
    base = np.asarray(mesh.landmarks[NOSE_BASE], dtype=np.float64)
    nose = 0.5 * (inner[0] + inner[1]) - base
    width, length = float(np.linalg.norm(outer[0] - outer[1])), float(np.linalg.norm(nose))
    return FaceCrop(base + LIFT * nose, RADIUS_SHARE * 0.5 * (width + length))
