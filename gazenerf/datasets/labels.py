"""Gaze labels of data sets: refused where they cannot be what they claim, and turned into directions."""

from __future__ import annotations

import numpy as np

from gazenerf.geometry.labels import check_radians, unit_direction
from gazenerf.photographs.normalisation import label_direction

__all__ = ["angle_faults", "check_radians", "turned_degrees", "unit_direction"]


def angle_faults(angles: np.ndarray) -> list[str | None]:
    """For each label (N, 2) why it cannot be used."""
    return [None if np.isfinite(row).all() else "its gaze label is not a finite number" for row in angles]


def turned_degrees(pitch: np.ndarray | float, yaw: np.ndarray | float) -> np.ndarray:
    """Degrees (...) between where a head faces and the camera, of published head poses in radians."""
    towards = -label_direction(pitch, yaw)[..., 2]
    return np.rad2deg(np.arccos(np.clip(towards, -1.0, 1.0)))
