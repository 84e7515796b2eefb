"""How the skin of a fitted head model moves with the gaze, for the vertices of a mesh that lies on it.

An upper lid that comes down slides over its eyeball and takes its lashes with it. A density says where the surface is
and not which point of it was where before; a head model does.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from gazenerf.geometry import Gaze
from gazenerf.head_model import ReferenceHead
from gazenerf.head_model.interface import FACE
from gazenerf.head_model.ray_scenes import interpolated, ray_scene, tensor

ON_MM, OFF_MM = 1.5, 4.0
"""Distances from the head model's skin up to which a point goes where the skin does, and from which on it stays."""


class Carried(NamedTuple):
    """How skin carries points to a gaze.

    Attributes:
        moves: (N, 3) world units.
        on_skin: (N,) bool, which of them lie on it.
    """

    moves: np.ndarray
    on_skin: np.ndarray


class SkinMotion:
    """The motion of points with the head model's skin that they lie on, or near.

    Args:
        reference: The fitted head model.
        rest: Gaze at which the points lie on it.
        points: (N, 3) world units.
        metres_per_unit: Size of a world unit.
    """

    def __init__(self, reference: ReferenceHead, rest: Gaze, points: np.ndarray, metres_per_unit: float) -> None:
        self._reference, self._rest = reference, reference.at(rest)
        self._faces = self._rest.part_faces(FACE)
        self._found = ray_scene(self._rest.vertices, self._faces).compute_closest_points(tensor(points))
        away_mm = 1000.0 * metres_per_unit * np.linalg.norm(points - self._found["points"].numpy(), axis=1)
        self._share = np.clip((OFF_MM - away_mm) / (OFF_MM - ON_MM), 0.0, 1.0)

    def carried(self, gaze: Gaze) -> Carried:
        """Where the skin goes from the gaze at rest to another."""
        turned = self._reference.at(gaze)
        skin = interpolated(turned.vertices - self._rest.vertices, self._faces, self._found)
        return Carried(self._share[:, None] * skin, self._share == 1.0)
