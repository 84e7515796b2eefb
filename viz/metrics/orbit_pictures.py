"""Pictures of an orbit of a field against their cameras: TSED and, on request, structure from motion."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from gazenerf.geometry import Camera
from gazenerf.heads.interface import BoundField
from gazenerf.viz.metrics.colmap import StructureFromMotion, run_colmap
from gazenerf.viz.metrics.epipolar import Map
from gazenerf.viz.metrics.tsed import THRESHOLDS_PX, PairMatches, Tsed, measure_tsed
from gazenerf.viz.pictures.colormaps import to_uint8

ORBIT_YAWS = tuple(range(-30, 31, 5))
"""Degrees, of the orbit's cameras, at this pitch."""

ORBIT_PITCH = 5.0


@dataclass(frozen=True)
class OrbitPictures:
    """What an orbit's pictures say of their cameras.

    Attributes:
        names: Of the pictures, by yaw and pitch, such as `+20/+5`.
        tsed: Each picture against the next.
        motion: What COLMAP made of them; None when not asked for.
    """

    names: tuple[str, ...]
    tsed: Tsed
    motion: StructureFromMotion | None = None


def measure_orbit(bound: BoundField, size: int, *, sfm: bool = False, seed: int = 0, run: Map = map) -> OrbitPictures:
    """Render an orbit and compare its pictures with its cameras.

    Args:
        bound: The field.
        size: Of the pictures, pixels.
        sfm: Also run COLMAP.
        seed: Of COLMAP's random choices.
        run: How pictures are rendered.
    """
    cameras = [Camera.orbit(math.radians(yaw), math.radians(ORBIT_PITCH), size=size) for yaw in ORBIT_YAWS]
    images = list(run(lambda camera: bound.render(camera).image, cameras))
    return OrbitPictures(
        tuple(f"{yaw:+d}/{ORBIT_PITCH:+.0f}" for yaw in ORBIT_YAWS),
        measure_tsed(images, cameras, [(i, i + 1) for i in range(len(cameras) - 1)]),
        run_colmap(images, cameras, seed=seed) if sfm else None,
    )


def pair_rows(tsed: Tsed, names: Sequence[str]) -> list[dict[str, str | int | float]]:
    """A plain row per pair, for report.json."""
    return [{"a": names[p.a], "b": names[p.b], "matches": p.matches, "median_px": p.median_px} for p in tsed.pairs]


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
