"""One layer of a head as a picture, and the depths at which that picture hides what else is in the scene."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import maximum_filter

from gazenerf.errors import UserError
from gazenerf.geometry import Camera
from gazenerf.heads.interface import BoundField, GeometryView
from gazenerf.viz.pictures.colormaps import to_uint8
from gazenerf.viz.pictures.panels import STREAMS, draw_geometry, head_geometry

SLACK = 0.02
"""World units by which a surface is moved away before it hides anything, 2 mm of the bundled heads, so that a mesh of
the same surface is seen whole."""

STEP = 256e-5
"""Depths are rounded to it, a quarter of a millimetre: the last of the three bytes in which viser sends them is then
the same everywhere."""

BESIDE = 3
"""Depths of so many pixels side by side count as the farthest of them: one pixel of them covers several of the picture,
and an outline would hide what is beside it."""

EMPTY = 160.0
"""Depth where nothing is seen, world units; viser sends up to 167."""


def draw_layer(bound: BoundField, camera: Camera, layer: str) -> tuple[np.ndarray, GeometryView | None]:
    """The picture of a layer, (H, W, 3) uint8, and the geometry of what it shows where that came with it.

    Depth and opacity come with a picture of the head: a bake has them at once, and rays of their own are slow.

    Args:
        bound: A head at a gaze.
        camera: Of the picture.
        layer: One of `LAYERS`.

    Raises:
        UserError: a stream that the field does not have.
    """
    if layer == "normals":
        geometry = head_geometry(bound, camera, None, True, None)
        return draw_geometry(geometry, camera, layer), geometry
    part = STREAMS.get(layer, "head")
    view = bound.render(camera, (part,))
    if layer not in STREAMS:
        geometry = head_geometry(bound, camera, view, False, None)
        return draw_geometry(geometry, camera, layer), geometry
    if part not in view.images:
        raise UserError(f"this field has no {part} stream to show")
    return to_uint8(view.images[part]), view.geometry.get(part)


def hiding_depth(geometry: GeometryView) -> np.ndarray:
    """(H, W) float32 camera z beyond which things are hidden by what is seen, world units, rounded to `STEP`."""
    depth = geometry.depth_z + SLACK
    farthest = maximum_filter(np.where(np.isfinite(depth), depth, EMPTY), BESIDE)
    return (STEP * np.round(farthest / STEP)).clip(0.0, EMPTY).astype(np.float32)
