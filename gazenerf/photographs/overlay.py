"""A picture of how a fit lies on its photograph."""

from __future__ import annotations

import cv2
import numpy as np

from gazenerf.geometry import Camera, Gaze
from gazenerf.head_model.interface import EYE_LEFT, EYE_RIGHT
from gazenerf.photographs.fit import FittedPhotograph

OUTLINE, EYES, DETECTED, FITTED, GAZE = (90, 220, 90), (255, 220, 60), (70, 190, 255), (255, 80, 80), (255, 255, 255)
ARROW_UNITS = 0.45
SMALLEST_HEIGHT = 480
"""Pixels: smaller pictures are enlarged by a whole factor before anything is drawn."""

SHIFT = 4
"""Fractional bits of OpenCV's drawing coordinates."""


def overlay(fitted: FittedPhotograph) -> np.ndarray:
    """(H, 3 W, 3) uint8: the photograph with the fit's outlines and landmarks, the photograph, the drawn head.

    Green: outline of the head model's skin; yellow: its eyeballs between the lids; red: fitted landmarks, joined by a
    line to the detected ones in blue; white: gaze.
    """
    seen, factor = fitted.seen, max(1, -(-SMALLEST_HEIGHT // fitted.seen.image.shape[0]))
    camera = seen.camera.resized(seen.camera.width * factor, seen.camera.height * factor)
    size = camera.width, camera.height
    photograph = cv2.resize(seen.image, size, interpolation=cv2.INTER_CUBIC)
    parts = cv2.resize(seen.raster.parts, size, interpolation=cv2.INTER_NEAREST)
    marked, drawn = photograph.copy(), photograph.copy()
    for mask, colour in ((parts > 0, OUTLINE), (parts == EYE_LEFT + 1, EYES), (parts == EYE_RIGHT + 1, EYES)):
        outlines, _ = cv2.findContours(mask.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
        cv2.drawContours(marked, outlines, -1, colour, 1, cv2.LINE_AA)
    for detected, projected in zip(factor * fitted.detected, factor * fitted.projected, strict=True):
        cv2.line(marked, _fixed(detected), _fixed(projected), DETECTED, 1, cv2.LINE_AA, SHIFT)
        cv2.circle(marked, _fixed(projected), 1 << SHIFT, FITTED, -1, cv2.LINE_AA, SHIFT)
    _draw_gaze(marked, seen.mesh.eye_centres, seen.mesh.eye_radius, camera, fitted.subject.gaze)
    head = cv2.resize(fitted.drawn, size, interpolation=cv2.INTER_CUBIC)
    # the outermost pixels are mixed with the black that the head was drawn on
    whole = cv2.erode((seen.raster.parts > 0).astype(np.uint8), np.ones((3, 3), np.uint8))
    whole = cv2.resize(whole, size, interpolation=cv2.INTER_NEAREST) > 0
    drawn[whole] = head[whole]
    return np.concatenate([marked, photograph, drawn], axis=1)


def _draw_gaze(image: np.ndarray, centres: np.ndarray, radius: float, camera: Camera, gaze: Gaze) -> None:
    for centre in centres:
        ends, _ = camera.project(np.stack([centre + radius * gaze.vector(), centre + ARROW_UNITS * gaze.vector()]))
        cv2.arrowedLine(image, _fixed(ends[0]), _fixed(ends[1]), GAZE, 1, cv2.LINE_AA, SHIFT, 0.2)


def _fixed(point: np.ndarray) -> tuple[int, int]:
    """OpenCV's fixed-point coordinates of a continuous image point."""
    x, y = np.round((np.asarray(point) - 0.5) * (1 << SHIFT)).astype(int)
    return int(x), int(y)
