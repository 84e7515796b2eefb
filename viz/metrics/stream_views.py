"""One view of a field for a check: pictures and depth of the merged head and of each stream alone."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gazenerf.errors import UserError
from gazenerf.geometry import Camera
from gazenerf.heads.interface import BoundField, GeometryView, Part

FAINT = 1e-3
"""Opacity of the eyes below which the face's depth is the head's."""

CELLS = 16
"""Windows are cut at multiples of this many pixels, so that they share the whole picture's feature grid."""


@dataclass(frozen=True)
class StreamView:
    """What a field shows from one camera.

    Attributes:
        camera: Of the pictures and the geometry.
        images: Part to (H, W, 3) picture in [0, 1].
        geometry: Part to opacity and depth at the pictures' size; `head` has normals.
        feature_width: Of the feature map.
    """

    camera: Camera
    images: dict[Part, np.ndarray]
    geometry: dict[Part, GeometryView]
    feature_width: int


def render_streams(bound: BoundField, camera: Camera) -> StreamView:
    """Render a view: every part that the field has.

    Where no eye is met, head and face have the same density along a ray and thus the same depth, so
    the face is rendered in a window around the eyes only.

    Raises:
        UserError: a picture has another size than its camera, or holds NaN.
    """
    parts = bound.parts
    rendered = bound.render(camera, parts)
    for part in parts:
        check_picture(rendered.images[part], camera, f"the field's picture ({part})")
    head = bound.render_geometry(camera, "head", normals=True)
    geometry: dict[Part, GeometryView] = {"head": head}
    if "eyes" in parts:
        eyes = bound.render_geometry(camera, "eyes")
        geometry |= {"face": _face(bound, head, eyes), "eyes": eyes}
    small = rendered.geometry.get("head")
    return StreamView(
        camera, {part: rendered.images[part] for part in parts}, geometry, small.camera.width if small else camera.width
    )


def check_picture(image: np.ndarray, camera: Camera, what: str) -> None:
    """Raise UserError for a picture that is not its camera's size, or not of finite numbers."""
    if image.shape != (camera.height, camera.width, 3):
        raise UserError(
            f"{what} has the shape {image.shape}, its camera is {camera.width}x{camera.height}; "
            "pictures and cameras must have one size"
        )
    bad = int((~np.isfinite(image)).any(axis=-1).sum())
    if bad:
        raise UserError(f"{what} holds {bad} pixels that are NaN or infinite; check the weights")


def _face(bound: BoundField, head: GeometryView, eyes: GeometryView) -> GeometryView:
    rows, columns = np.nonzero(eyes.opacity > FAINT)
    opacity, depth = head.opacity.copy(), head.depth.copy()
    if rows.size:
        height, width = depth.shape
        window = (
            slice(max(0, int(rows.min()) - 1), min(height, int(rows.max()) + 2)),
            slice(max(0, int(columns.min()) - 1), min(width, int(columns.max()) + 2)),
        )
        found = bound.render_geometry(head.camera.windowed(window), "face")
        opacity[window], depth[window] = found.opacity, found.depth
    return GeometryView(head.camera, opacity, depth)


def window_around(camera: Camera, points: np.ndarray, margin: float) -> tuple[slice, slice]:
    """Rows and columns, cut at multiples of `CELLS`, that show balls about points.

    Args:
        points: (N, 3) world.
        margin: Radius of the balls, world units.

    Raises:
        UserError: they lie outside the picture.
    """
    pixels, z = camera.project(np.asarray(points, dtype=np.float64))
    reach = margin / np.maximum(z, 1e-6) * camera.fx
    low = np.floor((pixels - reach[:, None]).min(axis=0) / CELLS).astype(int) * CELLS
    high = np.ceil((pixels + reach[:, None]).max(axis=0) / CELLS).astype(int) * CELLS
    low, high = np.maximum(low, 0), np.minimum(high, [camera.width, camera.height])
    if (z <= 0).any() or (high - low < 2).any():
        raise UserError("the eyes lie outside the pictures; the cameras do not see the head")
    return slice(int(low[1]), int(high[1])), slice(int(low[0]), int(high[0]))
