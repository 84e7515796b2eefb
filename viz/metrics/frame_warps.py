"""Frames against each other by their depth files: depth carried there and back, pictures warped."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from gazenerf.geometry import Camera
from gazenerf.geometry.cameras import NEUTRAL_DISTANCE
from gazenerf.heads.interface import GeometryView
from gazenerf.viz.metrics.colmap import middle_of_attention
from gazenerf.viz.metrics.definitions import DECIBELS, NOT_NEGATIVE, SHARE, Definition
from gazenerf.viz.metrics.reprojection import Reprojection, carry, reproject
from gazenerf.viz.metrics.tsed import neighbours

LONG_DEGREES = (20.0, 40.0)
"""Angles at the middle of attention between the views of a long-range warp."""

MOST_PAIRS = 60
"""Warps of each range; more are thinned out evenly."""

DEPTH_RATIOS = (0.2, 5.0)
"""Depth over the cameras' distance from their middle of attention beyond which its unit is taken to be wrong."""

BY_DEPTH = "Views against each other, by their depth"

_DEPTH_ADVICE = (
    "The depth files contradict each other, so a surface fused from them will be blurred or double: check that depth "
    "and cameras belong together."
)
_WARP_ADVICE = (
    "Texture does not stay on the surface when the camera moves, which shows as swimming or flicker: look at the strip "
    "and at the worst pair."
)

DEFINITIONS = (
    Definition(
        "reprojection", "depth reprojection, consistent share", "",
        "The share of the surface that lands on itself when one frame is carried into a neighbour by its depth and "
        "back.",
        passes=0.95, warns=0.85, higher_is_better=True, group=BY_DEPTH, bounds=SHARE, checks=("frames",),
        advice=_DEPTH_ADVICE,
        method="Share of co-visible pixels that return within 1 px and with less than 1 % difference in depth, median "
        "over neighbours.",
    ),
    Definition(
        "round_trip_px", "reprojection round trip, median", "px",
        "How far from its start a pixel lands after it is carried into a neighbour by its depth and back.",
        passes=0.3, warns=0.6, group=BY_DEPTH, bounds=NOT_NEGATIVE, checks=("frames",),
        advice=_DEPTH_ADVICE,
        method="Median distance of the round trip.",
    ),
    Definition(
        "warp_psnr", "picture warped to a neighbour", "dB",
        "How alike two neighbouring pictures look when one is warped onto the other by its depth.",
        passes=28.0, warns=22.0, higher_is_better=True, group=BY_DEPTH, bounds=DECIBELS, checks=("frames",),
        advice=_WARP_ADVICE,
        method="PSNR over consistent pixels, median over neighbours.",
    ),
    Definition(
        "warp_worst_psnr", "picture warped, worst pair", "dB",
        "The same likeness for the two neighbours that differ most.",
        passes=24.0, warns=19.0, higher_is_better=True, group=BY_DEPTH, bounds=DECIBELS, checks=("frames",),
        advice="One frame does not fit its neighbours: look at the worst pair and check that picture and camera "
        "belong together.",
        method="PSNR of the worst neighbours.",
    ),
    Definition(
        "warp_long_psnr", "picture warped by about 30 degrees", "dB",
        "How alike two pictures about 30 degrees apart look when one is warped onto the other by its depth.",
        passes=25.0, warns=20.0, higher_is_better=True, group=BY_DEPTH, bounds=DECIBELS, checks=("frames",),
        advice=_WARP_ADVICE,
        method="PSNR between frames 20 to 40 degrees apart, median.",
    ),
)  # fmt: skip
"""Frames against each other by their depth files."""


class PosedPicture(Protocol):
    """A picture with its camera and perhaps a depth map."""

    @property
    def camera(self) -> Camera:
        """Its size is the picture's."""
        ...

    @property
    def image(self) -> np.ndarray:
        """(H, W, 3) uint8 sRGB."""
        ...

    @property
    def depth(self) -> np.ndarray | None:
        """(H, W) Euclidean distance in the poses' unit, NaN where unknown."""
        ...


@dataclass(frozen=True)
class Warp:
    """One frame carried into another by its depth.

    Attributes:
        a, b: Indices; B's picture is warped into A.
        degrees: Angle between them at the middle of attention.
        reach: `short` or `long`.
        result: Of the round trip and the warp.
    """

    a: int
    b: int
    degrees: float
    reach: str
    result: Reprojection


