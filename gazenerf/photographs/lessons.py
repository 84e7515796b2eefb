"""The views that a field learns a person from: the photograph, and its teacher from around it at several gazes."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import cv2
import numpy as np
import torch

from gazenerf.data.rasterizer import Rasterizer
from gazenerf.geometry import Camera, Gaze
from gazenerf.head_model.interface import MOUTH, HeadMesh
from gazenerf.photographs.appearance import STANDARD_LIPS, Seen, between_lips, eye_openings, face_oval
from gazenerf.photographs.landmarks import FaceLandmarks
from gazenerf.photographs.teacher import Teacher
from gazenerf.photographs.told_colours import person_mask
from gazenerf.subjects import Codes

SHOWN = 2.8
"""World units that the photograph's square picture shows at the head, about as much as captures do."""

AROUND = (
    (0, 0), (20, -6), (-20, 6), (10, 14), (-10, -14), (38, 8), (-38, -8), (60, 0), (-60, 6), (90, 0), (-90, 0),
    (150, 10), (-150, 5),
)  # fmt: skip
"""Yaw and pitch of the teacher's cameras about the head, degrees from the photograph's."""

HELD_OUT = ((-20, 0), (20, 0))
"""The same of the views that tell when to stop."""

GAZES = ((0, 0), (12, 22), (-12, -22), (-14, 18), (14, -18), (0, 30), (0, -30), (20, 0), (-20, 0))
"""Pitch and yaw of the teacher's eyes, degrees."""

FRONT = 7
"""How many of the first cameras around see both eyes."""

FURTHER = 7
"""How many cameras around, and pictures of eyes, each further photograph of the same person adds at most."""

EYES_WINDOW = (0.375, 0.16)
"""Their width and height, shares of a picture's side."""


EMPHASIS, EMPHASIS_GROWN = 4.0, 0.05
"""How much pixels of a photograph's eyes and open mouth count, which are few and unlike anybody else's, and by how much
these are grown, in distances between the eyes."""

OWN, AROUND_HEAD, EYES = "own", "around", "eyes"
"""Kinds of lessons: the photograph, the teacher's head from all sides, and its eyes alone."""


@dataclass(frozen=True)
class Lesson:
    """A picture that the field should draw.

    Attributes:
        codes: Of the person, in the photograph that it is about.
        camera, gaze: Of the picture.
        image: (3, H, W) float32 sRGB.
        mask: (H, W) float32, how much each pixel counts: 0 where the picture says nothing, 1 otherwise, and
            `EMPHASIS` in the eyes and the open mouth of a photograph.
        kind: `OWN`, `AROUND_HEAD` or `EYES`.
    """

    codes: Codes
    camera: Camera
    gaze: Gaze
    image: torch.Tensor
    mask: torch.Tensor
    kind: str = AROUND_HEAD


def photograph_lesson(seen: Seen, codes: Codes, gaze: Gaze, size: int) -> Lesson:
    """The photograph in a square picture around the head.

    Args:
        seen: The photograph with the fitted head.
        codes, gaze: Fitted.
        size: Of the picture.
    """
    camera = seen.camera
    low, side = _square(seen)
    scale = size / side
    square = replace(
        camera, fx=camera.fx * scale, fy=camera.fy * scale, cx=(camera.cx - low[0]) * scale,
        cy=(camera.cy - low[1]) * scale, width=size, height=size,
    )  # fmt: skip
    shape = seen.image.shape[:2]
    told = (person_mask(seen) | (face_oval(seen.landmarks, shape) & (seen.raster.parts > 0))).astype(np.float32)
    told[_eyes_and_mouth(seen.landmarks, shape)] *= EMPHASIS
    mask = moved_to_square(seen, told, size, cv2.INTER_LINEAR)
    picture = moved_to_square(seen, seen.image, size, cv2.INTER_CUBIC)
    return Lesson(codes, square, gaze, _image(picture), torch.from_numpy(mask), OWN)


def _eyes_and_mouth(landmarks: FaceLandmarks, shape: tuple[int, int]) -> np.ndarray:
    """(H, W) bool: between the lids and between the lips, and their edges."""
    inside = eye_openings(landmarks, shape) | between_lips(landmarks, shape)
    return cv2.dilate(inside.astype(np.uint8), disc(EMPHASIS_GROWN * landmarks.interocular)) > 0


def disc(radius: float) -> np.ndarray:
    """A disc of so many pixels, but at least 1, for OpenCV's morphology."""
    side = 2 * max(1, round(radius)) + 1
    return cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (side, side))


def _square(seen: Seen) -> tuple[np.ndarray, float]:
    """Lower corner (2,) and side, pixels of the photograph, of the square around the head."""
    camera = seen.camera
    middle, _ = camera.project(np.array([0.0, -0.1, 0.0]))
    side = max(1.0, SHOWN * camera.fx / float(np.linalg.norm(camera.position)))
    return middle - 0.5 * side, side


