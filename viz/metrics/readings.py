"""From what views, pairs, pictures and eyes show to the values of the metrics and their error bars."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence

import numpy as np

from gazenerf.heads.interface import Part
from gazenerf.viz.metrics.agreement import Agreement
from gazenerf.viz.metrics.colmap import NO_MODEL, StructureFromMotion
from gazenerf.viz.metrics.drift import Drift
from gazenerf.viz.metrics.error_bars import UNKNOWN, Reading, bootstrap, share_error, summary
from gazenerf.viz.metrics.eyes import EYES, EyeSweep, gaze_errors, gaze_response
from gazenerf.viz.metrics.frame_warps import Warp
from gazenerf.viz.metrics.pairs import PairReading
from gazenerf.viz.metrics.tsed import MIN_MATCHES, THRESHOLDS_PX, Tsed

Readings = dict[str, Reading]
"""Name of a metric to its value and error bar."""

Between = Sequence[tuple[str, str, str, Agreement]]
"""(renderer, renderer, view, agreement) of two renders of the reference head."""


def of_views(agreements: Sequence[Agreement], blemishes_mm2: Sequence[float]) -> Readings:
    """Field against the reference along the rays, an agreement and the largest blemish per view."""
    return _along_rays(agreements) | {"blemish_mm2": summary(blemishes_mm2, np.max)}


def _along_rays(agreements: Sequence[Agreement]) -> Readings:
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


def reference_readings(between: Between) -> dict[str, float]:
    """What the metrics along the rays read between two renders of the reference: no field can read less."""
    return {name: value for name, (value, _) in _along_rays([agreement for *_, agreement in between]).items()}


def of_renderers(between: Between) -> Readings:
    """Reference renderers against each other."""
    return {
        "renderers_mm": summary([agreement.depth_p95_mm for *_, agreement in between], np.max),
        "renderers_px": summary([agreement.silhouette_px for *_, agreement in between], np.max),
    }


def of_surfaces(surfaces: dict[str, float], errors: dict[str, float]) -> Readings:
    """Surface distances and fits."""
    found = {name: (value, errors.get(name, math.nan)) for name, value in surfaces.items()}
    return found | {"scale_percent": _absolute(found["scale_percent"])}


def of_pairs(streams: dict[Part, tuple[PairReading, ...]]) -> Readings:
    """Views against each other, the merged picture and each stream alone."""

    def over(
        part: Part,
        name: str,
        reach: str | None = None,
        region: str = "whole",
        statistic: Callable[[np.ndarray], float] = np.median,
    ) -> Reading:
        pairs = [p for p in streams.get(part, ()) if reach is None or p.reach == reach]
        return summary([getattr(getattr(p, region), name) for p in pairs], statistic)

    found = {
        "reprojection": over("head", "consistent"),
        "round_trip_px": over("head", "round_trip_px"),
        "warp_psnr": over("head", "warp_psnr", "short"),
        "warp_ssim": over("head", "warp_ssim", "short"),
        "warp_long_psnr": over("head", "warp_psnr", "long"),
        "warp_worst_psnr": over("head", "warp_psnr", statistic=np.min),
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


def of_drift(drift: Drift, streams: dict[Part, tuple[PairReading, ...]]) -> Readings:
    """Pictures against their volumes."""
    reach = {(pair.a, pair.b): pair.reach for pair in streams.get("head", ())}

    def length(rows: Sequence[tuple[float, float]]) -> Reading:
        known = np.array([row for row in rows if np.isfinite(row).all()]).reshape(-1, 2)
        if not len(known):
            return UNKNOWN

        def middle(some: np.ndarray) -> float:
            return float(np.linalg.norm(np.median(some, axis=0)))

        return middle(known), bootstrap(known, middle)

    def follow(name: str, wanted: str) -> Reading:
        return summary([getattr(pair, name) for pair in drift.pairs if reach.get((pair.a, pair.b)) == wanted])

    return {
        "picture_iou": summary([view.iou for view in drift.views]),
        "outline_shift_px": length([view.outline_px for view in drift.views]),
        "picture_shift_px": length([view.shift_px for view in drift.views]),
        "unfollowed_share": follow("unfollowed", "long"),
        "screen_stuck": follow("stuck", "long"),
    }


def of_eyes(sweep: EyeSweep, metres_per_unit: float) -> Readings:
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

    def of_rows(statistic: Callable[[np.ndarray], float]) -> Reading:
        if not len(rows):
            return UNKNOWN
        return statistic(rows), bootstrap(rows, statistic)

    centres = [_known_rows(sweep.centres[eye]) * mm for eye in EYES]
    radii = [_known_rows(sweep.radii_mm[eye][:, None]) for eye in EYES]
    apart = np.linalg.norm(sweep.centres["left"] - sweep.centres["right"], axis=1) * mm
    truth = float(np.linalg.norm(sweep.reference_centres[0] - sweep.reference_centres[1])) * mm
    return {
        "gaze_error_deg": summary(gaze_errors(rows), np.mean),
        "gaze_bias_deg": of_rows(bias),
        "gaze_spread_deg": summary(np.concatenate([sweep.spread_deg[eye] for eye in EYES]), np.mean),
        "gaze_slope": of_rows(slope),
        "gaze_crosstalk": of_rows(crosstalk),
        "gaze_nonlinear_deg": (sweep.nonlinear_deg, math.nan),
        "eye_drift_mm": _worse([(_drift(c), bootstrap(c, _drift)) for c in centres]),
        "eye_radius_drift_mm": _worse([(_drift(r), bootstrap(r, _drift)) for r in radii]),
        "eye_distance_mm": _absolute(summary(apart - truth)),
        "pose_change_mm": summary(sweep.pose_change_mm[1:], np.max),
        "pose_change_deg": summary(sweep.pose_change_deg[1:], np.max),
        "face_change_psnr": summary(sweep.face_change_psnr[1:], np.min),
    }


def of_pictures(tsed: Tsed, motion: StructureFromMotion | None, seed: int) -> Readings:
    """Pictures against their cameras: TSED and, where it ran, structure from motion."""
    enough = [pair.median_px for pair in tsed.pairs if pair.matches >= MIN_MATCHES]
    found: Readings = {}
    for threshold in THRESHOLDS_PX:
        share = tsed.score(threshold)
        found[f"tsed_{threshold:g}px"] = (share, share_error(share, len(tsed.pairs)))
    found["tsed_median_px"] = summary(enough, seed=seed)
    found["tsed_matches"] = summary([float(pair.matches) for pair in tsed.pairs], seed=seed)
    if motion is not None and motion.reason in ("", NO_MODEL):
        found |= {
            "sfm_registered": (motion.registered / motion.pictures, math.nan),
            "sfm_reprojection_px": (motion.reprojection_px, math.nan),
            "sfm_position_percent": (motion.position_percent, math.nan),
            "sfm_turn_deg": (motion.turn_deg, math.nan),
        }
    return found


def of_frames(warps: Iterable[Warp], seed: int) -> Readings:
    """Frames against each other by their depth files."""
    judged = [warp for warp in warps if warp.result.covisible]
    short, long = ([warp.result for warp in judged if warp.reach == reach] for reach in ("short", "long"))
    return {
        "reprojection": summary([result.consistent for result in short], seed=seed),
        "round_trip_px": summary([result.round_trip_px for result in short], seed=seed),
        "warp_psnr": summary([result.warp_psnr for result in short], seed=seed),
        "warp_worst_psnr": summary([result.warp_psnr for result in short], np.min),
        "warp_long_psnr": summary([result.warp_psnr for result in long], seed=seed),
    }


def _drift(rows: np.ndarray) -> float:
    """Root mean square distance of rows (N, D) from their mean; NaN for fewer than two."""
    if len(rows) < 2:
        return math.nan
    return float(np.sqrt(((rows - rows.mean(axis=0)) ** 2).sum(axis=1).mean()))


def _known_rows(rows: np.ndarray) -> np.ndarray:
    return rows[np.isfinite(rows).all(axis=1)]


def _worse(found: list[Reading]) -> Reading:
    known = [pair for pair in found if math.isfinite(pair[0])]
    return max(known) if known else UNKNOWN


def _absolute(reading: Reading) -> Reading:
    return abs(reading[0]), reading[1]
