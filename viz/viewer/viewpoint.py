"""A visitor's camera as the browser reports it, and the camera of the picture that fills the page."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from gazenerf.geometry import Camera


@dataclass(frozen=True)
class Viewpoint:
    """Where a visitor looks from.

    The world is this project's: the page is told that Y is up, so nothing has to be turned. Camera axes are OpenCV's.

    Attributes:
        wxyz: Unit quaternion of the camera's rotation in the world, real part first.
        position: Centre of projection, world units.
        fov: Vertical field of view, radians.
        width, height: Of the page's canvas, pixels.
    """

    wxyz: tuple[float, float, float, float]
    position: tuple[float, float, float]
    fov: float
    width: int
    height: int

    def __post_init__(self) -> None:
        """Raise ValueError for what no camera has."""
        if not np.isfinite([*self.wxyz, *self.position, self.fov]).all() or np.linalg.norm(self.wxyz) < 1e-6:
            raise ValueError("a viewpoint must be finite")
        if self.width < 1 or self.height < 1 or not 0.0 < self.fov < np.pi:
            raise ValueError(f"no camera has {self.width}x{self.height} pixels and a field of view of {self.fov}")

    @property
    def world_from_camera(self) -> np.ndarray:
        """(4, 4) float64 pose, OpenCV camera axes."""
        pose = np.eye(4)
        pose[:3, :3] = Rotation.from_quat(self.wxyz, scalar_first=True).as_matrix()
        pose[:3, 3] = self.position
        return pose

    def camera(self, shorter: int, multiple: int = 1) -> Camera:
        """The camera of a picture that, stretched over the canvas, covers it exactly.

        Args:
            shorter: Wanted shorter side, pixels. A canvas more than four times as long as wide gets less.
            multiple: Both sides are rounded to multiples of it; pixels are then not quite square.
        """
        sides = np.array([self.width, self.height], dtype=np.float64)
        scale = min(shorter / sides.min(), LONGEST * shorter / sides.max())
        width, height = (max(1, round(float(side) * scale / multiple)) * multiple for side in sides)
        tangent = float(np.tan(0.5 * self.fov))
        fy = 0.5 * height / tangent
        fx = 0.5 * width / (tangent * self.width / self.height)
        return Camera(fx, fy, width / 2.0, height / 2.0, width, height, self.world_from_camera)


LONGEST = 4.0
"""The longer side of a picture is at most this many times the wanted shorter one."""
