"""Whether teeth fill a mouth that is not shut: landmarks of lips cannot tell a smile from an open jaw, pixels can."""

from __future__ import annotations

import cv2
import numpy as np

from gazenerf.photographs.appearance import between_lips, eye_openings, face_oval
from gazenerf.photographs.landmarks import FaceLandmarks

OPEN_SHARE, LEAST_PIXELS = 0.08, 30
"""How far the inner lips have to be apart for anything to be seen, as a share of the distance between the eyes; and the
pixels that have to lie between them."""

BRIGHT, PALE = 0.5, 0.6
"""Teeth have at least so much of the skin's brightness, and at most so much of its redness: the share of red in the sum
of the channels, above that of grey. Tongues are as red as pale skin."""

LEAST_REDNESS = 0.01
"""Of the skin; a grey picture does not tell teeth from a tongue."""

WIDE, RIM = 0.6, 0.2
"""Share of the opening's width that is looked at, in its middle, and of its height at each lip that is not: landmarks
lie only so exactly on the edges of lips, and corners are dark."""

FILLED = 0.6
"""Share of what is looked at from which on the teeth count as closed."""


def tooth_share(pixels: np.ndarray, landmarks: FaceLandmarks) -> float | None:
    """Share of the opening of the mouth that shows teeth; None where too little of it, or no colour, is seen.

    Args:
        pixels: (H, W, 3) uint8 sRGB.
        landmarks: In it.
    """
    left, top = np.floor(landmarks.points.min(axis=0)).astype(int).clip(0)
    right, bottom = np.ceil(landmarks.points.max(axis=0)).astype(int) + 1
    face = pixels[top:bottom, left:right].astype(np.float64)
    if not face.size:
        return None
    inside = FaceLandmarks(landmarks.points - [left, top])
    shape = face.shape[:2]
    opening = between_lips(inside, shape)
    if opening.sum(axis=0).max() < OPEN_SHARE * landmarks.interocular or opening.sum() < LEAST_PIXELS:
        return None
    grow = max(3, round(0.15 * landmarks.interocular))
    lips = cv2.dilate(opening.astype(np.uint8), np.ones((grow, grow), np.uint8)) > 0
    skin = face_oval(inside, shape) & ~eye_openings(inside, shape) & ~lips
    redness, brightness = face[..., 0] / np.maximum(face.sum(axis=-1), 1.0) - 1.0 / 3.0, face.mean(axis=-1)
    if not skin.any() or np.median(redness[skin]) < LEAST_REDNESS:
        return None
    tooth = (redness <= PALE * np.median(redness[skin])) & (brightness >= BRIGHT * np.median(brightness[skin]))
    return float(tooth[_middle(opening)].mean())


def _middle(opening: np.ndarray) -> np.ndarray:
    """(H, W) bool: an opening without its corners and the rims of the lips."""
    columns = np.flatnonzero(opening.any(axis=0))
    first, last = np.quantile(columns, [0.5 - 0.5 * WIDE, 0.5 + 0.5 * WIDE]).round().astype(int)
    height = opening.sum(axis=0)
    below = np.cumsum(opening, axis=0) - 0.5
    inner = opening & (below > RIM * height) & (below < (1.0 - RIM) * height)
    inner[:, :first] = inner[:, last + 1 :] = False
    return inner


def teeth_are_shut(pixels: np.ndarray, landmarks: FaceLandmarks) -> bool:
    """Whether the lips are apart and teeth fill what is seen between them; see `tooth_share`."""
    share = tooth_share(pixels, landmarks)
    return share is not None and share >= FILLED
