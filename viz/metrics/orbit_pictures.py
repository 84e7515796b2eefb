"""Pictures against their cameras as rows of a verdict, for an orbit of a field and for somebody else's frames."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from typing import Any

import cv2
import numpy as np

from gazenerf.geometry import Camera
from gazenerf.heads.interface import BoundField
from gazenerf.viz.check.result import CheckResult
from gazenerf.viz.metrics.colmap import NO_MODEL, StructureFromMotion, run_colmap
from gazenerf.viz.metrics.definitions import Metric
from gazenerf.viz.metrics.epipolar import Map
from gazenerf.viz.metrics.error_bars import NORMAL_95, bootstrap
from gazenerf.viz.metrics.tsed import MIN_MATCHES, THRESHOLDS_PX, PairMatches, Tsed, measure_tsed
from gazenerf.viz.pictures.colormaps import to_uint8

ORBIT_YAWS = tuple(range(-30, 31, 5))
"""Degrees, of the orbit's cameras, at this pitch."""

ORBIT_PITCH = 5.0


def measure_orbit(
    result: CheckResult,
    bound: BoundField,
    size: int,
    *,
    sfm: bool = False,
    seed: int = 0,
    run: Map = map,
    progress: Callable[[int, int], None] | None = None,
) -> CheckResult:
    """A check with the gauges of an orbit's pictures: TSED and, on request, structure from motion.

    Args:
        result: What `check_subject` found.
        bound: The same field.
        size: Of the pictures.
        sfm: Also run COLMAP.
        seed: Of COLMAP's random choices and the error bars.
        run: How frames are rendered.
        progress: Called with (frames done, all frames).
    """
    cameras = [Camera.orbit(math.radians(yaw), math.radians(ORBIT_PITCH), size=size) for yaw in ORBIT_YAWS]
    images = []
    for image in run(lambda camera: bound.render(camera).image, cameras):
        images.append(image)
        if progress is not None:
            progress(len(images), len(cameras))
    tsed = measure_tsed(images, cameras, [(i, i + 1) for i in range(len(cameras) - 1)])
    motion = run_colmap(images, cameras, seed=seed) if sfm else None
    names = [f"{yaw:+d}/{ORBIT_PITCH:+.0f}" for yaw in ORBIT_YAWS]
    extra: dict[str, Any] = {"tsed_pairs": pair_rows(tsed, names)}
    notes = list(result.notes)
    if motion is not None:
        extra["structure_from_motion"] = asdict(motion)
        if motion.reason:
            notes.append(f"Structure from motion was not measured: {motion.reason}.")
    else:
        notes.append("Structure from motion was not asked for (--sfm).")
    return replace(
        result,
        metrics=with_readings(result.metrics, picture_readings(tsed, motion, seed)),
        extra=result.extra | extra,
        notes=tuple(notes),
    )


def pair_rows(tsed: Tsed, names: Sequence[str]) -> list[dict[str, Any]]:
    """A plain row a pair, for report.json."""
    return [{"a": names[p.a], "b": names[p.b], "matches": p.matches, "median_px": p.median_px} for p in tsed.pairs]


def picture_readings(tsed: Tsed, motion: StructureFromMotion | None, seed: int) -> dict[str, tuple[float, float]]:
    """Gauge to value and error bar, of TSED and structure from motion."""
    enough = [pair.median_px for pair in tsed.pairs if pair.matches >= MIN_MATCHES]
    values = {
        f"tsed_{threshold:g}px": (tsed.score(threshold), share_interval(tsed.score(threshold), len(tsed.pairs)))
        for threshold in THRESHOLDS_PX
    }
    values["tsed_median_px"] = reading(enough, np.median, seed)
    values["tsed_matches"] = reading([float(pair.matches) for pair in tsed.pairs], np.median, seed)
    if motion is not None and motion.reason in ("", NO_MODEL):
        found = (motion.registered / motion.pictures, motion.reprojection_px, motion.position_percent, motion.turn_deg)
        names = ("sfm_registered", "sfm_reprojection_px", "sfm_position_percent", "sfm_turn_deg")
        values |= {name: (value, math.nan) for name, value in zip(names, found, strict=True)}
    return values


def share_interval(share: float, count: int) -> float:
    """Half the 95 % interval of a share of `count` pairs (Wilson 1927), which is not 0 where all of them agree."""
    if not count:
        return math.nan
    z = NORMAL_95
    return z / (1.0 + z * z / count) * math.sqrt(share * (1.0 - share) / count + z * z / (4.0 * count * count))


def reading(samples: Sequence[float], reduce: Callable[[np.ndarray], Any], seed: int) -> tuple[float, float]:
    """A reduction over samples and its error bar; samples that are NaN are left out."""
    known = np.array([value for value in samples if math.isfinite(value)])
    return (float(reduce(known)), bootstrap(known, reduce, seed)) if len(known) else (math.nan, math.nan)


def with_readings(metrics: Sequence[Metric], values: dict[str, tuple[float, float]]) -> tuple[Metric, ...]:
    """The metrics with values and error bars where they are known."""
    return tuple(
        replace(metric, value=values[metric.name][0], error=values[metric.name][1]) if metric.name in values else metric
        for metric in metrics
    )


def match_picture(matched: PairMatches, left: np.ndarray, right: np.ndarray, height: int = 256) -> np.ndarray:
    """(H, W, 3) uint8: two pictures side by side, matches joined: green within 2 px of their lines, red beyond."""
    left, right = to_uint8(left), to_uint8(right)
    share = min(1.0, height / left.shape[0])
    size = (max(1, round(share * left.shape[1])), max(1, round(share * left.shape[0])))
    halves = [cv2.resize(image, size, interpolation=cv2.INTER_AREA) for image in (left, right)]
    canvas = np.ascontiguousarray(np.concatenate(halves, axis=1))
    for p, q, distance in zip(matched.points_a, matched.points_b, matched.distances, strict=True):
        start, end = share * p, share * q + [size[0], 0.0]
        colour = (60, 200, 90) if distance < THRESHOLDS_PX[0] else (220, 50, 40)
        ends = [(round(float(x)), round(float(y))) for x, y in (start, end)]
        cv2.line(canvas, ends[0], ends[1], colour, 1, cv2.LINE_AA)
    return canvas
