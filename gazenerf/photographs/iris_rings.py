"""The iris by its rings: its size, its colours where it is hidden, and the reflections that lie on it.

Places on the eye are told as the angle from the optical axis as a share of the iris's own; colours are linear and
relative to the white of the eye.
"""

from __future__ import annotations

import cv2
import numpy as np

from gazenerf.head_model.eyes import IRIS_ANGLE
from gazenerf.head_model.lids import smoothstep

LUMINANCE = np.array([0.2126, 0.7152, 0.0722])
"""Rec. 709, of linear RGB."""

FADE = (1.08, 1.22)
"""The iris fades into the white between these shares of its angle, and `BLUR_PX` further out."""

BLUR_PX, MOST_BLUR = 0.6, 0.2
"""Pixels of the photograph by which its own blur widens the limbus, and the largest such share of the iris."""

GLINT_WITHIN = 0.75
"""Highlights are looked for within this share of the iris's angle."""

GLINT_CONTRAST = 0.4
"""Their pixels exceed their ring by so much of the ring's own colour and the following."""

GLINT_EXCESS, GLINT_EDGE = 0.2, (0.04, 0.15)
"""So much, relative to the white, is the brightest pixel brighter. What joins it and is brighter by the first, and by
the second's share of what the brightest is, belongs to it."""

DARKER = 0.25
"""Highlights are measured against this quantile of a ring: they may cover most of the pupil."""

PUPIL, COVERED = 0.3, 0.3
"""The pupil within this share of the iris is as dark all over as its darkest pixels where highlights cover so much."""

RINGS = np.linspace(0.0, FADE[1] + MOST_BLUR, 30)
IRIS_SIZES = np.linspace(0.86, 1.16, 16)
"""Iris sizes that are tried, as shares of the head model's."""

SMALLEST_KNOWN = 12
"""Pixels below which nothing is concluded from them."""


def limbus_fade(radius_px: float) -> tuple[float, float]:
    """Shares between which an iris of that radius, in pixels of the photograph, fades into the white."""
    blur = min(MOST_BLUR, BLUR_PX / max(radius_px, 1e-9))
    return FADE[0] + blur, FADE[1] + blur


def beyond_iris(share: np.ndarray, fade: tuple[float, float]) -> np.ndarray:
    """0 on the iris, 1 on the white, by the angle from the axis as a share of the iris's; 1 where it is NaN."""
    return np.nan_to_num(smoothstep(*fade, share), nan=1.0)


def ring_colours(share: np.ndarray, rings: np.ndarray) -> np.ndarray:
    """(..., 3) colours of rings (R, 3) at `RINGS`, by the angle from the axis as a share (...) of the iris's."""
    share = np.nan_to_num(share, nan=9.0)
    return np.stack([np.interp(share, RINGS, rings[:, c]) for c in range(3)], axis=-1)


def iris_size(luminance: np.ndarray, known: np.ndarray, angle: np.ndarray) -> float:
    """How large the iris is relative to the head model's: where the rings of the eye brighten fastest."""
    best, found = 0.0, 1.0
    for size in IRIS_SIZES:
        share = angle / (size * IRIS_ANGLE)
        inner, outer = (luminance[known & (share > low) & (share < low + 0.12)] for low in (0.86, 1.02))
        if min(len(inner), len(outer)) >= SMALLEST_KNOWN and (step := np.median(outer) - np.median(inner)) > best:
            best, found = step, size
    return float(found)


def ring_quantiles(relative: np.ndarray, share: np.ndarray, certain: np.ndarray, quantile: float) -> np.ndarray:
    """(R, 3) quantiles over rings; rings that are not seen take their neighbours'."""
    step, rings = RINGS[1] - RINGS[0], np.full((len(RINGS), 3), np.nan)
    for i, middle in enumerate(RINGS):
        chosen = (np.abs(share - middle) < max(step, 0.12 if middle < 0.1 else 0.0)) & (certain > 0.7)
        if chosen.sum() >= 4:
            rings[i] = np.quantile(relative[chosen], quantile, axis=0)
    seen = np.isfinite(rings[:, 0])
    if not seen.any():
        return np.repeat(np.where(RINGS < 1.0, 0.15, 1.0)[:, None], 3, axis=1)
    return np.stack([np.interp(RINGS, RINGS[seen], rings[seen, c]) for c in range(3)], axis=1)


def corneal_glint(
    relative: np.ndarray, expected: np.ndarray, share: np.ndarray, certain: np.ndarray, unit: float
) -> np.ndarray:
    """(H, W) share of each pixel that a reflection on the cornea covers."""
    ring = expected @ LUMINANCE
    excess = relative @ LUMINANCE - (1.0 + GLINT_CONTRAST) * ring
    near = np.nan_to_num(share, nan=9.0)
    looked_at = np.where((near < 0.95) & (certain > 0.3), excess, 0.0)
    count, labels = cv2.connectedComponents((looked_at > GLINT_EXCESS).astype(np.uint8))
    kept = np.zeros(excess.shape, bool)
    for label in range(1, count):
        component = np.asarray(labels) == label
        peak = np.argmax(excess[component])
        if near[component][peak] < GLINT_WITHIN:
            edge = max(GLINT_EDGE[0], GLINT_EDGE[1] * excess[component][peak])
            _, regions = cv2.connectedComponents((looked_at > edge).astype(np.uint8))
            kept |= np.asarray(regions) == np.asarray(regions)[component][peak]
    reach = max(1, round(0.02 * unit))
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * reach + 1, 2 * reach + 1))
    grown = cv2.dilate(kept.astype(np.uint8), kernel).astype(np.float32)
    return cv2.GaussianBlur(grown, (0, 0), 0.5 * reach) * certain * (1.0 - smoothstep(0.9, 1.05, near))


def with_pupil(
    rings: np.ndarray, relative: np.ndarray, share: np.ndarray, certain: np.ndarray, glint: np.ndarray
) -> np.ndarray:
    """Rings (R, 3) whose pupil is made dark all over where highlights (H, W) cover much of it."""
    pupil = (share < PUPIL) & (certain > 0.7)
    if pupil.sum() < 4 or glint[pupil].mean() <= COVERED:
        return rings
    return np.where(RINGS[:, None] < PUPIL, np.quantile(relative[pupil], 0.05, axis=0), rings)
