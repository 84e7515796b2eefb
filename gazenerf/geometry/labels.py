"""Labels of gazes that cannot be what they claim: degrees instead of radians, and vectors that point nowhere."""

from __future__ import annotations

import numpy as np

from gazenerf.errors import UserError

SHORTEST = 1e-6
"""Length of a gaze vector below which it points nowhere; published ones are in millimetres."""


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


def unit_direction(vector: np.ndarray, what: str = "its gaze vector") -> np.ndarray:
    """(3,) unit vector along a gaze vector.

    Args:
        vector: (3,) of any length.
        what: It, for the message.

    Raises:
        ValueError: it has no length, or is not finite.
    """
    length = float(np.linalg.norm(vector))
    if not np.isfinite(length):
        raise ValueError(f"{what} is not finite")
    if length < SHORTEST:
        raise ValueError(f"{what} has no length")
    return np.asarray(vector, dtype=np.float64) / length
