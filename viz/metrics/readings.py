"""From readings of views, pairs, pictures and eyes to the numbers of the verdict and their error bars."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from gazenerf.heads.interface import Part
from gazenerf.viz.check.result import CheckedView
from gazenerf.viz.metrics.agreement import Agreement
from gazenerf.viz.metrics.drift import Drift
from gazenerf.viz.metrics.error_bars import bootstrap
from gazenerf.viz.metrics.eyes import EYES, EyeSweep, gaze_errors, gaze_response
from gazenerf.viz.metrics.pairs import PairReading

Measured = dict[str, tuple[float, float]]
"""Name to value and half width of its 95 % interval."""


def summary(values: Sequence[float], reduce: Callable[..., Any] = np.median) -> tuple[float, float]:
    """A statistic of the finite values and its bootstrapped error; extremes have no error bar."""
    known = np.asarray(values, dtype=np.float64)
    known = known[np.isfinite(known)]
    if not len(known):
        return math.nan, math.nan
    bar = math.nan if reduce in (np.max, np.min) else bootstrap(known, reduce)
    return float(reduce(known)), bar


def of_views(checked: Sequence[CheckedView]) -> Measured:
    """Field against the reference along the rays."""
    blemish = summary([view.blemish_mm2 for view in checked], np.max)
    return _along_rays([view.agreement for view in checked]) | {"blemish_mm2": blemish}


def _along_rays(agreements: Sequence[Agreement]) -> Measured:
    def values(name: str) -> list[float]:
        return [getattr(agreement, name) for agreement in agreements]

    return {
        "depth_median_mm": summary(values("depth_median_mm")),
        "depth_worst_mm": summary(values("depth_median_mm"), np.max),
        "depth_p95_mm": summary(values("depth_p95_mm")),
        "depth_bias_mm": _absolute(summary(values("depth_bias_mm"))),
        "silhouette_iou": summary(values("silhouette_iou")),
        "normal_median_deg": summary(values("normal_median_deg")),
    }


def reference_readings(between: Sequence[tuple[str, str, str, Agreement]]) -> dict[str, float]:
    """What the gauges along the rays read between two renders of the reference: no field can read less."""
    return {name: value for name, (value, _) in _along_rays([agreement for *_, agreement in between]).items()}


def of_renderers(between: Sequence[tuple[str, str, str, Agreement]]) -> Measured:
    """Reference renderers against each other."""
    return {
        "renderers_mm": summary([agreement.depth_p95_mm for *_, agreement in between], np.max),
        "renderers_px": summary([agreement.silhouette_px for *_, agreement in between], np.max),
    }


def of_surfaces(surfaces: dict[str, float], errors: dict[str, float]) -> Measured:
    """Surface distances and fits."""
    found = {name: (value, errors.get(name, math.nan)) for name, value in surfaces.items()}
    return found | {"scale_percent": _absolute(found["scale_percent"])}


def of_pairs(streams: dict[Part, tuple[PairReading, ...]]) -> Measured:
    """Views against each other, the merged picture and each stream alone."""

    def over(part: Part, name: str, reach: str | None = None, region: str = "whole", reduce: Any = np.median):
        pairs = [p for p in streams.get(part, ()) if reach is None or p.reach == reach]
        return summary([getattr(getattr(p, region), name) for p in pairs], reduce)

    found = {
        "reprojection": over("head", "consistent"),
        "round_trip_px": over("head", "round_trip_px"),
        "warp_psnr": over("head", "warp_psnr", "short"),
        "warp_ssim": over("head", "warp_ssim", "short"),
        "warp_long_psnr": over("head", "warp_psnr", "long"),
        "warp_worst_psnr": over("head", "warp_psnr", reduce=np.min),
        "warp_eye_region_psnr": over("head", "warp_psnr", "short", "eye_region"),
        "warp_long_eye_region_psnr": over("head", "warp_psnr", "long", "eye_region"),
    }
    for part in ("face", "eyes"):
        found |= {
            f"reprojection_{part}": over(part, "consistent"),
            f"warp_psnr_{part}": over(part, "warp_psnr", "short"),
            f"warp_long_psnr_{part}": over(part, "warp_psnr", "long"),
        }
    return found


def of_drift(drift: Drift, streams: dict[Part, tuple[PairReading, ...]]) -> Measured:
    """Pictures against their volumes."""
    reach = {(pair.a, pair.b): pair.reach for pair in streams.get("head", ())}

    def length(rows: Sequence[tuple[float, float]]) -> tuple[float, float]:
        known = np.array([row for row in rows if np.isfinite(row).all()]).reshape(-1, 2)
        if not len(known):
            return math.nan, math.nan

        def middle(some: np.ndarray) -> float:
            return float(np.linalg.norm(np.median(some, axis=0)))

        return middle(known), bootstrap(known, middle)

    def follow(name: str, wanted: str) -> tuple[float, float]:
        return summary([getattr(pair, name) for pair in drift.pairs if reach.get((pair.a, pair.b)) == wanted])

    return {
        "picture_iou": summary([view.iou for view in drift.views]),
        "outline_shift_px": length([view.outline_px for view in drift.views]),
        "picture_shift_px": length([view.shift_px for view in drift.views]),
        "unfollowed_share": follow("unfollowed", "long"),
        "screen_stuck": follow("stuck", "long"),
    }


def of_eyes(sweep: EyeSweep, metres_per_unit: float) -> Measured:
    """The eyes over a gaze grid."""
    mm = 1000.0 * metres_per_unit
    rows = sweep.rows

    def slope(some: np.ndarray) -> float:
        return float(np.abs(np.diag(gaze_response(some)[0]) - 1.0).max())

    def crosstalk(some: np.ndarray) -> float:
        response = gaze_response(some)[0]
        return float(max(abs(response[0, 1]), abs(response[1, 0])))

    def bias(some: np.ndarray) -> float:
        return float(np.linalg.norm((some[:, 2:] - some[:, :2]).mean(axis=0)))

    def of_rows(statistic: Callable[[np.ndarray], float]) -> tuple[float, float]:
        if not len(rows):
            return math.nan, math.nan
        return statistic(rows), bootstrap(rows, statistic)

    centres = [_known_rows(sweep.centres[eye]) * mm for eye in EYES]
    radii = [_known_rows(sweep.radii_mm[eye][:, None]) for eye in EYES]
    apart = np.linalg.norm(sweep.centres["left"] - sweep.centres["right"], axis=1) * mm
    truth = float(np.linalg.norm(sweep.reference_centres[0] - sweep.reference_centres[1])) * mm
    return {
        "gaze_error_deg": summary(gaze_errors(rows).tolist(), np.mean),
        "gaze_bias_deg": of_rows(bias),
        "gaze_spread_deg": summary(np.concatenate([sweep.spread_deg[eye] for eye in EYES]).tolist(), np.mean),
        "gaze_slope": of_rows(slope),
        "gaze_crosstalk": of_rows(crosstalk),
        "gaze_nonlinear_deg": (sweep.nonlinear_deg, math.nan),
        "eye_drift_mm": _worse([(_drift(c), bootstrap(c, _drift)) for c in centres]),
        "eye_radius_drift_mm": _worse([(_drift(r), bootstrap(r, _drift)) for r in radii]),
        "eye_distance_mm": _absolute(summary((apart - truth).tolist())),
        "pose_change_mm": summary(sweep.pose_change_mm[1:].tolist(), np.max),
        "pose_change_deg": summary(sweep.pose_change_deg[1:].tolist(), np.max),
        "face_change_psnr": summary(sweep.face_change_psnr[1:].tolist(), np.min),
    }


def _drift(rows: np.ndarray) -> float:
    """Root mean square distance of rows (N, D) from their mean; NaN for fewer than two."""
    if len(rows) < 2:
        return math.nan
    return float(np.sqrt(((rows - rows.mean(axis=0)) ** 2).sum(axis=1).mean()))


def _known_rows(rows: np.ndarray) -> np.ndarray:
    return rows[np.isfinite(rows).all(axis=1)]


def _worse(found: list[tuple[float, float]]) -> tuple[float, float]:
    known = [pair for pair in found if math.isfinite(pair[0])]
    return max(known) if known else (math.nan, math.nan)


def _absolute(pair: tuple[float, float]) -> tuple[float, float]:
    return abs(pair[0]), pair[1]
