"""Options of cameras: size and lens of one, and the path of many."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gazenerf.errors import UserError
from gazenerf.geometry.cameras import Camera
from gazenerf.geometry.keyframes import keyframe_path, read_keyframes
from gazenerf.geometry.paths import CAMERA_PATHS, PUBLISHED_FRAMES, camera_path
from gazenerf.options import option

CAMERA = "camera (degrees and world units)"
LARGEST = 8192
"""Pixels; the largest side of a picture."""


@dataclass(frozen=True, kw_only=True)
class CameraOptions:
    """Size and lens of a camera about the origin.

    Attributes:
        size: Width and height of a picture, pixels.
        distance: From the origin, world units.
        fov: Field of view, degrees.
    """

    size: int = option(512, "width and height of a picture (default: 512)", metavar="PX", group=CAMERA)
    distance: float = option(12.0, "from the origin (default: 12)", metavar="UNITS", group=CAMERA)
    fov: float = option(14.2, "field of view (default: 14.2)", metavar="DEG", group=CAMERA)

    def check_camera(self) -> None:
        """Raise UserError for a size, distance or field of view that no camera has."""
        if self.size < 1:
            raise UserError(f"--size must be at least 1, got {self.size}")
        if self.size > LARGEST:
            raise UserError(f"--size goes up to {LARGEST}, got {self.size}")
        if not 0.0 < self.fov < 180.0:
            raise UserError(f"--fov goes from 0 to 180 degrees, got {self.fov:g}")
        if not (np.isfinite(self.distance) and self.distance > 0.0):
            raise UserError(f"--distance must be above 0, got {self.distance:g}")

    def orbiting(self, yaw: float, pitch: float) -> Camera:
        """A camera on the sphere about the origin, angles in degrees.

        Raises:
            UserError: it stands above or below the head.
        """
        try:
            return Camera.orbit(
                float(np.deg2rad(yaw)),
                float(np.deg2rad(pitch)),
                distance=self.distance,
                size=self.size,
                fov=float(np.deg2rad(self.fov)),
            )
        except ValueError as error:
            raise UserError(f"cannot place the camera: {error}; change --pitch") from error


@dataclass(frozen=True, kw_only=True)
class CameraPathOptions(CameraOptions):
    """A path of cameras.

    Attributes:
        camera_path: A name of `CAMERA_PATHS`, or a .json file of keyframes.
        frames: Number of frames; 90 by default, 45 for circle.
        sweep: Largest yaw of horizontal (60) and figure-eight (45), degrees.
        yaw: Direction of still and dolly, degrees.
        pitch: Height of the path, degrees; of figure-eight the largest (15).
    """

    camera_path: str = option(
        "horizontal",
        f"{', '.join(CAMERA_PATHS)}, or a .json file of keyframes (default: horizontal)",
        metavar="NAME",
        group=CAMERA,
    )
    frames: int | None = option(None, "number of frames (default: 90; 45 for circle)", metavar="N", group=CAMERA)
    sweep: float | None = option(
        None, "largest yaw of horizontal (60) and figure-eight (45)", metavar="DEG", group=CAMERA
    )
    yaw: float = option(0.0, "direction of still and dolly", metavar="DEG", group=CAMERA)
    pitch: float | None = option(
        None, "height of the path; of figure-eight the largest (15)", metavar="DEG", group=CAMERA
    )

    def cameras(self) -> list[Camera]:
        """The camera of every frame.

        Raises:
            UserError: options that make no camera.
        """
        self.check_camera()
        if not np.isfinite([self.yaw, self.pitch or 0.0, self.sweep or 0.0]).all():
            raise UserError("angles must be finite numbers of degrees")
        frames = self.frames
        if frames is None:
            frames = PUBLISHED_FRAMES if self.camera_path == "circle" else 90
        fov = float(np.deg2rad(self.fov))
        if self.camera_path.lower().endswith(".json"):
            keys, loop = read_keyframes(self.camera_path, fov)
            return keyframe_path(keys, frames, loop=loop, size=self.size)
        return camera_path(
            self.camera_path,
            frames,
            size=self.size,
            fov=fov,
            distance=self.distance,
            sweep=None if self.sweep is None else float(np.deg2rad(self.sweep)),
            yaw=float(np.deg2rad(self.yaw)),
            pitch=None if self.pitch is None else float(np.deg2rad(self.pitch)),
        )
