"""TSED: do matched features of neighbouring pictures lie on the epipolar lines of the known cameras?

Thresholded symmetric epipolar distance (Yu et al. 2023, arXiv 2304.10700). It needs pictures and cameras only, and
looks at what the pictures show rather than at depth. An error along the epipolar lines is not seen.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from gazenerf.geometry import Camera
from gazenerf.viz.metrics.definitions import NOT_NEGATIVE, SHARE, Definition
from gazenerf.viz.pictures.colormaps import to_uint8

THRESHOLDS_PX = (2.0, 4.0, 8.0)
"""Largest median distance of a consistent pair; the first is the paper's."""

MIN_MATCHES = 10
"""Fewer matches make a pair inconsistent, as in the paper."""

RATIO = 0.75
"""A match's descriptor distance over that of the second best (Lowe 2004); greater is left out."""

NEAR_DEGREES = 30.0
"""Largest angle between the optical axes of neighbours."""

CAMERAS = "Pictures against their cameras"

_TSED_ADVICE = (
    "The pictures do not show one scene from the given cameras: look at the pairs with the largest distances and with "
    "few matches, and check the cameras first."
)
_SHARES = (0.9, 0.7), (0.95, 0.8), (0.98, 0.9)

DEFINITIONS = (
    *(
        Definition(
            f"tsed_{threshold:g}px",
            f"TSED at {threshold:g} px" + (": consistent pairs, share" if threshold == THRESHOLDS_PX[0] else ""),
            "",
            f"The share of neighbouring pictures whose matched features lie within {threshold:g} px of where the "
            "cameras allow them (their epipolar lines).",
            passes=passes, warns=warns, higher_is_better=True, group=CAMERAS, bounds=SHARE, checks=("field", "frames"),
            advice=_TSED_ADVICE,
            method=f"Share of pairs with at least {MIN_MATCHES} SIFT matches whose median symmetric epipolar distance "
            f"is below {threshold:g} px.",
        )
        for threshold, (passes, warns) in zip(THRESHOLDS_PX, _SHARES, strict=True)
    ),
    Definition(
        "tsed_median_px", "distance from the epipolar lines, median", "px",
        "How far matched features of neighbouring pictures lie from where the cameras allow them.",
        passes=1.0, warns=2.0, group=CAMERAS, bounds=NOT_NEGATIVE, checks=("field", "frames"),
        advice=_TSED_ADVICE,
        method=f"Median, over pairs with at least {MIN_MATCHES} matches, of their median symmetric epipolar distance.",
    ),
    Definition(
        "tsed_matches", "matches per pair, median", "",
        "How many features could be matched between two neighbouring pictures.",
        passes=20.0, warns=10.0, higher_is_better=True, group=CAMERAS, bounds=NOT_NEGATIVE, checks=("field", "frames"),
        advice="There is too little texture to judge by, so TSED and COLMAP say little: measure larger pictures "
        "(--size).",
        method="Median number of matches per pair.",
    ),
)  # fmt: skip
"""Thresholded symmetric epipolar distance (Yu et al. 2023)."""


@dataclass(frozen=True)
class PairMatches:
    """Two pictures' matched features.

    Attributes:
        a, b: Indices of the pictures.
        points_a, points_b: (N, 2) image coordinates.
        distances: (N,) symmetric epipolar distances, pixels.
    """

    a: int
    b: int
    points_a: np.ndarray
    points_b: np.ndarray
    distances: np.ndarray

    @property
    def matches(self) -> int:
        """How many there are."""
        return len(self.distances)

    @property
    def median_px(self) -> float:
        """Median distance, NaN without a match."""
        return float(np.median(self.distances)) if self.matches else math.nan

    def consistent(self, threshold_px: float = THRESHOLDS_PX[0]) -> bool:
        """Whether there are enough matches and their median distance is below the threshold."""
        return self.matches >= MIN_MATCHES and self.median_px < threshold_px


@dataclass(frozen=True)
class Tsed:
    """The pairs that were judged, in the order of their frames."""

    pairs: tuple[PairMatches, ...]

    def score(self, threshold_px: float = THRESHOLDS_PX[0]) -> float:
        """Share of consistent pairs, NaN without a pair."""
        return float(np.mean([pair.consistent(threshold_px) for pair in self.pairs])) if self.pairs else math.nan

    @property
    def median_matches(self) -> float:
        """Median number of matches per pair, NaN without a pair."""
        return float(np.median([pair.matches for pair in self.pairs])) if self.pairs else math.nan

    @property
    def median_px(self) -> float:
        """Median over the pairs with enough matches of their median distance, NaN without one."""
        enough = [pair.median_px for pair in self.pairs if pair.matches >= MIN_MATCHES]
        return float(np.median(enough)) if enough else math.nan

    @property
    def too_few(self) -> int:
        """Pairs with fewer than `MIN_MATCHES` matches."""
        return sum(pair.matches < MIN_MATCHES for pair in self.pairs)


