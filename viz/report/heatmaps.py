"""Pictures of where the field and the reference differ."""

from __future__ import annotations

import numpy as np

from gazenerf.viz.metrics.agreement import DepthView, depth_difference_mm, eroded
from gazenerf.viz.pictures.colormaps import to_uint8
from gazenerf.viz.pictures.surface_colours import FARTHER, NEARER, signed_colours

LIMIT_MM = 10.0
"""Depth differences beyond this take the end colours."""


def depth_difference_picture(
    view: DepthView, reference: DepthView, metres_per_unit: float, limit_mm: float = LIMIT_MM
) -> np.ndarray:
    """Signed depth difference, (H, W, 3) uint8; `colour_bar` is its key."""
    return signed_colours(depth_difference_mm(view, reference, metres_per_unit), limit_mm)


def silhouette_picture(view: DepthView, reference: DepthView, image: np.ndarray | None = None) -> np.ndarray:
    """Both silhouettes over a picture, (H, W, 3) uint8.

    Red is only the view's, blue only the reference's, and what both have shows the picture (grey
    without one), rimmed by the reference's outline.
    """
    mine, theirs = np.isfinite(view.depth), np.isfinite(reference.depth)
    out = np.full((*mine.shape, 3), 255, np.uint8)
    out[mine & theirs] = 170 if image is None else to_uint8(image)[mine & theirs]
    out[theirs & ~eroded(theirs)] = (60, 60, 60)
    out[mine & ~theirs] = FARTHER
    out[theirs & ~mine] = NEARER
    return out
