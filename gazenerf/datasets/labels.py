"""Gaze labels of data sets: refused where they cannot be what they claim, and turned into directions."""

from __future__ import annotations

import numpy as np

from gazenerf.errors import UserError
from gazenerf.photographs.normalisation import label_direction

SHORTEST = 1e-6
"""Length of a gaze vector below which it points nowhere; the published ones are in millimetres."""


def check_radians(angles: np.ndarray, what: str) -> None:
    """Refuse labels that cannot be radians.

    Args:
        angles: (N, 2) pitch and yaw; NaN counts for nothing here.
        what: Where they are, for the message.

    Raises:
        UserError: a pitch beyond a quarter turn or a yaw beyond a half one.
    """
    largest = np.nanmax(np.abs(angles), axis=0, initial=0.0) if len(angles) else np.zeros(2)
    if largest[0] > np.pi / 2 + 1e-6 or largest[1] > np.pi + 1e-6:
        raise UserError(
            f"{what} reaches pitch {largest[0]:.4g} and yaw {largest[1]:.4g}, but its labels are radians; these look "
            "like degrees (np.deg2rad turns them back) or like another version of the data set"
        )


def angle_faults(angles: np.ndarray) -> list[str | None]:
    """For each label (N, 2) why it cannot be used."""
    return [None if np.isfinite(row).all() else "its gaze label is not a finite number" for row in angles]


def unit_direction(vector: np.ndarray) -> np.ndarray:
    """(3,) unit vector along a gaze vector.

    Raises:
        ValueError: it has no length, or is not finite.
    """
    length = float(np.linalg.norm(vector))
    if not np.isfinite(length):
        raise ValueError("its gaze vector is not finite")
    if length < SHORTEST:
        raise ValueError("its gaze vector has no length")
    return np.asarray(vector, dtype=np.float64) / length


def turned_degrees(pitch: np.ndarray | float, yaw: np.ndarray | float) -> np.ndarray:
    """Degrees (...) between where a head faces and the camera, of published head poses in radians."""
    towards = -label_direction(pitch, yaw)[..., 2]
    return np.rad2deg(np.arccos(np.clip(towards, -1.0, 1.0)))
