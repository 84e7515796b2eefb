"""The camera of a browser's page as a `Viewpoint`."""

from __future__ import annotations

from typing import cast

import viser

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
