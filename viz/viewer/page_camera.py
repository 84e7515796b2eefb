"""The camera of a browser's page as a `Viewpoint`."""

from __future__ import annotations

from typing import cast

import numpy as np
import viser

from gazenerf.geometry.cameras import NEUTRAL_DISTANCE
from gazenerf.viz.viewer.viewpoint import Viewpoint


def viewpoint_of(camera: viser.CameraHandle) -> Viewpoint | None:
    """Where a page looks from; None where it reports a camera that cannot be."""
    try:
        return Viewpoint(
            cast(tuple[float, float, float, float], tuple(float(value) for value in camera.wxyz)),
            cast(tuple[float, float, float], tuple(float(value) for value in camera.position)),
            float(camera.fov),
            int(camera.image_width),
            int(camera.image_height),
        )
    except (ValueError, TypeError, AssertionError, OverflowError):
        return None


FARTHEST = 3.0
"""A new visitor's camera stands at most so many times as far away as usual."""


def stand_back(camera: viser.CameraHandle) -> bool:
    """Move a camera that is where all begin so far back that a page higher than wide shows the whole head.

    Returns:
        Whether it was there; a browser reports other places before it has taken the first one.
    """
    start = np.array([0.0, 0.0, NEUTRAL_DISTANCE])
    if not np.allclose(camera.position, start, atol=1e-3):
        return False
    away = min(camera.image_height / max(camera.image_width, 1), FARTHEST)
    if away > 1.0:
        camera.position = away * start
    return True
