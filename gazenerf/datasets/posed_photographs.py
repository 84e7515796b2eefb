"""Photographs whose camera, head pose and gaze target are published, as the standard camera shows them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from gazenerf.datasets.labels import unit_direction
from gazenerf.datasets.published import Sample
from gazenerf.errors import UserError
from gazenerf.geometry import Camera
from gazenerf.photographs.landmarks import FaceLandmarks
from gazenerf.photographs.normalisation import FACING, SIZE, normalise
from gazenerf.photographs.picture import read_photograph

METRES_PER_MM = 0.001


@dataclass(frozen=True)
class PublishedCamera:
    """A calibrated camera, as OpenCV has it: pixel centres lie at whole numbers.

    Attributes:
        matrix: (3, 3) intrinsics, pixels.
        distortion: (K,) coefficients.
    """

    matrix: np.ndarray
    distortion: np.ndarray


@dataclass(frozen=True)
class HeadPose:
    """A head in a camera, millimetres, OpenCV's axes; the head's are x to the subject's left, y down, z backward.

    Attributes:
        rotation: (3, 3) from the head's axes to the camera's.
        translation: (3,) of the head's origin.
        face_centre: (3,) what the standard camera looks at.
    """

    rotation: np.ndarray
    translation: np.ndarray
    face_centre: np.ndarray

    @classmethod
    def of(cls, vector: np.ndarray, translation: np.ndarray, face_centre: np.ndarray) -> HeadPose:
        """From a rotation vector (3,).

        Raises:
            ValueError: a number is not finite, or the face is not in front of the camera.
        """
        if not (np.isfinite(vector).all() and np.isfinite(translation).all() and np.isfinite(face_centre).all()):
            raise ValueError("its head pose is not a finite number")
        if face_centre[2] < 1.0:
            raise ValueError("its face is not in front of the camera")
        rotation = cv2.Rodrigues(np.asarray(vector, dtype=np.float64).reshape(3, 1))[0]
        return cls(rotation, np.asarray(translation, np.float64), np.asarray(face_centre, np.float64))

    @property
    def turned(self) -> float:
        """Degrees between where the head faces and the camera."""
        cosine = self.rotation[:, 2] @ self.face_centre / np.linalg.norm(self.face_centre)
        return float(np.rad2deg(np.arccos(np.clip(cosine, -1.0, 1.0))))


@dataclass(frozen=True)
class PosedPhotograph:
    """A photograph and its annotation.

    Attributes:
        file: The photograph.
        camera: That took it.
        pose: Of the head.
        origin, target: (3,) millimetres in the camera: the gaze goes from one to the other.
        landmarks: (68, 2) pixels of the photograph with distortion, OpenCV's; None where none are published.
        size: (width, height) that the photograph must have; None where nothing tells.
        upside_down: The photograph is to be turned by half a turn first.
    """

    file: Path
    camera: PublishedCamera
    pose: HeadPose
    origin: np.ndarray
    target: np.ndarray
    landmarks: np.ndarray | None = None
    size: tuple[int, int] | None = None
    upside_down: bool = False


def normalised_sample(photograph: PosedPhotograph, focal: float, size: int = SIZE) -> Sample:
    """The photograph as the standard camera shows it, undistorted, with its gaze in that camera's axes.

    Args:
        photograph: With its annotation.
        focal: Of the standard camera, pixels of a picture of 512.
        size: Side of the picture, pixels.

    Raises:
        UserError: it cannot be read, is of another size, or its annotation is impossible.
    """
    pixels = read_photograph(photograph.file)
    height, width = pixels.shape[:2]
    if photograph.size not in (None, (width, height)):
        raise UserError(f"{photograph.file} is {width}x{height}, its camera was calibrated at {photograph.size}")
    if photograph.upside_down:
        pixels = pixels[::-1, ::-1]
    try:
        return _normalised(photograph, np.ascontiguousarray(pixels), focal, size)
    except (ValueError, OverflowError, cv2.error) as error:
        reason = " ".join(str(error).split())[:120]
        raise UserError(f"{photograph.file} has an impossible annotation ({reason})") from error


def _normalised(photograph: PosedPhotograph, pixels: np.ndarray, focal: float, size: int) -> Sample:
    """The upright photograph as a sample; what raises means that the annotation is impossible."""
    known, pose, (height, width) = photograph.camera, photograph.pose, pixels.shape[:2]
    pixels = cv2.undistort(pixels, known.matrix, known.distortion)
    reached = cv2.undistort(np.full((height, width), 255, np.uint8), known.matrix, known.distortion) == 255
    camera = _camera(known, pose, width, height)
    centre = camera.world_from_camera[:3, :3] @ pose.face_centre + camera.position
    found = normalise(camera, centre, METRES_PER_MM, focal * size / SIZE, size=size)
    gaze = unit_direction(photograph.target - photograph.origin)
    landmarks = None
    if photograph.landmarks is not None:
        straight = cv2.undistortPoints(photograph.landmarks[:, None], known.matrix, known.distortion, P=known.matrix)
        landmarks = FaceLandmarks(found.points(straight[:, 0] + 0.5))
    head, seen = found.camera.camera_from_world[:3, :3], found.warp_labels(reached.astype(np.uint8)) > 0
    return Sample(found.warp(pixels), found.rotation @ gaze, True, found.camera.fx, head, landmarks, seen)


def _camera(known: PublishedCamera, pose: HeadPose, width: int, height: int) -> Camera:
    """The camera, whose world is the head's frame in millimetres."""
    matrix = known.matrix
    world = np.eye(4)
    world[:3, :3] = (pose.rotation @ FACING).T
    world[:3, 3] = -world[:3, :3] @ pose.translation
    fx, fy, cx, cy = (float(v) for v in (matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2]))
    return Camera(fx, fy, cx + 0.5, cy + 0.5, width, height, world)
