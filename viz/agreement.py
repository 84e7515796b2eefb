"""How far two opinions about the same views are apart (definitions: docs/consistency.md)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import cv2
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


@dataclass(frozen=True)
class Reprojection:
    """One view against another by depth reprojection.

    Attributes:
        consistent: Share of co-visible pixels whose round trip lands within 1 px at a relative
            depth difference below 0.01.
        round_trip_px, depth_mm: Medians over co-visible pixels.
        warp_psnr: PSNR, dB, of the other picture warped into this one over consistent pixels; NaN
            without pictures.
        covisible: How many pixels were judged.
    """

    consistent: float
    round_trip_px: float
    depth_mm: float
    warp_psnr: float
    covisible: int


def reproject(
    a: DepthView,
    b: DepthView,
    metres_per_unit: float,
    image_a: np.ndarray | None = None,
    image_b: np.ndarray | None = None,
) -> Reprojection:
    """Round trip of view A's pixels through view B's depth, as in multi-view stereo fusion.

    Judged are the pixels that land inside B on a pixel with depth, at most 0.1 units behind its
    surface (farther behind they are hidden there).

    Args:
        image_a, image_b: (H, W, 3) pictures in [0, 1] of the same cameras.
    """
    rays_o, rays_d = a.camera.rays()
    seen = np.isfinite(a.depth)
    points = rays_o[seen] + a.depth[seen][:, None] * rays_d[seen]
    pixels, z = b.camera.project(points)
    there = _sample(b.depth, pixels)
    distance = np.linalg.norm(points - b.camera.position, axis=1)
    met = np.isfinite(there) & (z > 0) & (distance - there < 0.1)
    judged = int(met.sum())
    nothing = float("nan")
    if not judged:
        return Reprojection(nothing, nothing, nothing, nothing, 0)
    own = a.camera.pixel_centres()[seen][met]
    directions = b.camera.rays(pixels[met])[1]
    back = b.camera.position + there[met, None] * directions
    returned, _ = a.camera.project(back)
    gap = np.linalg.norm(returned - own, axis=1)
    depth_back = np.linalg.norm(back - a.camera.position, axis=1)
    depth_gap = np.abs(depth_back - a.depth[seen][met])
    good = (gap < 1.0) & (depth_gap < 0.01 * a.depth[seen][met])
    psnr = nothing
    if image_a is not None and image_b is not None and good.any():
        rows, columns = np.argwhere(seen)[met][good].T
        target = np.full((2, *a.depth.shape), -1.0, np.float32)
        target[:, rows, columns] = (pixels[met][good] - 0.5).T
        warped = cv2.remap(image_b.astype(np.float32), target[0], target[1], cv2.INTER_LINEAR)[rows, columns]
        mse = float(((warped - image_a[rows, columns]) ** 2).mean())
        psnr = float(-10.0 * np.log10(max(mse, 1e-10)))
    return Reprojection(
        float(good.sum() / judged), float(np.median(gap)), float(np.median(depth_gap) * metres_per_unit * 1000.0), psnr,
        judged,
    )  # fmt: skip


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


def _sample(depth: np.ndarray, pixels: np.ndarray) -> np.ndarray:
    """Depth at image coordinates (N, 2), bilinear; NaN outside, beside a hole, or across a depth step."""
    x, y = pixels[:, 0] - 0.5, pixels[:, 1] - 0.5
    height, width = depth.shape
    inside = (x >= 0) & (y >= 0) & (x <= width - 1) & (y <= height - 1)
    x0 = np.clip(np.floor(x).astype(int), 0, max(0, width - 2))
    y0 = np.clip(np.floor(y).astype(int), 0, max(0, height - 2))
    fx, fy = np.clip(x - x0, 0, 1), np.clip(y - y0, 0, 1)
    corners = np.stack([depth[y0, x0], depth[y0, x0 + 1], depth[y0 + 1, x0], depth[y0 + 1, x0 + 1]])
    weights = np.stack([(1 - fx) * (1 - fy), fx * (1 - fy), (1 - fx) * fy, fx * fy])
    value = (corners * weights).sum(axis=0)
    return np.where(inside & (np.ptp(corners, axis=0) < 0.15), value, np.nan)
