"""Photographs of people that do not exist, with everything known about them, as a data set's camera would take them."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from gazenerf.data.rasterizer import Rasterizer
from gazenerf.geometry import Camera, Gaze
from gazenerf.head_model import ParametricHead
from gazenerf.head_model.interface import HeadMesh
from gazenerf.head_model.sampling import sample_person
from gazenerf.subjects import Codes

MM = 100.0
"""Millimetres in a world unit."""

GAZE_DEGREES, TURN_DEGREES = (18.0, 25.0), (12.0, 25.0)
"""Pitch and yaw, to each side."""

TARGET_MM = 500.0


@dataclass(frozen=True)
class TruePicture:
    """One photograph of a person that does not exist, with everything known about it.

    Attributes:
        codes, gaze, mesh: The person; head frame.
        camera: Of the photograph.
    """

    codes: Codes
    gaze: Gaze
    mesh: HeadMesh
    camera: Camera

    @property
    def rotation(self) -> np.ndarray:
        """(3, 3) head pose as data sets have it: head axes x to the subject's left, y down, z out of the back."""
        return self.camera.camera_from_world[:3, :3] @ np.diag([1.0, -1.0, -1.0])

    @property
    def translation(self) -> np.ndarray:
        """(3,) millimetres, of the head's origin in the camera."""
        return self.camera.camera_from_world[:3, 3] * MM

    def in_camera(self, points: np.ndarray) -> np.ndarray:
        """(..., 3) millimetres in the camera of points in the head's frame."""
        pose = self.camera.camera_from_world
        return (points @ pose[:3, :3].T + pose[:3, 3]) * MM

    @property
    def face_centre(self) -> np.ndarray:
        """(3,) millimetres in the camera: the mean of eye and mouth corners."""
        corners = [self.mesh.landmarks[name] for name in ("36", "39", "42", "45", "48", "54")]
        return self.in_camera(np.mean(corners, axis=0).astype(np.float64))

    @property
    def target(self) -> np.ndarray:
        """(3,) millimetres in the camera: a point that the gaze from the face's centre meets."""
        return self.face_centre + TARGET_MM * (self.camera.camera_from_world[:3, :3] @ self.gaze.vector())

    def landmarks(self, camera: Camera, model: ParametricHead) -> np.ndarray:
        """(68, 2) the standard landmarks in a camera, continuous pixels."""
        return camera.project(self.mesh.vertices[model.landmark_vertices].astype(np.float64))[0]

    def standard(self, focal: float, distance_mm: float, size: int) -> tuple[np.ndarray, Camera]:
        """Rotation (3, 3) to the axes of a standard camera (Zhang et al. 2018), and that camera at the same place."""
        away = float(np.linalg.norm(self.face_centre))
        ahead = self.face_centre / away
        down = np.cross(ahead, self.rotation[:, 0])
        down /= np.linalg.norm(down)
        turn = np.stack([np.cross(down, ahead), down, ahead])
        pose = self.camera.world_from_camera.copy()
        pose[:3, :3] = pose[:3, :3] @ turn.T
        seen = focal * away / distance_mm
        return turn, Camera(seen, seen, size / 2, size / 2, size, size, pose)


def true_pictures(model: ParametricHead, person: int, count: int, size: int) -> list[TruePicture]:
    """Pictures of one person from random places; the same arguments give the same pictures."""
    rng = np.random.default_rng((77, person))
    who, found = sample_person(rng, model), []
    for _ in range(count):
        pitch, yaw = (rng.uniform(-limit, limit) for limit in GAZE_DEGREES)
        gaze = Gaze.from_degrees(float(pitch), float(yaw))
        down, side = (float(np.deg2rad(rng.uniform(-limit, limit))) for limit in TURN_DEGREES)
        distance = float(rng.uniform(7.0, 10.0))
        aside = tuple(float(v) for v in rng.uniform(-0.3, 0.3, 3))
        camera = Camera.orbit(side, down, distance=distance, size=size, fov=0.5, target=(aside[0], aside[1], aside[2]))
        found.append(TruePicture(who, gaze, model.mesh(who, gaze), camera))
    return found


def drawn(picture: TruePicture, camera: Camera, rasterizer: Rasterizer) -> np.ndarray:
    """(H, W, 3) uint8: a picture before a plain wall."""
    raster = rasterizer.render_lit(picture.mesh, picture.codes.illumination, camera)
    return np.where(raster.parts[..., None] == 0, np.array([96, 110, 120], np.uint8), raster.image).astype(np.uint8)


def distorted(image: np.ndarray, matrix: np.ndarray, coefficients: np.ndarray) -> np.ndarray:
    """A picture as a lens with OpenCV's distortion coefficients would have taken it, of the same size."""
    height, width = image.shape[:2]
    places = np.stack(np.meshgrid(np.arange(width), np.arange(height)), axis=-1).reshape(-1, 1, 2).astype(np.float64)
    straight = cv2.undistortPoints(places, matrix, coefficients, P=matrix).reshape(height, width, 2)
    x, y = np.moveaxis(straight.astype(np.float32), -1, 0)
    return cv2.remap(image, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
