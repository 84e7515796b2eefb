"""Irises found in the pixels of a photograph, on the eyeballs of a fitted head."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from gazenerf.evaluation.iris import IrisFit, fit_iris
from gazenerf.geometry import Camera
from gazenerf.head_model.eyes import IRIS_ANGLE
from gazenerf.head_model.interface import EYE_LEFT, EYE_RIGHT, HeadMesh
from gazenerf.photographs.eyeball import Eyeball
from gazenerf.photographs.landmarks import FaceLandmarks
from gazenerf.photographs.lid_motion import shown_part
from gazenerf.photographs.openings import seen_opening, soft_opening
from gazenerf.photographs.picture_terms import MM_PER_UNIT, IrisPoints

LIDS_LEFT = (263, 466, 388, 387, 386, 385, 384, 398, 362, 382, 381, 380, 374, 373, 390, 249)
LIDS_RIGHT = (33, 246, 161, 160, 159, 158, 157, 173, 133, 155, 154, 153, 145, 144, 163, 7)
"""MediaPipe's outlines of the openings of the subject's left and right eye."""

STANDARD_LIDS = (42, 43, 44, 45, 46, 47), (36, 37, 38, 39, 40, 41)

SPREAD_MM = 0.5
"""Standard deviation of an iris found in pixels, on each axis."""

LARGEST_INTEROCULAR = 200.0
"""Pixels: larger eyes are averaged down to this before they are searched."""

AWAY_MM = 3.0
"""An iris farther from the detected one is something else: the shadow of a lid, a corner of the eye."""

RIM = 0.014
"""Distances between the eyes: the breadth of the lids' shadow and lashes along an opening, which may hide that what is
left of it is an iris."""

CLOSED = 0.12
"""An eye whose opening is less high than this share of its width counts as closed; open ones have 0.25 to 0.4."""


def lid_landmarks(dense: bool) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Numbers of the landmarks around the openings of the left and right eye, of 478 or of 68."""
    return (LIDS_LEFT, LIDS_RIGHT) if dense else STANDARD_LIDS


def lids(landmarks: FaceLandmarks) -> tuple[np.ndarray, np.ndarray]:
    """Outlines (N, 2) of the openings of the subject's left and right eye, pixels."""
    left, right = lid_landmarks(landmarks.dense)
    return landmarks.points[list(left)], landmarks.points[list(right)]


def openness(landmarks: FaceLandmarks) -> tuple[float, float]:
    """Height of the openings of the left and right eye as a share of their widths."""
    axes = landmarks.eye_axes
    left, right = (np.ptp(outline @ axes.T, axis=0) for outline in lids(landmarks))
    return float(left[1] / max(left[0], 1e-9)), float(right[1] / max(right[0], 1e-9))


@dataclass(frozen=True)
class SeenEyes:
    """What the pixels tell of two eyes, the subject's left first.

    Attributes:
        irises: None where neither eye shows one.
        moves: (2, 2) pixels from the centre of the fitted opening to that of the one that is seen; NaN where the pixels
            do not tell.
    """

    irises: IrisPoints | None
    moves: np.ndarray


