"""Numbers to colours: depth, opacity and normals as (H, W, 3) uint8 pictures."""

from __future__ import annotations

import cv2
import numpy as np
from scipy import ndimage

from gazenerf.geometry.cameras import OPENGL_FROM_OPENCV, Camera

MAPS = {
    "viridis": cv2.COLORMAP_VIRIDIS,
    "inferno": cv2.COLORMAP_INFERNO,
    "magma": cv2.COLORMAP_MAGMA,
    "cividis": cv2.COLORMAP_CIVIDIS,
    "turbo": cv2.COLORMAP_TURBO,
}
"""Perceptually ordered colour maps; all but turbo are uniform."""


def to_uint8(image: np.ndarray) -> np.ndarray:
    """(..., 3) sRGB in [0, 1] to uint8, rounded; uint8 passes through.

    Raises:
        ValueError: the image holds NaN or infinite values.
    """
    if image.dtype == np.uint8:
        return image
    if not np.isfinite(image).all():
        raise ValueError("a picture holds NaN or infinite values")
    return np.round(np.clip(image, 0.0, 1.0) * 255.0).astype(np.uint8)


def apply_colormap(values: np.ndarray, name: str = "viridis") -> np.ndarray:
    """Values (H, W) in [0, 1], clipped, to (H, W, 3) uint8 RGB; NaN takes the lowest colour."""
    levels = np.round(np.nan_to_num(np.clip(values, 0.0, 1.0)) * 255.0).astype(np.uint8)
    return np.ascontiguousarray(cv2.applyColorMap(levels, MAPS[name])[..., ::-1])


def fill_holes(values: np.ndarray) -> np.ndarray:
    """(H, W) or (H, W, C) with every NaN pixel replaced by its nearest finite one; zeros if there is none."""
    hole = ~np.isfinite(values) if values.ndim == 2 else ~np.isfinite(values).all(axis=-1)
    if hole.all():
        return np.zeros_like(values)
    if not hole.any():
        return values
    nearest = ndimage.distance_transform_edt(hole, return_distances=False, return_indices=True)
    return values[tuple(np.asarray(nearest))]


def enlarge(values: np.ndarray, width: int, height: int) -> np.ndarray:
    """Finite (H, W) or (H, W, C) resampled to (height, width), pixel areas aligned."""
    if values.shape[:2] == (height, width):
        return values
    shrinking = width < values.shape[1] or height < values.shape[0]
    how = cv2.INTER_AREA if shrinking else cv2.INTER_LINEAR
    return cv2.resize(np.ascontiguousarray(values, dtype=np.float32), (width, height), interpolation=how)


def colour_depth(
    depth: np.ndarray,
    opacity: np.ndarray,
    near: float,
    far: float,
    *,
    size: tuple[int, int] | None = None,
    name: str = "viridis",
    background: tuple[float, float, float] = (0.12, 0.12, 0.13),
) -> np.ndarray:
    """Depth as colours, near bright, blended over a background by opacity.

    Args:
        depth: (H, W), NaN where there is no surface.
        opacity: (H, W) in [0, 1].
        near: Depth of the brightest colour.
        far: Depth of the darkest colour.
        size: (width, height) of the picture; of the arrays by default.
        name: A key of `MAPS`.
        background: sRGB where nothing is.

    Raises:
        ValueError: near is not below far.
    """
    if not near < far:
        raise ValueError(f"near {near:g} must be below far {far:g}")
    width, height = size or (depth.shape[1], depth.shape[0])
    filled = enlarge(fill_holes(depth), width, height)
    return _over(apply_colormap((far - filled) / (far - near), name), enlarge(opacity, width, height), background)


def colour_opacity(opacity: np.ndarray, *, size: tuple[int, int] | None = None) -> np.ndarray:
    """Opacity (H, W) in [0, 1] as grey, opaque white; arguments as `colour_depth`."""
    width, height = size or (opacity.shape[1], opacity.shape[0])
    return to_uint8(np.repeat(enlarge(opacity, width, height)[..., None], 3, axis=-1))


def colour_normals(
    normals: np.ndarray,
    opacity: np.ndarray,
    camera: Camera,
    *,
    size: tuple[int, int] | None = None,
    background: tuple[float, float, float] = (0.12, 0.12, 0.13),
) -> np.ndarray:
    """World normals (H, W, 3) as colours in the camera's frame: red right, green up, blue toward the camera.

    Other arguments as `colour_depth`.
    """
    width, height = size or (normals.shape[1], normals.shape[0])
    rotation = camera.world_from_camera[:3, :3] @ OPENGL_FROM_OPENCV[:3, :3]
    seen = enlarge(fill_holes(normals), width, height) @ rotation
    seen = seen / np.maximum(np.linalg.norm(seen, axis=-1, keepdims=True), 1e-9)
    return _over(to_uint8(0.5 + 0.5 * seen), enlarge(opacity, width, height), background)


def _over(colours: np.ndarray, opacity: np.ndarray, background: tuple[float, float, float]) -> np.ndarray:
    alpha = np.clip(opacity, 0.0, 1.0)[..., None]
    return to_uint8(colours / 255.0 * alpha + np.asarray(background) * (1.0 - alpha))