def fundamental(a: Camera, b: Camera) -> np.ndarray:
    """(3, 3) F with x_b^T F x_a = 0 for image coordinates of one world point (Hartley and Zisserman, eq. 9.1).

    Raises:
        ValueError: the cameras share their centre, so there are no epipolar lines.
    """
    b_from_a = b.camera_from_world @ a.world_from_camera
    rotation, t = b_from_a[:3, :3], b_from_a[:3, 3]
    length = float(np.linalg.norm(t))
    if length <= 1e-9 * max(1.0, float(np.linalg.norm(a.position))):
        raise ValueError("cameras with one centre have no epipolar lines")
    x, y, z = t / length
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.linalg.inv(b.intrinsics).T @ cross @ rotation @ np.linalg.inv(a.intrinsics)


def symmetric_epipolar_distance(f: np.ndarray, points_a: np.ndarray, points_b: np.ndarray) -> np.ndarray:
    """(N,) mean distance, pixels, of each point (N, 2) from the epipolar line of its partner."""
    a, b = (np.concatenate([points, np.ones((len(points), 1))], axis=1) for points in (points_a, points_b))
    line_b, line_a = a @ f.T, b @ f
    off = np.abs((b * line_b).sum(axis=1))
    reach_b, reach_a = (np.maximum(np.hypot(*line[:, :2].T), 1e-300) for line in (line_b, line_a))
    return 0.5 * (off / reach_b + off / reach_a)


def neighbours(cameras: Sequence[Camera], each: int = 2) -> list[tuple[int, int]]:
    """Pairs (i < j) of every camera with the `each` whose centres are nearest, once each.

    On an orbit these are the consecutive frames, in whatever order they are listed. Left out are cameras that share
    a centre and those whose optical axes are more than `NEAR_DEGREES` apart.
    """
    centres = np.array([camera.position for camera in cameras])
    axes = np.array([camera.world_from_camera[:3, 2] for camera in cameras])
    if not len(centres):
        return []
    gap = np.linalg.norm(centres[:, None] - centres[None], axis=-1)
    reach = max(1.0, float(np.linalg.norm(centres, axis=1).max()))
    apart = (gap <= 1e-6 * reach) | (axes @ axes.T < math.cos(math.radians(NEAR_DEGREES)) - 1e-9)
    gap[apart] = np.inf
    found = set()
    for i, row in enumerate(gap):
        for j in np.argsort(row, kind="stable")[:each]:
            if np.isfinite(row[j]):
                found.add((min(i, int(j)), max(i, int(j))))
    return sorted(found)


def measure_tsed(
    images: Sequence[np.ndarray], cameras: Sequence[Camera], pairs: Sequence[tuple[int, int]] | None = None
) -> Tsed:
    """Match SIFT features of pairs of pictures and measure their distances from the epipolar lines.

    Args:
        images: (H, W, 3) sRGB, uint8 or in [0, 1], of the cameras.
        cameras: One per picture.
        pairs: Indices; `neighbours` of the cameras by default.

    Raises:
        ValueError: an image's size is not its camera's, or the counts differ.
    """
    if len(images) != len(cameras):
        raise ValueError(f"{len(images)} pictures and {len(cameras)} cameras")
    for image, camera in zip(images, cameras, strict=True):
        if image.shape[:2] != (camera.height, camera.width):
            raise ValueError(f"a picture of {image.shape[:2]} for a camera of {camera.height}x{camera.width}")
    pairs = neighbours(cameras) if pairs is None else pairs
    features = {i: _features(images[i]) for i in sorted({i for pair in pairs for i in pair})}
    return Tsed(tuple(_match(i, j, features[i], features[j], fundamental(cameras[i], cameras[j])) for i, j in pairs))


def _features(image: np.ndarray) -> tuple[np.ndarray, np.ndarray | None]:
    """Image coordinates (N, 2) and descriptors of a picture's SIFT features."""
    grey = cv2.cvtColor(to_uint8(image), cv2.COLOR_RGB2GRAY)
    found, descriptors = cv2.SIFT.create(enable_precise_upscale=True).detectAndCompute(grey, None)  # type: ignore[call-overload]
    return np.array([point.pt for point in found]).reshape(-1, 2) + 0.5, descriptors


def _match(
    i: int,
    j: int,
    a: tuple[np.ndarray, np.ndarray | None],
    b: tuple[np.ndarray, np.ndarray | None],
    f: np.ndarray,
) -> PairMatches:
    nothing = np.zeros((0, 2))
    if a[1] is None or b[1] is None or len(b[1]) < 2:
        return PairMatches(i, j, nothing, nothing, np.zeros(0))
    best: dict[int, tuple[float, int]] = {}
    for couple in cv2.BFMatcher(cv2.NORM_L2).knnMatch(a[1], b[1], k=2):
        if len(couple) == 2 and couple[0].distance < RATIO * couple[1].distance:
            first = couple[0]
            best[first.trainIdx] = min(best.get(first.trainIdx, (math.inf, -1)), (first.distance, first.queryIdx))
    if not best:
        return PairMatches(i, j, nothing, nothing, np.zeros(0))
    points_a = a[0][[query for _, query in best.values()]]
    points_b = b[0][list(best)]
    return PairMatches(i, j, points_a, points_b, symmetric_epipolar_distance(f, points_a, points_b))