def find_eyes(
    image: np.ndarray,
    landmarks: FaceLandmarks,
    camera: Camera,
    centres: np.ndarray,
    radius: float,
    mesh: HeadMesh | None = None,
) -> SeenEyes:
    """The openings of the eyes in a photograph, and the irises in them, dark discs on the fitted eyeballs.

    Args:
        image: (H, W, 3) uint8 sRGB.
        landmarks: Tell where the lids are.
        camera: Of the fitted head.
        centres: (2, 3) of the eyeballs, the subject's left first, world units.
        radius: Of the eyeballs, world units.
        mesh: The fitted head, with which the openings are found in the pixels; the landmarks' outlines count without.
    """
    outlines = lids(landmarks)
    window, view = _window(image, np.concatenate(outlines), camera, landmarks.interocular)
    scale = np.array([view.fx / camera.fx, view.fy / camera.fy])
    corner = np.array([camera.cx, camera.cy]) - np.array([view.cx, view.cy]) / scale
    found, moves = np.full((2, 2), np.nan), np.full((2, 2), np.nan)
    for eye, outline in enumerate(outlines):
        if openness(landmarks)[eye] < CLOSED:
            continue
        unit, mask = landmarks.interocular * scale[0], np.zeros(window.shape[:2], np.uint8)
        inside = np.round(((outline - corner) * scale - 0.5) * 16.0).astype(np.int32)
        cv2.fillPoly(mask, [inside], 1, lineType=cv2.LINE_8, shift=4)
        opening = mask > 0
        if mesh is not None:
            shown = shown_part(mesh, view, (EYE_LEFT, EYE_RIGHT)[eye])
            by_pixels = seen_opening(window, shown, opening, unit)
            opening = (soft_opening(opening, unit) if by_pixels is None else by_pixels) > 0.5
            if by_pixels is not None and shown.any() and opening.any():
                moves[eye] = (_centre(opening) - _centre(shown)) / scale
        fit = _iris_in(window / 255.0, opening, view, Eyeball(centres[eye], radius), unit)
        if fit is not None:
            found[eye] = camera.project(centres[eye] + np.cos(IRIS_ANGLE) * radius * fit.direction)[0]
    if landmarks.irises is not None:
        _, z = camera.project(centres)
        away = np.linalg.norm(found - landmarks.irises, axis=1) * z / camera.fx * MM_PER_UNIT
        found[away > AWAY_MM] = np.nan
    irises = IrisPoints(found, SPREAD_MM, float(np.cos(IRIS_ANGLE))) if np.isfinite(found).any() else None
    return SeenEyes(irises, moves)


def _centre(mask: np.ndarray) -> np.ndarray:
    """(2,) mean pixel of a mask."""
    return np.argwhere(mask)[:, ::-1].mean(axis=0)


def _window(image: np.ndarray, points: np.ndarray, camera: Camera, interocular: float) -> tuple[np.ndarray, Camera]:
    """The part of a picture around points (N, 2), not larger than is of use, and its camera."""
    height, width = image.shape[:2]
    low = np.clip(np.floor(points.min(axis=0) - 8).astype(int), 0, [width - 2, height - 2])
    high = np.clip(np.ceil(points.max(axis=0) + 8).astype(int), low + 2, [width, height])
    view = camera.cropped(int(low[0]), int(low[1]), int(high[0] - low[0]), int(high[1] - low[1]))
    part, factor = image[low[1] : high[1], low[0] : high[0]], LARGEST_INTEROCULAR / interocular
    if factor >= 1.0:
        return part, view
    size = max(2, round(view.width * factor)), max(2, round(view.height * factor))
    return cv2.resize(part, size, interpolation=cv2.INTER_AREA), view.resized(*size)


def find_iris(image: np.ndarray, opening: np.ndarray, camera: Camera, eyeball: Eyeball, unit: float) -> IrisFit | None:
    """The iris of one eye, searched in a picture that is no larger than is of use.

    Args:
        image: (H, W, 3) sRGB in [0, 1].
        opening: (H, W) share of each pixel between the lids.
        camera: Of the picture.
        eyeball: Of the fitted head.
        unit: Distance between the eyes, pixels.

    Returns:
        None where the opening shows none.
    """
    factor = min(1.0, LARGEST_INTEROCULAR / unit)
    size = max(2, round(camera.width * factor)), max(2, round(camera.height * factor))
    if factor < 1.0:
        image, opening = (cv2.resize(part, size, interpolation=cv2.INTER_AREA) for part in (image, opening))
    return _iris_in(image, opening > 0.5, camera.resized(*size), eyeball, factor * unit)


def _iris_in(image: np.ndarray, opening: np.ndarray, camera: Camera, eyeball: Eyeball, unit: float) -> IrisFit | None:
    """The iris in an opening (H, W) bool, or else in the opening less its rim; other arguments as of `find_iris`."""
    found = fit_iris(image, opening, camera, eyeball.centre, eyeball.radius)
    if found is not None:
        return found
    rim = max(1, round(RIM * unit))
    inner = cv2.erode(opening.astype(np.uint8), np.ones((2 * rim + 1, 2 * rim + 1), np.uint8)) > 0
    return fit_iris(image, inner, camera, eyeball.centre, eyeball.radius)
