"""Depth, silhouette and normals of a view against those of a reference from the same camera."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy import ndimage

from gazenerf.geometry import Camera
from gazenerf.viz.metrics.definitions import NOT_NEGATIVE, SHARE, Definition, Finding

ALONG_RAYS = "Field against the reference, along each pixel's ray"
RENDERERS = "Reference renderers against each other"

_SHAPE_ADVICE = (
    "The surface is not quite the head model's, so meshes and depth will be off by about as much: look at the depth "
    "maps of the worst views, and train longer or check the subject's head-model parameters."
)
_RENDERER_ADVICE = (
    "The reference itself is in doubt, so do not trust the comparisons with it: choose one renderer with --reference "
    "and update the graphics driver if pyrender is the odd one out."
)

DEFINITIONS = (
    Definition(
        "depth_median_mm", "depth error, median", "mm",
        "How far, in a typical pixel of a typical view, the field's surface lies from the reference head's, measured "
        "along the line of sight.",
        passes=1.5, warns=3.0, group=ALONG_RAYS, bounds=NOT_NEGATIVE,
        advice=_SHAPE_ADVICE,
        method="Median over views of the median absolute difference of Euclidean depth along each pixel's ray, over "
        "pixels seen by both and one pixel inside their common silhouette.",
        finding=Finding(0.3, 2),
    ),
    Definition(
        "depth_worst_mm", "depth error, median of the worst view", "mm",
        "The same depth error in the view where it is largest.",
        passes=3.0, warns=6.0, group=ALONG_RAYS, bounds=NOT_NEGATIVE,
        advice="One direction is worse than the others, often one that training rarely saw: open that view's depth "
        "map and avoid the direction, or train with more views of it.",
        method="The same median, of the worst view.",
    ),
    Definition(
        "depth_p95_mm", "depth error, 95th percentile", "mm",
        "The depth error that only one pixel in twenty exceeds.",
        passes=6.0, warns=12.0, group=ALONG_RAYS, bounds=NOT_NEGATIVE,
        advice="Some regions are clearly off although the rest may be right; the depth maps show which, often hair, "
        "ears or the neck.",
        method="Median over views of the 95th percentile.",
    ),
    Definition(
        "depth_bias_mm", "depth bias, absolute", "mm",
        "How far the whole surface lies in front of or behind the reference, errors in both directions cancelling.",
        passes=1.0, warns=2.0, group=ALONG_RAYS, bounds=NOT_NEGATIVE,
        advice="The surface is shifted or scaled as a whole rather than rough: look at frame shift and size "
        "difference, and check the cameras and the unit of the data.",
        method="Absolute value of the median over views of the median signed difference; the report gives each view's "
        "with its sign, positive is farther than the reference.",
    ),
    Definition(
        "silhouette_iou", "silhouette overlap (IoU)", "",
        "How much of the area covered by the field's head and by the reference head is covered by both; 1 is a "
        "perfect match.",
        passes=0.97, warns=0.94, higher_is_better=True, group=ALONG_RAYS, bounds=SHARE,
        advice="The outlines differ; hair and shoulders that the head model lacks are a harmless cause, a wrong size "
        "or position is not, so look at the silhouette pictures.",
        method="Median over views of intersection over union of the pixels with a surface (field: opacity at least "
        "0.5).",
        finding=Finding(0.995, 3),
    ),
    Definition(
        "normal_median_deg", "normal error, median", "deg",
        "By how much the direction that the field's surface faces differs from the reference's in a typical pixel.",
        passes=10.0, warns=20.0, group=ALONG_RAYS, bounds=NOT_NEGATIVE,
        advice="The surface is rough or lacks detail, so shaded meshes will look bumpy or flat: smooth the mesh or "
        "train longer.",
        method="Median over views of the median angle between the field's normals (minus the smoothed density "
        "gradient) and the reference's interpolated vertex normals.",
        finding=Finding(0.3, 2),
    ),
    Definition(
        "blemish_mm2", "largest hole or floater", "mm²",
        "The area of the largest connected spot where the field's surface is missing or more than 5 mm off.",
        passes=50.0, warns=200.0, group=ALONG_RAYS, bounds=NOT_NEGATIVE,
        advice="There is a hole in the head or something floats before it: find it in the depth maps, and repair or "
        "clean the mesh before use.",
        method="Area of the largest connected spot of any view that is off by more than 5 mm along the ray and 2 mm "
        "along the reference's normal, or missing, at least 4 pixels inside the reference's silhouette; strips under 3 "
        "pixels wide are left out.",
        finding=Finding(20.0, 0),
    ),
)  # fmt: skip
"""Field against the reference, pixel by pixel."""

RENDERER_DEFINITIONS = (
    Definition(
        "renderers_mm", "difference between reference renderers, depth", "mm",
        "How far two independent renderers disagree about the depth of the same reference head.",
        passes=0.1, warns=0.5, group=RENDERERS, bounds=NOT_NEGATIVE,
        advice=_RENDERER_ADVICE,
        method="Largest, over views and pairs of renderers, of the 95th percentile of the depth difference on "
        "interior pixels.",
    ),
    Definition(
        "renderers_px", "difference between reference renderers, silhouette", "px",
        "How far two independent renderers disagree about the outline of the same reference head.",
        passes=1.0, warns=2.0, group=RENDERERS, bounds=NOT_NEGATIVE,
        advice=_RENDERER_ADVICE,
        method="Largest, over views and pairs of renderers, of the 95th percentile of the disputed pixels' distance "
        "from the outline.",
    ),
)  # fmt: skip
"""Reference renderers against each other: the floor under the metrics along the rays."""


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


ACROSS_MM = 2.0
"""A surface is off only where it is so far off across itself, too: where it is seen nearly edge-on, its depth is off by
ten times as much."""


def blemish_mm2(view: DepthView, reference: DepthView, metres_per_unit: float, limit_mm: float = 5.0) -> float:
    """Area of the largest connected spot that is off by more than a limit, or missing, inside the reference.

    Off are depths along the ray that differ by more than the limit, and by more than `ACROSS_MM` along the reference's
    normal where that is known. Four pixels at the reference's edge are left out. The area is that of the pixels at the
    reference's depth, seen face on.
    """
    inside = eroded(np.isfinite(reference.depth), 4)
    away = np.abs(np.nan_to_num(depth_difference_mm(view, reference, metres_per_unit), nan=np.inf))
    off = (away > limit_mm) & (away * _facing(reference) > ACROSS_MM)
    spots = np.zeros(off.shape, np.int32)
    count = int(np.asarray(ndimage.label(ndimage.binary_opening(off & inside), output=spots)))
    if not count:
        return 0.0
    side = np.where(inside, reference.depth, 0.0) / view.camera.fx * metres_per_unit * 1000.0
    return float(ndimage.sum_labels(side * side, spots, np.arange(1, count + 1)).max())


def _facing(view: DepthView) -> np.ndarray:
    """(H, W) cosine between a surface's normals and the directions to the camera; 1 where they are not known."""
    if view.normals is None:
        return np.ones(view.depth.shape)
    _, rays = view.camera.rays()
    cosine = np.abs((view.normals * rays).sum(axis=-1))
    return np.where(np.isfinite(cosine), np.maximum(cosine, 1e-3), 1.0)
