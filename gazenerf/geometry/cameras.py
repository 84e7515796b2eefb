"""Pinhole cameras, their rays, and the axes other programs use.

World: right-handed, Y up, face toward +Z, +X toward the subject's left; one unit is
`metres_per_unit` metres (0.1 for the bundled head). Camera axes are OpenCV's: x right, y down,
z forward. Image coordinates are continuous: pixel (column i, row j) covers [i, i+1) x [j, j+1), its
centre is (i + 0.5, j + 0.5), and a centred camera has cx = width / 2.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch

OPENGL_FROM_OPENCV = np.diag([1.0, -1.0, -1.0, 1.0])
"""Camera axes: OpenGL (x right, y up, z backward) from OpenCV. Its own inverse."""

MITSUBA_FROM_OPENCV = np.diag([-1.0, -1.0, 1.0, 1.0])
"""Camera axes: Mitsuba (x left, y up, z forward) from OpenCV. Its own inverse."""

NEUTRAL_DISTANCE = 12.0
"""World units from the origin to the neutral camera."""

NEUTRAL_FOV = float(np.deg2rad(14.2))
"""Field of view of the neutral camera, radians."""


@dataclass(frozen=True)
class Camera:
    """A pinhole camera.

    Attributes:
        fx, fy: Focal lengths in pixels.
        cx, cy: Principal point in continuous image coordinates.
        width, height: Image size in pixels.
        world_from_camera: (4, 4) float64 rigid transform, OpenCV camera axes, world units.
    """

    fx: float
    fy: float
    cx: float
    cy: float
    width: int
    height: int
    world_from_camera: np.ndarray

    def __post_init__(self) -> None:
        pose = np.asarray(self.world_from_camera, dtype=np.float64)
        if pose.shape != (4, 4) or not np.isfinite(pose).all():
            raise ValueError(f"world_from_camera must be a finite (4, 4) matrix, got shape {pose.shape}")
        rotation = pose[:3, :3]
        if not np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-4) or np.linalg.det(rotation) < 0:
            raise ValueError("world_from_camera must hold a right-handed rotation")
        if self.width < 1 or self.height < 1 or not (self.fx > 0 and self.fy > 0):
            raise ValueError(f"bad camera: {self.width}x{self.height}, fx={self.fx}, fy={self.fy}")
        object.__setattr__(self, "world_from_camera", pose)

    @classmethod
    def look_at(
        cls,
        position: np.ndarray,
        target: np.ndarray | tuple[float, float, float] = (0.0, 0.0, 0.0),
        *,
        size: int | tuple[int, int] = 256,
        fov: float = NEUTRAL_FOV,
        up: tuple[float, float, float] = (0.0, 1.0, 0.0),
    ) -> Camera:
        """A centred camera at `position` looking at `target` (world units).

        Args:
            size: Image size, one number or (width, height).
            fov: Horizontal field of view, radians.
            up: World direction that points up in the image.

        Raises:
            ValueError: position and target coincide, or the view direction is parallel to `up`.
        """
        width, height = (size, size) if isinstance(size, int) else size
        eye = np.asarray(position, dtype=np.float64)
        forward = np.asarray(target, dtype=np.float64) - eye
        distance = np.linalg.norm(forward)
        if distance < 1e-9:
            raise ValueError("camera position and target coincide")
        forward = forward / distance
        right = np.cross(forward, np.asarray(up, dtype=np.float64))
        if np.linalg.norm(right) < 1e-6:
            raise ValueError("the view direction is parallel to the up vector")
        right = right / np.linalg.norm(right)
        pose = np.eye(4)
        pose[:3, :3] = np.stack([right, np.cross(forward, right), forward], axis=1)
        pose[:3, 3] = eye
        focal = 0.5 * width / np.tan(0.5 * fov)
        return cls(float(focal), float(focal), width / 2.0, height / 2.0, width, height, pose)

    @classmethod
    def orbit(
        cls,
        yaw: float,
        pitch: float = 0.0,
        *,
        distance: float = NEUTRAL_DISTANCE,
        size: int | tuple[int, int] = 256,
        fov: float = NEUTRAL_FOV,
        target: tuple[float, float, float] = (0.0, 0.0, 0.0),
    ) -> Camera:
        """A camera on a sphere about `target`: zero looks the face straight on.

        Args:
            yaw: Radians, positive moves the camera toward the subject's left (+X).
            pitch: Radians, positive moves the camera up.
        """
        direction = np.array([np.sin(yaw) * np.cos(pitch), np.sin(pitch), np.cos(yaw) * np.cos(pitch)])
        return cls.look_at(np.asarray(target) + distance * direction, target, size=size, fov=fov)

    @classmethod
    def neutral(cls, size: int | tuple[int, int] = 256) -> Camera:
        """The published neutral camera: at (0, 0, 12) with rotation diag(1, -1, -1)."""
        return cls.orbit(0.0, 0.0, size=size)

    def __repr__(self) -> str:
        x, y, z = self.position
        fov = np.rad2deg(2.0 * np.arctan(0.5 * self.width / self.fx))
        return f"Camera({self.width}x{self.height}, at {x:.2f} {y:.2f} {z:.2f}, {fov:.1f} degrees wide)"

    @property
    def position(self) -> np.ndarray:
        """(3,) centre of projection in world units."""
        return self.world_from_camera[:3, 3].copy()

    @property
    def intrinsics(self) -> np.ndarray:
        """(3, 3) matrix K in pixels, continuous image coordinates."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])

    @property
    def camera_from_world(self) -> np.ndarray:
        """(4, 4) inverse pose."""
        return np.linalg.inv(self.world_from_camera)

    @property
    def world_from_opengl_camera(self) -> np.ndarray:
        """(4, 4) pose with OpenGL camera axes (pyrender, nerfstudio transforms.json)."""
        return self.world_from_camera @ OPENGL_FROM_OPENCV

    @property
    def world_from_mitsuba_camera(self) -> np.ndarray:
        """(4, 4) pose with Mitsuba camera axes (the sensor's `to_world`)."""
        return self.world_from_camera @ MITSUBA_FROM_OPENCV

    @classmethod
    def from_opengl(
        cls, intrinsics: np.ndarray, world_from_opengl_camera: np.ndarray, width: int, height: int
    ) -> Camera:
        """A camera from K (3, 3) and a pose (4, 4) with OpenGL camera axes."""
        k = np.asarray(intrinsics, dtype=np.float64)
        pose = np.asarray(world_from_opengl_camera, dtype=np.float64) @ OPENGL_FROM_OPENCV
        return cls(float(k[0, 0]), float(k[1, 1]), float(k[0, 2]), float(k[1, 2]), width, height, pose)

    @classmethod
    def from_mitsuba(
        cls, intrinsics: np.ndarray, world_from_mitsuba_camera: np.ndarray, width: int, height: int
    ) -> Camera:
        """A camera from K (3, 3) and a pose (4, 4) with Mitsuba camera axes."""
        k = np.asarray(intrinsics, dtype=np.float64)
        pose = np.asarray(world_from_mitsuba_camera, dtype=np.float64) @ MITSUBA_FROM_OPENCV
        return cls(float(k[0, 0]), float(k[1, 1]), float(k[0, 2]), float(k[1, 2]), width, height, pose)

    def resized(self, width: int, height: int | None = None) -> Camera:
        """The same view at another resolution (continuous coordinates scale, no half-pixel shift)."""
        height = width if height is None else height
        sx, sy = width / self.width, height / self.height
        return replace(
            self, fx=self.fx * sx, fy=self.fy * sy, cx=self.cx * sx, cy=self.cy * sy, width=width, height=height
        )

    def cropped(self, left: int, top: int, width: int, height: int) -> Camera:
        """The camera of a window of the picture whose upper left pixel is (left, top)."""
        return replace(self, cx=self.cx - left, cy=self.cy - top, width=width, height=height)

    def part_between(self, low: np.ndarray, high: np.ndarray) -> tuple[int, int, Camera] | None:
        """Left, top and camera of the pixels between image coordinates (2,), as far as they are in the picture; None
        where none are."""
        low = np.maximum(np.floor(low).astype(int), 0)
        high = np.minimum(np.ceil(high).astype(int), [self.width, self.height])
        if (high <= low).any():
            return None
        left, top = int(low[0]), int(low[1])
        return left, top, self.cropped(left, top, int(high[0]) - left, int(high[1]) - top)

    def windowed(self, window: tuple[slice, slice]) -> Camera:
        """The camera of some rows and columns of the picture."""
        rows, columns = window
        return self.cropped(columns.start, rows.start, columns.stop - columns.start, rows.stop - rows.start)

    def project(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """World points (..., 3) to image coordinates (..., 2) and camera z (...,), world units."""
        pose = self.camera_from_world
        camera_points = points @ pose[:3, :3].T + pose[:3, 3]
        z = camera_points[..., 2]
        safe = np.where(np.abs(z) < 1e-12, 1e-12, z)
        u = self.fx * camera_points[..., 0] / safe + self.cx
        v = self.fy * camera_points[..., 1] / safe + self.cy
        return np.stack([u, v], axis=-1), z

    def pixel_centres(self) -> np.ndarray:
        """(H, W, 2) float64 image coordinates of the pixel centres, x first."""
        u, v = np.meshgrid(np.arange(self.width) + 0.5, np.arange(self.height) + 0.5)
        return np.stack([u, v], axis=-1)

    def unproject(self, depth: np.ndarray, pixels: np.ndarray | None = None) -> np.ndarray:
        """World points (..., 3) at Euclidean distances from the camera's centre, NaN where the distance is.

        Args:
            depth: (H, W) world units along the rays through the pixel centres, or (...) along those of `pixels`.
            pixels: (..., 2) image coordinates; the pixel centres by default.
        """
        rays_o, rays_d = self.rays(pixels)
        return rays_o + depth[..., None] * rays_d

    def rays(self, pixels: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Rays through image coordinates.

        Args:
            pixels: (..., 2) continuous image coordinates; all pixel centres (H, W, 2) by default.

        Returns:
            rays_o (..., 3) and unit rays_d (..., 3), float64, world frame. Multiply a distance
            along rays_d by `ray_z` to get camera z.
        """
        pixels = self.pixel_centres() if pixels is None else np.asarray(pixels, dtype=np.float64)
        directions = np.stack(
            [(pixels[..., 0] - self.cx) / self.fx, (pixels[..., 1] - self.cy) / self.fy, np.ones(pixels.shape[:-1])],
            axis=-1,
        )
        directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
        rays_d = directions @ self.world_from_camera[:3, :3].T
        return np.broadcast_to(self.position, rays_d.shape).copy(), rays_d

    def ray_z(self) -> np.ndarray:
        """(H, W) camera z per unit of Euclidean distance along each pixel's ray."""
        pixels = self.pixel_centres()
        x, y = (pixels[..., 0] - self.cx) / self.fx, (pixels[..., 1] - self.cy) / self.fy
        return 1.0 / np.sqrt(1.0 + x * x + y * y)

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers for JSON."""
        return {
            "fx": self.fx,
            "fy": self.fy,
            "cx": self.cx,
            "cy": self.cy,
            "width": self.width,
            "height": self.height,
            "world_from_camera": self.world_from_camera.tolist(),
        }

    @classmethod
    def from_dict(cls, data: dict[str, Any]) -> Camera:
        """Read what `to_dict` wrote.

        Raises:
            ValueError: a key is missing or a value is not a number.
        """
        try:
            return cls(
                float(data["fx"]),
                float(data["fy"]),
                float(data["cx"]),
                float(data["cy"]),
                int(data["width"]),
                int(data["height"]),
                np.asarray(data["world_from_camera"], dtype=np.float64),
            )
        except (KeyError, TypeError) as error:
            raise ValueError(f"not a camera: {error}") from error


def camera_rays(
    camera: Camera, pixels: np.ndarray | None = None, device: torch.device | str = "cpu"
) -> tuple[torch.Tensor, torch.Tensor]:
    """`Camera.rays` flattened to float32 tensors on a device: rays_o (N, 3), rays_d (N, 3), x fastest."""
    rays_o, rays_d = camera.rays(pixels)
    return (
        torch.from_numpy(rays_o.reshape(-1, 3).astype(np.float32)).to(device),
        torch.from_numpy(rays_d.reshape(-1, 3).astype(np.float32)).to(device),
    )
