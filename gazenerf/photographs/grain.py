"""The grain of a photograph, measured on its skin and made anew for pixels that were not seen."""

from __future__ import annotations

import cv2
import numpy as np

KERNEL = np.array([[1.0, -2.0, 1.0], [-2.0, 4.0, -2.0], [1.0, -2.0, 1.0]]) / 6.0
"""Immerkaer 1996, Fast noise variance estimation: blind to planes, of unit gain for white noise."""

BELOW = 0.45
"""Grain is measured this far below the eyes, in distances between them."""

BLUR = 0.6
"""Standard deviation in pixels of what demosaicing and compression leave of white noise."""


def grain_level(pixels: np.ndarray, eyes: np.ndarray, unit: float) -> float:
    """Standard deviation of the grain, 8-bit sRGB levels.

    Args:
        pixels: (H, W, 3) uint8.
        eyes: (2,) middle between the eyes, pixels.
        unit: Distance between the eyes, pixels.
    """
    top, left = (max(0, int(v)) for v in (eyes[1] + (BELOW - 0.2) * unit, eyes[0] - 0.5 * unit))
    part = pixels[top : top + max(4, int(0.4 * unit)), left : left + max(4, int(unit))]
    if min(part.shape[:2]) < 4:
        return 0.0
    response = cv2.filter2D(part.mean(axis=-1), cv2.CV_64F, KERNEL)[1:-1, 1:-1]
    return float(np.median(np.abs(response)) / 0.6745)


def grain(level: float, size: tuple[int, int], seed: int) -> np.ndarray:
    """(H, W, 1) grain of that standard deviation for a picture of size (width, height)."""
    noise = np.random.default_rng(seed).standard_normal(size[::-1])
    noise = cv2.GaussianBlur(noise, (0, 0), BLUR)
    return (level / max(float(noise.std()), 1e-9) * noise)[..., None]
