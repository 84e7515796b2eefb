"""One view carried into another by its depth: does it come back, and does it look the same there."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from gazenerf.image_metrics import psnr, ssim
from gazenerf.viz.metrics.agreement import DepthView

BEHIND = 0.1
"""World units; what lands farther than this behind the other view's surface is hidden there."""

DEPTH_STEP = 0.15
"""World units; depth is not interpolated across larger steps."""

MAX_PSNR = 100.0

Perceptual = Callable[[np.ndarray, np.ndarray], float]
"""Two pictures (H, W, 3) in [0, 1] to their LPIPS."""


@dataclass(frozen=True)
class Reprojection:
    """One view against another by depth reprojection.

    Attributes:
        consistent: Share of co-visible pixels whose round trip lands within 1 px at a relative
            depth difference below 0.01.
        round_trip_px, depth_mm: Medians over co-visible pixels.
        warp_psnr: PSNR, dB, of the other picture warped into this one over consistent pixels; NaN
            without pictures, at most 100.
        covisible: How many pixels were judged.
        warp_rmse, warp_ssim: Of the same pixels; SSIM's windows see this view's own pixels around them.
        warp_lpips: Of the same pixels on this view's own surroundings; NaN when not installed.
    """

    consistent: float
    round_trip_px: float
    depth_mm: float
    warp_psnr: float
    covisible: int
    warp_rmse: float = float("nan")
    warp_ssim: float = float("nan")
    warp_lpips: float = float("nan")


@dataclass(frozen=True)
class Carried:
    """View A's pixels in view B and back.

    Attributes:
        points: (H, W, 3) world points that A shows, NaN where it shows nothing.
        pixels: (H, W, 2) their image coordinates in B, NaN where A shows nothing.
        judged: (H, W) bool: they land on a pixel of B with depth, at most `BEHIND` behind its surface.
        gap_px: (H, W) distance of the round trip, NaN where not judged.
        depth_gap: (H, W) world units, difference in depth after the round trip.
        consistent: (H, W) bool: back within 1 px and 1 % of depth.
        shown: (H, W) bool: where B shows something.
    """

    points: np.ndarray
    pixels: np.ndarray
    judged: np.ndarray
    gap_px: np.ndarray
    depth_gap: np.ndarray
    consistent: np.ndarray
    shown: np.ndarray

    def warp(self, image: np.ndarray) -> np.ndarray:
        """(H, W, C) view B's picture where A shows the same points (cubic splines), NaN where not consistent.

        B's outline is continued outward first, so that splines do not ring from the background.
        """
        out = np.full((*self.consistent.shape, image.shape[-1]), np.nan, np.float32)
        place = (self.pixels[self.consistent] - 0.5).T[::-1]
        if not place.size:
            return out
        if not self.shown.all():
            nearest = ndimage.distance_transform_edt(~self.shown, return_distances=False, return_indices=True)
            image = image[tuple(np.asarray(nearest))]
        for channel in range(image.shape[-1]):
            out[self.consistent, channel] = ndimage.map_coordinates(
                image[..., channel].astype(np.float32), place, order=3, mode="nearest"
            )
        return out


def carry(a: DepthView, b: DepthView) -> Carried:
    """Carry every pixel of A by its depth into B and, by B's depth there, back."""
    seen = np.isfinite(a.depth)
    shape = a.depth.shape
    points = a.camera.unproject(a.depth)
    pixels = np.full((*shape, 2), np.nan)
    pixels[seen], z = b.camera.project(points[seen])
    there = np.full(shape, np.nan)
    there[seen] = np.where(z > 0, sample_depth(b.depth, pixels[seen]), np.nan)
    distance = np.linalg.norm(points - b.camera.position, axis=-1)
    judged = np.isfinite(there)
    judged[judged] = (distance - there)[judged] < BEHIND
    gap, depth_gap = np.full(shape, np.nan), np.full(shape, np.nan)
    if judged.any():
        back = b.camera.unproject(there[judged], pixels[judged])
        returned, _ = a.camera.project(back)
        gap[judged] = np.linalg.norm(returned - a.camera.pixel_centres()[judged], axis=1)
        depth_gap[judged] = np.abs(np.linalg.norm(back - a.camera.position, axis=1) - a.depth[judged])
    consistent = judged & (np.nan_to_num(gap, nan=np.inf) < 1.0)
    consistent &= np.nan_to_num(depth_gap, nan=np.inf) < 0.01 * np.nan_to_num(a.depth)
    return Carried(points, pixels, judged, gap, depth_gap, consistent, np.isfinite(b.depth))


def reproject(
    a: DepthView,
    b: DepthView,
    metres_per_unit: float,
    image_a: np.ndarray | None = None,
    image_b: np.ndarray | None = None,
    *,
    where: np.ndarray | None = None,
    carried: Carried | None = None,
    perceptual: Perceptual | None = None,
) -> Reprojection:
    """Round trip of view A's pixels through view B's depth, as in multi-view stereo fusion.

    Args:
        image_a, image_b: (H, W, 3) pictures in [0, 1] of the same cameras.
        where: (H, W) bool, judge these pixels of A only.
        carried: `carry(a, b)`, when it is known already.
        perceptual: Measures LPIPS too.
    """
    carried = carried or carry(a, b)
    judged = carried.judged if where is None else carried.judged & where
    count, nothing = int(judged.sum()), float("nan")
    if not count:
        return Reprojection(nothing, nothing, nothing, nothing, 0)
    good = carried.consistent & judged
    look = {"warp_psnr": nothing}
    if image_a is not None and image_b is not None and good.any():
        warped = np.where(good[..., None], carried.warp(image_b), image_a)
        rmse = float(np.sqrt(np.mean((warped - image_a)[good].astype(np.float64) ** 2)))
        look = {"warp_psnr": min(psnr(warped, image_a, good), MAX_PSNR), "warp_rmse": rmse}
        rows, columns = np.nonzero(good)
        crop = tuple(slice(max(0, int(i.min()) - 6), int(i.max()) + 7) for i in (rows, columns))
        if min(image_a[crop].shape[:2]) >= 11:
            look["warp_ssim"] = ssim(warped[crop], image_a[crop], good[crop])
            if perceptual is not None:
                look["warp_lpips"] = perceptual(warped[crop], image_a[crop])
    return Reprojection(
        consistent=float(good.sum() / count),
        round_trip_px=float(np.median(carried.gap_px[judged])),
        depth_mm=float(np.median(carried.depth_gap[judged]) * metres_per_unit * 1000.0),
        covisible=count,
        **look,
    )


def sample_depth(depth: np.ndarray, pixels: np.ndarray) -> np.ndarray:
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
    return np.where(inside & (np.ptp(corners, axis=0) < DEPTH_STEP), value, np.nan)
