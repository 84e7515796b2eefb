"""How far two opinions about the same views are apart (definitions: docs/consistency.md)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy import ndimage

from gazenerf.geometry import Camera


class DepthView(Protocol):
    """A camera with Euclidean depth and normals, NaN where nothing is seen."""

    @property
    def camera(self) -> Camera: ...

    @property
    def depth(self) -> np.ndarray: ...

    @property
    def normals(self) -> np.ndarray | None: ...


@dataclass(frozen=True)
class Agreement:
    """One view against a reference.

    Attributes:
        depth_median_mm, depth_p95_mm: Of the absolute depth difference along the rays.
        depth_bias_mm: Median signed difference; positive is farther than the reference.
        silhouette_iou: Intersection over union of what is seen.
        silhouette_px: Largest distance, pixels, of a disputed pixel from the reference's outline
            (95th percentile).
        normal_median_deg: Median angle between normals; NaN without normals.
        compared: Pixels compared: seen by both, one pixel inside the common silhouette.
    """

    depth_median_mm: float
    depth_p95_mm: float
    depth_bias_mm: float
    silhouette_iou: float
    silhouette_px: float
    normal_median_deg: float
    compared: int


def eroded(mask: np.ndarray, pixels: int = 1) -> np.ndarray:
    """(H, W) bool: a mask without its rim of some pixels."""
    return np.asarray(ndimage.binary_erosion(mask, iterations=pixels), dtype=bool) if pixels else mask


def depth_difference_mm(view: DepthView, reference: DepthView, metres_per_unit: float) -> np.ndarray:
    """(H, W) signed depth difference in millimetres, NaN where one of them sees nothing."""
    return (view.depth.astype(np.float64) - reference.depth) * metres_per_unit * 1000.0


def compare(
    view: DepthView,
    reference: DepthView,
    metres_per_unit: float,
    interior: int = 1,
    where: np.ndarray | None = None,
) -> Agreement:
    """Compare a view with a reference of the same camera.

    Args:
        interior: Pixels by which the common silhouette is shrunk before depth is compared.
        where: (H, W) bool, compare depth and normals here only.

    Raises:
        ValueError: the sizes differ.
    """
    if view.depth.shape != reference.depth.shape:
        raise ValueError(f"views of {view.depth.shape} and {reference.depth.shape} cannot be compared")
    mine, theirs = np.isfinite(view.depth), np.isfinite(reference.depth)
    both = mine & theirs
    inside = eroded(both, interior)
    if where is not None:
        inside = inside & where
    union = int((mine | theirs).sum())
    error = depth_difference_mm(view, reference, metres_per_unit)[inside]
    nothing = float("nan")
    angle = nothing
    if view.normals is not None and reference.normals is not None and inside.any():
        cosine = (view.normals[inside] * reference.normals[inside]).sum(axis=-1)
        angle = float(np.rad2deg(np.nanmedian(np.arccos(np.clip(cosine, -1.0, 1.0)))))
    away = np.asarray(ndimage.distance_transform_edt(theirs)) + np.asarray(ndimage.distance_transform_edt(~theirs))
    disputed = mine != theirs
    return Agreement(
        depth_median_mm=float(np.median(np.abs(error))) if error.size else nothing,
        depth_p95_mm=float(np.percentile(np.abs(error), 95)) if error.size else nothing,
        depth_bias_mm=float(np.median(error)) if error.size else nothing,
        silhouette_iou=float(both.sum() / union) if union else nothing,
        silhouette_px=float(np.percentile(away[disputed], 95)) if disputed.any() else 0.0,
        normal_median_deg=angle,
        compared=int(inside.sum()),
    )


def blemish_mm2(view: DepthView, reference: DepthView, metres_per_unit: float, limit_mm: float = 5.0) -> float:
    """Area of the largest connected spot that is off by more than a limit, or missing, inside the reference.

    Four pixels at the reference's edge are left out. The area is that of the pixels at the
    reference's depth, seen face on.
    """
    inside = eroded(np.isfinite(reference.depth), 4)
    off = np.abs(np.nan_to_num(depth_difference_mm(view, reference, metres_per_unit), nan=np.inf)) > limit_mm
    spots = np.zeros(off.shape, np.int32)
    count = int(np.asarray(ndimage.label(ndimage.binary_opening(off & inside), output=spots)))
    if not count:
        return 0.0
    side = np.where(inside, reference.depth, 0.0) / view.camera.fx * metres_per_unit * 1000.0
    return float(ndimage.sum_labels(side * side, spots, np.arange(1, count + 1)).max())