@dataclass(frozen=True)
class FrameWarps:
    """Frames carried into each other.

    Attributes:
        warps: Pairs with depth on both sides.
        worst: (H, W, 3) in [0, 1], the second picture of the pair of lowest PSNR warped onto the first, NaN where it
            was not judged; None without a pair.
        obstacle: Why nothing could be measured; empty otherwise.
    """

    warps: tuple[Warp, ...] = ()
    worst: np.ndarray | None = None
    obstacle: str = ""


def warp_frames(frames: Sequence[PosedPicture]) -> FrameWarps:
    """Carry neighbouring frames, and frames about 30 degrees apart, into each other by their depth."""
    views, scale, obstacle = _depth_views(frames)
    if obstacle:
        return FrameWarps(obstacle=obstacle)
    warps = _warps(frames, views, scale)
    judged = [warp for warp in warps if math.isfinite(warp.result.warp_psnr)]
    if not judged:
        return FrameWarps(warps)
    worst = min(judged, key=lambda warp: warp.result.warp_psnr)
    carried = carry(views[worst.a], views[worst.b])
    return FrameWarps(warps, carried.warp(frames[worst.b].image.astype(np.float32) / 255.0))


def _depth_views(frames: Sequence[PosedPicture]) -> tuple[dict[int, GeometryView], float, str]:
    """Frames with depth in a world whose median depth is `NEUTRAL_DISTANCE`, its factor, and what stands against it.

    The limits across depth steps are lengths, made for a head twelve units away.
    """
    known = {i: frame.depth for i, frame in enumerate(frames) if frame.depth is not None}
    if not known:
        return {}, 1.0, "no frame has a depth_file_path"
    medians = [np.nanmedian(depth) for depth in known.values() if np.isfinite(depth).any()]
    if len(medians) < 2:
        return {}, 1.0, "fewer than two depth files hold any depth"
    centres = np.array([frame.camera.position for frame in frames])
    reach = float(np.median(np.linalg.norm(centres - middle_of_attention([f.camera for f in frames]), axis=1)))
    ratio = float(np.median(medians)) / reach if reach > 0 else math.nan
    if ratio > DEPTH_RATIOS[1] or ratio < DEPTH_RATIOS[0]:
        return (
            {},
            1.0,
            (
                f"depth is {ratio:.3g} times the cameras' distance from what they look at; "
                "give depth_unit_scale_factor, the length of one step in the poses' unit (0.001 where none is given)"
            ),
        )
    scale = NEUTRAL_DISTANCE / float(np.median(medians))
    views = {}
    for i, depth in known.items():
        camera = _scaled(frames[i].camera, scale)
        views[i] = GeometryView(camera, np.isfinite(depth).astype(np.float32), (depth * scale).astype(np.float32))
    return views, scale, ""


def _scaled(camera: Camera, factor: float) -> Camera:
    pose = camera.world_from_camera.copy()
    pose[:3, 3] *= factor
    return replace(camera, world_from_camera=pose)


def _warps(frames: Sequence[PosedPicture], views: dict[int, GeometryView], scale: float) -> tuple[Warp, ...]:
    held = sorted(views)
    cameras = [frames[i].camera for i in held]
    middle = middle_of_attention(cameras)
    toward = np.array([camera.position - middle for camera in cameras])
    toward /= np.maximum(np.linalg.norm(toward, axis=1, keepdims=True), 1e-12)
    angles = np.degrees(np.arccos(np.clip(toward @ toward.T, -1.0, 1.0)))
    short = neighbours(cameras)
    far = [(i, int(np.abs(row - 30.0).argmin())) for i, row in enumerate(angles)]
    long = sorted({(min(p), max(p)) for p in far if LONG_DEGREES[0] <= angles[p] <= LONG_DEGREES[1]})
    out = []
    for reach, pairs in (("short", short), ("long", long)):
        kept = [
            pairs[i] for i in sorted({round(i) for i in np.linspace(0, len(pairs) - 1, min(len(pairs), MOST_PAIRS))})
        ]
        for i, j in kept:
            a, b = held[i], held[j]
            picture_a, picture_b = (frames[k].image.astype(np.float32) / 255.0 for k in (a, b))
            result = reproject(views[a], views[b], 0.001 / scale, picture_a, picture_b)
            out.append(Warp(a, b, float(angles[i, j]), reach, result))
    return tuple(out)
