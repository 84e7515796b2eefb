"""Data normalisation: pictures of a face from a standard camera (Zhang et al. 2018, "Revisiting data normalization").

The paper's supplement (details of data pre-processing) fixes the distance to the face's centre at 680 mm, the pictures
at 512 x 512 and a focal length for each data set. The standard camera keeps the place of the real one, is turned to the
face's centre, and is rolled so that the head's x axis is level in it. Turning a camera is a homography; scaling the
distance as well only scales the picture about its middle, so the standard camera is an ordinary `Camera`, whose focal
length carries that scale.

World coordinates are the head's frame (docs/conventions.md), so a camera's pose is the head's pose, and the gaze of the
labels is that of the head frame, as the paper has it.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from gazenerf.geometry import Camera, Gaze
from gazenerf.head_model.interface import HeadMesh

DISTANCE_MM = 680.0
SIZE = 512

FOCAL_LENGTHS = {"eth-xgaze": 1600.0, "mpiifacegaze": 1400.0, "columbiagaze": 1600.0, "gazecapture": 1200.0}
"""Pixels at 512 x 512, by data set, as the paper's supplement lists them."""

CENTRE_LANDMARKS = ("36", "39", "42", "45", "48", "54")
"""Corners of the eyes and the mouth, whose mean is the face's centre (Zhang et al. 2017, MPIIFaceGaze)."""

FACING = np.diag([1.0, -1.0, -1.0])
"""A frame like the head's for directions in a camera: x right, y up, z towards the camera. Its own inverse."""


@dataclass(frozen=True)
class Normalisation:
    """A real camera and the standard one beside each other.

    Attributes:
        source: The camera of the photograph; its world is the head's frame.
        camera: The standard camera, at the same place.
        distance: From the camera to the face's centre, world units.
    """

    source: Camera
    camera: Camera
    distance: float

    @property
    def rotation(self) -> np.ndarray:
        """(3, 3) takes directions in the source camera to directions in the standard one."""
        return self.camera.world_from_camera[:3, :3].T @ self.source.world_from_camera[:3, :3]

    @property
    def homography(self) -> np.ndarray:
        """(3, 3) takes homogeneous image points (continuous coordinates) of the source to those of the standard one."""
        return self.camera.intrinsics @ self.rotation @ np.linalg.inv(self.source.intrinsics)

    def points(self, points: np.ndarray) -> np.ndarray:
        """(N, 2) image points of the source as points (N, 2) of the normalised picture, both continuous."""
        return _mapped(self.homography, points)

    def source_points(self, points: np.ndarray) -> np.ndarray:
        """(N, 2) points of the normalised picture as image points (N, 2) of the source."""
        return _mapped(np.linalg.inv(self.homography), points)

    def warp(self, image: np.ndarray) -> np.ndarray:
        """The normalised picture, linearly interpolated; a source at least twice as fine is averaged down first.

        Args:
            image: (H, W) or (H, W, C) of the source camera's size. What lies outside repeats its border.
        """
        step = 1.0 / np.sqrt(abs(np.linalg.det(self.homography)) / self._depth_factor() ** 3)
        if step < 2.0:
            return _warped(image, self.homography, self.camera, cv2.INTER_LINEAR, cv2.BORDER_REPLICATE)
        width, height = round(image.shape[1] / int(step)), round(image.shape[0] / int(step))
        small = cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA)
        scale = np.diag([image.shape[1] / width, image.shape[0] / height, 1.0])
        return _warped(small, self.homography @ scale, self.camera, cv2.INTER_LINEAR, cv2.BORDER_REPLICATE)

    def warp_labels(self, labels: np.ndarray) -> np.ndarray:
        """A mask or label image (H, W) in the normalised picture, nearest pixel; 0 where the source ends."""
        return _warped(labels, self.homography, self.camera, cv2.INTER_NEAREST, cv2.BORDER_CONSTANT)

    def unwarp(self, image: np.ndarray) -> np.ndarray:
        """A normalised picture put back into the source's, linearly interpolated; 0 where it does not reach.

        Args:
            image: (H, W) or (H, W, C) of the standard camera's size.
        """
        return _warped(image, np.linalg.inv(self.homography), self.source, cv2.INTER_LINEAR, cv2.BORDER_CONSTANT)

    def unwarp_labels(self, labels: np.ndarray) -> np.ndarray:
        """A mask or label image (H, W) of the normalised picture in the source's, nearest pixel; 0 elsewhere."""
        return _warped(labels, np.linalg.inv(self.homography), self.source, cv2.INTER_NEAREST, cv2.BORDER_CONSTANT)

    def head_pose(self) -> Gaze:
        """Where the head faces in the standard camera: zero is towards the camera, positive up and to its left."""
        return Gaze.from_vector(FACING @ self.camera.world_from_camera[:3, :3].T @ np.array([0.0, 0.0, 1.0]))

    def gaze_in_head(self, pitch: float, yaw: float) -> Gaze:
        """A label in the standard camera's frame as a gaze in the head's frame.

        Args:
            pitch, yaw: Radians, as `label_direction` takes them.
        """
        return Gaze.from_vector(self.camera.world_from_camera[:3, :3] @ label_direction(pitch, yaw))

    def gaze_in_camera(self, gaze: Gaze) -> tuple[float, float]:
        """Pitch and yaw in radians of `gaze_in_head`'s convention; its inverse."""
        x, y, z = self.camera.world_from_camera[:3, :3].T @ gaze.vector()
        return float(np.arcsin(np.clip(-y, -1.0, 1.0))), float(np.arctan2(-x, -z))

    def _depth_factor(self) -> float:
        """The third homogeneous coordinate of the point of the source that becomes the picture's middle."""
        middle = np.linalg.inv(self.homography) @ np.array([self.camera.cx, self.camera.cy, 1.0])
        return float(1.0 / middle[2])


