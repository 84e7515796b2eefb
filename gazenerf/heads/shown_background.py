"""Where a head shows nothing but the background that it was trained before, as the cut of its neck does.

Pictures of the training set had that colour there, so a field may as well fill the place with density of that colour
as leave it empty. Before its own background nobody sees a difference; before another one it is a dark rim.
"""

from __future__ import annotations

import cv2
import numpy as np

SAME, ALIKE = 4.0 / 255.0, 12.0 / 255.0
"""sRGB up to which a colour is the background's, and up to which it is where it touches such a place."""

RIM = 8.0
"""Pixels of a picture of 512 in which the head's own colour comes up from the background's."""

LEAST = 1e-4
"""Share of the picture below which such a place is noise."""


def without_shown_background(cutout: np.ndarray, background: np.ndarray) -> np.ndarray:
    """A cutout less the places that have the background's colour and touch what is not seen or the picture's border.

    Along them the head's own colour is taken from `RIM` further in, and its share from how far a pixel has come from
    the background's colour to that one.

    Args:
        cutout: (H, W, 4) float32, see `gazenerf.heads.cutouts`.
        background: (3,) sRGB of the field's own background.

    Returns:
        (H, W, 4); the cutout itself where there is no such place.
    """
    share = cutout[..., 3:]
    colours = cutout[..., :3] + (1.0 - share) * background
    away = np.abs(colours - background).max(axis=2)
    outside = share[..., 0] <= 0.5
    border = np.pad(np.zeros_like(outside[1:-1, 1:-1]), 1, constant_values=True)
    shown = _touching((away <= SAME) | outside, outside | border) & ~outside
    shown = _touching((away <= ALIKE) & ~outside, shown)
    if shown.mean() < LEAST:
        return cutout
    rim = RIM * max(cutout.shape[:2]) / 512.0
    distance = cv2.distanceTransform((~shown).astype(np.uint8), cv2.DIST_L2, 5)
    inner = (distance > rim) & (share[..., 0] > 0.5)
    if not inner.any():
        return cutout
    _, nearest = cv2.distanceTransformWithLabels(
        (~inner).astype(np.uint8), cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
    )
    own = np.zeros((int(nearest.max()) + 1, 3), np.float32)
    own[nearest[inner]] = colours[inner]
    near = (distance <= rim) & (share[..., 0] > 0.0)
    whole = own[nearest[near]] - background
    come = colours[near] - background
    length = np.maximum((whole * whole).sum(axis=1), 1e-6)
    part = np.clip((come * whole).sum(axis=1) / length, 0.0, 1.0)[:, None].astype(np.float32)
    part = np.where(shown[near][:, None], 0.0, np.minimum(part, share[near]))
    found = cutout.copy()
    found[near] = np.concatenate([np.clip(colours[near] - (1.0 - part) * background, 0.0, part), part], axis=1)
    return found


def _touching(mask: np.ndarray, seeds: np.ndarray) -> np.ndarray:
    """(H, W) bool: the pieces of a mask that hold a seed."""
    _, pieces = cv2.connectedComponents(mask.astype(np.uint8), connectivity=8)
    return np.isin(pieces, np.unique(pieces[seeds & mask])) & mask
