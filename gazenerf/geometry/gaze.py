"""Gaze angles and the rotations they stand for.

Head frame: Y up, face toward +Z, +X toward the subject's left, right-handed. A gaze of zero looks
along +Z. Positive pitch looks up, positive yaw looks toward the subject's left. Both eyes share one
gaze (a target at infinity).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Gaze:
    """A gaze direction in the head frame.

    Attributes:
        pitch: Radians, positive up.
        yaw: Radians, positive toward the subject's left.
    """

    pitch: float = 0.0
    yaw: float = 0.0

    @classmethod
    def from_degrees(cls, pitch: float, yaw: float) -> Gaze:
        """A gaze from angles in degrees, as people type them."""
        return cls(float(np.deg2rad(pitch)), float(np.deg2rad(yaw)))

    @classmethod
    def from_vector(cls, vector: np.ndarray) -> Gaze:
        """The gaze that looks along a vector (3,) in the head frame.

        Raises:
            ValueError: the vector is zero or not finite.
        """
        direction = np.asarray(vector, dtype=np.float64)
        norm = float(np.linalg.norm(direction))
        if not np.isfinite(norm) or norm == 0.0:
            raise ValueError(f"a gaze vector must be finite and not zero, got {vector!r}")
        x, y, z = direction / norm
        return cls(float(np.arcsin(np.clip(y, -1.0, 1.0))), float(np.arctan2(x, z)))

    def __repr__(self) -> str:
        pitch, yaw = self.degrees
        return f"Gaze.from_degrees({pitch:g}, {yaw:g})"

    @property
    def degrees(self) -> tuple[float, float]:
        """(pitch, yaw) in degrees."""
        return float(np.rad2deg(self.pitch)), float(np.rad2deg(self.yaw))

    @property
    def label(self) -> np.ndarray:
        """(2,) float32: pitch, yaw in radians, in this convention (a checkpoint may want other signs)."""
        return np.array([self.pitch, self.yaw], dtype=np.float32)

    def vector(self) -> np.ndarray:
        """(3,) float64 unit vector in the head frame."""
        return self.rotation() @ np.array([0.0, 0.0, 1.0])

    def rotation(self) -> np.ndarray:
        """(3, 3) float64 rotation that takes +Z to `vector()` without torsion: Ry(yaw) Rx(-pitch)."""
        return rotation_y(self.yaw) @ rotation_x(-self.pitch)

    def angle_to(self, other: Gaze) -> float:
        """Angle to another gaze, radians (paper Eq. for the angular error)."""
        a, b = self.vector(), other.vector()
        return float(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b))


def outward(elevation: np.ndarray, azimuth: np.ndarray) -> np.ndarray:
    """(..., 3) unit vectors at angles (...) above the horizon and from +Z towards +X, radians."""
    level = np.cos(elevation)
    return np.stack([np.sin(azimuth) * level, np.sin(elevation), np.cos(azimuth) * level], axis=-1)


def rotation_x(angle: float) -> np.ndarray:
    """(3, 3) right-handed rotation about X by an angle in radians."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])


def rotation_y(angle: float) -> np.ndarray:
    """(3, 3) right-handed rotation about Y by an angle in radians."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])