def label_direction(pitch: np.ndarray | float, yaw: np.ndarray | float) -> np.ndarray:
    """(..., 3) unit vectors in OpenCV's camera axes of labels as Zhang et al. have them.

    Args:
        pitch, yaw: (...) radians: the direction is (-cos(pitch) sin(yaw), -sin(pitch), -cos(pitch) cos(yaw)), so zero
            looks at the camera, a positive pitch up, and a positive yaw to the left of the picture.
    """
    return -np.stack([np.cos(pitch) * np.sin(yaw), np.sin(pitch), np.cos(pitch) * np.cos(yaw)], axis=-1)


def level_head(pitch: float, yaw: float) -> np.ndarray:
    """(3, 3) rotation that takes directions in the head's frame to a standard camera, in which its x axis is level.

    Args:
        pitch, yaw: Radians of where the head faces, with the signs of `label_direction`.
    """
    back = -label_direction(pitch, yaw)
    right = np.array([np.cos(yaw), 0.0, -np.sin(yaw)])
    return np.stack([right, np.cross(back, right), back], axis=1) @ FACING


def normalise(
    camera: Camera,
    centre: np.ndarray,
    metres_per_unit: float,
    focal: float = FOCAL_LENGTHS["eth-xgaze"],
    distance_mm: float = DISTANCE_MM,
    size: int = SIZE,
) -> Normalisation:
    """The standard camera of a photograph.

    Args:
        camera: Of the photograph; its world is the head's frame.
        centre: (3,) of the face, world units (`face_centre`).
        metres_per_unit: Size of a world unit.
        focal: Of the standard camera, pixels of a picture of `size`.
        distance_mm: To which the distance of the face is scaled.
        size: Side of the normalised picture, pixels.

    Raises:
        ValueError: the centre lies at or behind the camera, or the head's x axis points at the camera.
    """
    axes = camera.camera_from_world[:3, :3]
    place = axes @ (np.asarray(centre, dtype=np.float64) - camera.position)
    distance = float(np.linalg.norm(place))
    if place[2] <= 0.0:
        raise ValueError("the face's centre must lie in front of the camera")
    forward = place / distance
    down = np.cross(forward, axes[:, 0])
    if np.linalg.norm(down) < 1e-6:
        raise ValueError("the head's x axis points at the camera, so no roll is level")
    down /= np.linalg.norm(down)
    pose = camera.world_from_camera.copy()
    pose[:3, :3] = pose[:3, :3] @ np.stack([np.cross(down, forward), down, forward], axis=1)
    scaled = focal * distance * metres_per_unit * 1000.0 / distance_mm
    return Normalisation(camera, Camera(scaled, scaled, size / 2.0, size / 2.0, size, size, pose), distance)


def face_centre(mesh: HeadMesh) -> np.ndarray:
    """(3,) mean of the corners of the eyes and the mouth, world units.

    Raises:
        KeyError: the mesh lacks one of the landmarks.
    """
    return np.mean([mesh.landmarks[name] for name in CENTRE_LANDMARKS], axis=0).astype(np.float64)


def _mapped(homography: np.ndarray, points: np.ndarray) -> np.ndarray:
    return cv2.perspectiveTransform(np.asarray(points, dtype=np.float64)[None], homography)[0]


def _warped(image: np.ndarray, homography: np.ndarray, camera: Camera, how: int, border: int) -> np.ndarray:
    """An image moved by a homography of continuous coordinates; OpenCV's pixel centres lie at whole numbers."""
    half = np.array([[1.0, 0.0, 0.5], [0.0, 1.0, 0.5], [0.0, 0.0, 1.0]])
    matrix = np.linalg.inv(half) @ homography @ half
    return cv2.warpPerspective(image, matrix, (camera.width, camera.height), flags=how, borderMode=border)