def moved_to_square(seen: Seen, array: np.ndarray, size: int, how: int) -> np.ndarray:
    """What belongs to a photograph's pixels, for those of its square picture; `how` is OpenCV's interpolation."""
    low, side = _square(seen)
    pixel = side / size
    # pixel centres: square u + 0.5 lies at low + (u + 0.5) * pixel of the photograph
    place = np.array([[pixel, 0.0, low[0] + 0.5 * pixel - 0.5], [0.0, pixel, low[1] + 0.5 * pixel - 0.5]])
    return cv2.warpAffine(array, place, (size, size), flags=how | cv2.WARP_INVERSE_MAP)


def teacher_cameras(camera: Camera, size: int, around: tuple[tuple[int, int], ...]) -> list[Camera]:
    """Cameras about the head, degrees of yaw and pitch from where a camera of a photograph is."""
    x, y, z = camera.position
    yaw, pitch = np.arctan2(x, z), np.arctan2(y, np.hypot(x, z))
    found = []
    for more_yaw, more_pitch in np.deg2rad(around):
        height = float(np.clip(pitch + more_pitch, -0.6, 0.6))
        found.append(Camera.orbit(float(yaw + more_yaw), height, size=size))
    return found


def teacher_lesson(
    teacher: Teacher, renderer: Rasterizer, camera: Camera, gaze: Gaze, kind: str = AROUND_HEAD
) -> Lesson:
    """The teacher seen by a camera; on its outline, and between its lips where it has no teeth, it says nothing."""
    mesh = teacher.mesh(gaze)
    raster = teacher.drawn(renderer, camera, mesh)
    inside = cv2.erode((raster.parts > 0).astype(np.float32), np.ones((5, 5), np.uint8), borderValue=0)
    if not len(mesh.part_faces(MOUTH)):
        inside[_open_mouth(mesh, camera)] = 0.0
    return Lesson(teacher.codes, camera, gaze, _image(raster.image), torch.from_numpy(inside), kind)


def _open_mouth(mesh: HeadMesh, camera: Camera) -> np.ndarray:
    """(H, W) bool: between the lips."""
    pixels, _ = camera.project(np.stack([mesh.landmarks[str(i)] for i in STANDARD_LIPS]).astype(np.float64))
    mask = np.zeros((camera.height, camera.width), np.uint8)
    cv2.fillPoly(mask, [np.round(pixels).astype(np.int32)], 1)
    return mask > 0


def eyes_camera(camera: Camera, centre: np.ndarray, size: tuple[int, int]) -> Camera:
    """The window (width, height) of a camera's picture whose middle shows a point (3,)."""
    pixel, _ = camera.project(centre)
    left, top = (int(np.clip(round(at - 0.5 * side), 0, whole - side))
                 for at, side, whole in zip(pixel, size, (camera.width, camera.height), strict=True))  # fmt: skip
    return camera.cropped(left, top, *size)


def _image(pixels: np.ndarray) -> torch.Tensor:
    return torch.from_numpy(np.ascontiguousarray(pixels)).permute(2, 0, 1).float() / 255.0


def teacher_lessons(
    teacher: Teacher, seen: Seen, gaze: Gaze, size: int, step: int, around: int = len(AROUND), eyes: int = 20
) -> Iterator[Lesson]:
    """The teacher from all sides, and its eyes at more gazes.

    Args:
        teacher: Of the person.
        seen, gaze: The photograph with the fitted head.
        size: Of the pictures.
        step: Pixels of a feature pixel.
        around: How many of the cameras around are used.
        eyes: How many pictures show the eyes alone.
    """
    cameras = teacher_cameras(seen.camera, size, AROUND[:around])
    with Rasterizer((size, size)) as renderer:
        for number, camera in enumerate(cameras):
            yield teacher_lesson(teacher, renderer, camera, Gaze.from_degrees(*GAZES[number % len(GAZES)]))
    window = tuple(step * round(share * size / step) for share in EYES_WINDOW)
    centre = teacher.mesh(gaze).eye_centres.mean(axis=0)
    with Rasterizer((window[0], window[1])) as renderer:
        for number in range(eyes):
            camera = eyes_camera(cameras[number % min(FRONT, around)], centre, (window[0], window[1]))
            yield teacher_lesson(teacher, renderer, camera, Gaze.from_degrees(*GAZES[number % len(GAZES)]), EYES)


def held_out_lessons(teacher: Teacher, seen: Seen, size: int) -> Iterator[Lesson]:
    """Views that are only looked at."""
    with Rasterizer((size, size)) as renderer:
        for number, camera in enumerate(teacher_cameras(seen.camera, size, HELD_OUT)):
            yield teacher_lesson(teacher, renderer, camera, Gaze.from_degrees(*((6, -10), (-6, 10))[number]))
