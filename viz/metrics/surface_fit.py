"""Points on surfaces, and the motion that lays one surface on another."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation


@dataclass(frozen=True)
class SurfaceSamples:
    """Points on a surface.

    Attributes:
        points: (N, 3) world units.
        normals: (N, 3) unit, outward.
    """

    points: np.ndarray
    normals: np.ndarray

    def moved(self, alignment: Alignment) -> SurfaceSamples:
        """The samples after an alignment."""
        return SurfaceSamples(alignment.apply(self.points), self.normals @ alignment.rotation.T)


@dataclass(frozen=True)
class Alignment:
    """x to scale * rotation @ x + translation, world units, never mirrored.

    Attributes:
        rotation: (3, 3).
        translation: (3,).
        scale: 1 for a rigid fit.
    """

    rotation: np.ndarray
    translation: np.ndarray
    scale: float = 1.0

    @property
    def angle(self) -> float:
        """Of the rotation, radians."""
        return float(np.arccos(np.clip(0.5 * (np.trace(self.rotation) - 1.0), -1.0, 1.0)))

    def apply(self, points: np.ndarray) -> np.ndarray:
        """Points (N, 3) moved."""
        return self.scale * points @ self.rotation.T + self.translation


def align(
    moving: SurfaceSamples, fixed: SurfaceSamples, *, scale: bool = False, iterations: int = 25, count: int = 4000
) -> Alignment:
    """The rigid motion, or similarity, that best lays one surface on another.

    Point-to-plane ICP (Chen and Medioni 1992) from the identity; pairs farther apart than three
    times the median are left out.

    Args:
        moving: What is moved.
        fixed: What it is laid on.
        scale: Also find a scale.
        iterations: At most.
        count: Moving points used.
    """
    points = moving.points[:: max(1, len(moving.points) // count)]
    tree = KDTree(fixed.points)
    found = Alignment(np.eye(3), np.zeros(3))
    for _ in range(iterations):
        here = found.apply(points)
        gap, nearest = tree.query(here)
        kept = np.asarray(gap) <= 3.0 * np.median(gap) + 1e-9
        pairs = np.asarray(nearest)[kept]
        here, target, normal = here[kept], fixed.points[pairs], fixed.normals[pairs]
        columns = [np.cross(here, normal), normal]
        if scale:
            columns.append((here * normal).sum(-1, keepdims=True))
        step, *_ = np.linalg.lstsq(np.concatenate(columns, axis=1), ((target - here) * normal).sum(-1), rcond=None)
        turn = Rotation.from_rotvec(step[:3]).as_matrix()
        grow = 1.0 + float(step[6]) if scale else 1.0
        found = Alignment(turn @ found.rotation, grow * turn @ found.translation + step[3:6], grow * found.scale)
        if np.abs(step).max() < 1e-7:
            break
    return found
