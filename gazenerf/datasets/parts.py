"""Which part of the head each pixel of a real picture shows."""

from __future__ import annotations

import cv2
import numpy as np

from gazenerf.data.rasterizer import Raster
from gazenerf.geometry import Camera
from gazenerf.head_model.interface import EYE_LEFT, EYE_RIGHT, HeadMesh
from gazenerf.photographs.appearance import above_chin
from gazenerf.photographs.irises import lids
from gazenerf.photographs.landmarks import FaceLandmarks

HEAD_LABELS = (*range(1, 14), 17, 18)
"""Labels of CelebAMask-HQ's face parsers that show the head: skin to lips with glasses, ears and earrings, hair and
hat; not neck, necklace and clothes."""

EYE_LABELS = (4, 5)

HAIR_MM = 60.0
"""How far hair may reach beyond the fitted head."""

NEAR_EYE_MM = 6.0
"""How far an opening between the lids may lie beside the fitted eyeball."""


def head_parts(
    raster: Raster,
    mesh: HeadMesh,
    camera: Camera,
    landmarks: FaceLandmarks,
    person: np.ndarray | None = None,
    labels: np.ndarray | None = None,
) -> np.ndarray:
    """(H, W) uint8 as `Capture.parts`: 0 background, 1 face and hair, 2 the subject's left eye, 3 the right one.

    The head is what a face parser calls so; else what shows the person within `HAIR_MM` of the fitted head and not
    below its chin; else the fitted head. Eyes are what a face parser calls so, else the openings between the lids by
    the landmarks, near the fitted eyeballs.

    Args:
        raster, mesh, camera: The fitted head, drawn.
        landmarks: Pixels of the same picture.
        person: (H, W) bool, where the picture shows the person.
        labels: (H, W) uint8 of a face parser.
    """
    pixels_per_mm = _pixels_per_mm(mesh, camera)
    head = _head(raster, mesh, camera, pixels_per_mm, person, labels)
    parts = head.astype(np.uint8)
    for side, outline in zip((EYE_LEFT + 1, EYE_RIGHT + 1), lids(landmarks), strict=True):
        shown = raster.parts == side
        near = _grown(shown, NEAR_EYE_MM * pixels_per_mm)
        if labels is not None:
            opening = np.isin(labels, EYE_LABELS)
        else:
            opening = np.zeros(head.shape, np.uint8)
            cv2.fillPoly(opening, [np.round(outline - 0.5).astype(np.int32)], 1)
        parts[(opening > 0) & near & head] = side
    return parts


def _head(
    raster: Raster,
    mesh: HeadMesh,
    camera: Camera,
    pixels_per_mm: float,
    person: np.ndarray | None,
    labels: np.ndarray | None,
) -> np.ndarray:
    if labels is not None:
        return np.isin(labels, HEAD_LABELS)
    drawn = raster.parts > 0
    if person is None:
        return drawn
    return person & (drawn | (_grown(drawn, HAIR_MM * pixels_per_mm) & above_chin(mesh, camera)))


def _pixels_per_mm(mesh: HeadMesh, camera: Camera) -> float:
    _, z = camera.project(mesh.eye_centres.mean(axis=0).astype(np.float64))
    return camera.fx / float(z) / (1000.0 * mesh.metres_per_unit)


def _grown(mask: np.ndarray, pixels: float) -> np.ndarray:
    if not mask.any():
        return mask
    return cv2.distanceTransform((~mask).astype(np.uint8), cv2.DIST_L2, 5) <= pixels
