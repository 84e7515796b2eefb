"""Views against each other in pairs: depth carried there and back, pictures warped, fine texture followed."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch

from gazenerf.errors import UserError
from gazenerf.geometry import Camera
from gazenerf.heads.interface import Part
from gazenerf.viz.metrics.agreement import eroded
from gazenerf.viz.metrics.definitions import COSINE, DECIBELS, NOT_NEGATIVE, SHARE, Definition, Finding
from gazenerf.viz.metrics.drift import TextureFollow, texture_follow
from gazenerf.viz.metrics.reprojection import Perceptual, Reprojection, carry, reproject
from gazenerf.viz.metrics.stream_views import StreamView

REACHES = {"short": (2.0, 8.0), "long": (24.0, 36.0)}
"""Angles, degrees, between the views of a pair; about 5 and about 30."""

EYE_REGION = 2.0
"""The eye region is surface within so many eyeball radii of an eye's centre."""

MERGED = "Views against each other: the merged picture"
EACH_STREAM = "Views against each other: each stream alone"

_DEPTH_ADVICE = (
    "The surface moves with the viewpoint, so meshes fused from several views will be blurred or double: look at the "
    "pairs with the lowest shares."
)
_WARP_ADVICE = (
    "Texture does not stay on the surface when the camera moves, which shows as swimming or flicker in an orbit: look "
    "at the strips and at the picture's metrics against its volume."
)
_EYES_ADVICE = (
    "The eyes change with the viewpoint, so they will seem to move in an orbit although the gaze is fixed: look at the "
    "strip through the eyes."
)
_REPROJECTION = (
    "The share of the surface that lands on itself when one view is carried into another by its depth and back."
)
_REPROJECTION_METHOD = (
    "Share of co-visible pixels that return within 1 px and with less than 1 % difference in depth, median over pairs"
)


def _stream(part: Part, near: tuple[float, float], far: tuple[float, float]) -> tuple[Definition, ...]:
    advice = _EYES_ADVICE if part == "eyes" else _WARP_ADVICE
    note = ", one pixel inside its own silhouette, since its picture is background around the eyes"
    alone = f"the {part} stream alone{note if part == 'eyes' else ''}"
    found = {"face": (Finding(40.0, 1), None), "eyes": (Finding(27.0, 1), Finding(26.0, 1))}[part]
    return (
        Definition(
            f"reprojection_{part}", f"{part} stream: depth reprojection", "",
            f"The same round trip by depth, for the {part} volume alone.",
            passes=0.95, warns=0.85, higher_is_better=True, group=EACH_STREAM, bounds=SHARE,
            advice=_DEPTH_ADVICE,
            method=f"{_REPROJECTION_METHOD}, of {alone}.",
            finding=Finding(0.985, 3),
        ),
        Definition(
            f"warp_psnr_{part}", f"{part} stream: warped, about 5 degrees", "dB",
            f"How alike two views of the {part} volume's picture, about 5 degrees apart, look on the same surface.",
            passes=near[0], warns=near[1], higher_is_better=True, group=EACH_STREAM, bounds=DECIBELS,
            advice=advice,
            method=f"PSNR, short pairs, of {alone}.",
            finding=found[0],
        ),
        Definition(
            f"warp_long_psnr_{part}", f"{part} stream: warped, about 30 degrees", "dB",
            f"How alike two views of the {part} volume's picture, about 30 degrees apart, look on the same surface.",
            passes=far[0], warns=far[1], higher_is_better=True, group=EACH_STREAM, bounds=DECIBELS,
            advice=advice,
            method=f"PSNR, long pairs, of {alone}.",
            finding=found[1],
        ),
    )  # fmt: skip


DEFINITIONS = (
    Definition(
        "reprojection", "depth reprojection, consistent share", "",
        _REPROJECTION,
        passes=0.95, warns=0.85, higher_is_better=True, group=MERGED, bounds=SHARE,
        advice=_DEPTH_ADVICE,
        method=f"{_REPROJECTION_METHOD}.",
        finding=Finding(0.985, 3),
    ),
    Definition(
        "round_trip_px", "reprojection round trip, median", "px",
        "How far from its start a pixel lands after it is carried into another view by its depth and back.",
        passes=0.3, warns=0.6, group=MERGED, bounds=NOT_NEGATIVE,
        advice=_DEPTH_ADVICE,
        method="Median distance of the round trip.",
        finding=Finding(0.1, 2),
    ),
    Definition(
        "warp_psnr", "picture warped, about 5 degrees", "dB",
        "How alike two pictures about 5 degrees apart look when one is warped onto the other by the field's own depth.",
        passes=30.0, warns=25.0, higher_is_better=True, group=MERGED, bounds=DECIBELS,
        advice=_WARP_ADVICE,
        method="PSNR of B's picture warped into A over consistent pixels, short pairs.",
        finding=Finding(40.0, 1),
    ),
    Definition(
        "warp_ssim", "picture warped, about 5 degrees, SSIM", "",
        "The same likeness by local structure instead of brightness; 1 is identical.",
        passes=0.95, warns=0.9, higher_is_better=True, group=MERGED, bounds=COSINE,
        advice=_WARP_ADVICE,
        method="SSIM of the same; windows see A's own pixels around them.",
    ),
    Definition(
        "warp_long_psnr", "picture warped, about 30 degrees", "dB",
        "How alike two pictures about 30 degrees apart look when one is warped onto the other.",
        passes=26.0, warns=21.0, higher_is_better=True, group=MERGED, bounds=DECIBELS,
        advice=_WARP_ADVICE,
        method="PSNR, long pairs.",
        finding=Finding(40.0, 1),
    ),
    Definition(
        "warp_worst_psnr", "picture warped, worst pair", "dB",
        "The same likeness for the two pictures that differ most.",
        passes=24.0, warns=19.0, higher_is_better=True, group=MERGED, bounds=DECIBELS,
        advice="One view does not fit the others, often at the edge of what was trained: look at the worst pair and "
        "leave that direction out of orbits.",
        method="PSNR of the worst pair.",
        finding=Finding(38.0, 1),
    ),
    Definition(
        "warp_eye_region_psnr", "eye region warped, about 5 degrees", "dB",
        "How alike the eyes and what surrounds them look in two views about 5 degrees apart.",
        passes=26.0, warns=21.0, higher_is_better=True, group=MERGED, bounds=DECIBELS,
        advice=_EYES_ADVICE,
        method="PSNR over surface within two eyeball radii of an eye's centre, short pairs.",
    ),
    Definition(
        "warp_long_eye_region_psnr", "eye region warped, about 30 degrees", "dB",
        "How alike the eyes and what surrounds them look in two views about 30 degrees apart.",
        passes=20.0, warns=16.0, higher_is_better=True, group=MERGED, bounds=DECIBELS,
        advice=_EYES_ADVICE,
        method="PSNR over surface within two eyeball radii of an eye's centre, long pairs.",
        finding=Finding(32.0, 1),
    ),
    *_stream("face", (30.0, 25.0), (26.0, 21.0)),
    *_stream("eyes", (26.0, 21.0), (20.0, 16.0)),
)  # fmt: skip
"""Views of a field against each other in pairs."""


@dataclass(frozen=True)
class PairReading:
    """One view warped into another, for one part.

    Attributes:
        a, b: Names of the views; B is warped into A.
        degrees: Angle between the views.
        reach: `short` (about 5 degrees) or `long` (about 30).
        whole: Over all that both see.
        eye_region: Over surface within `EYE_REGION` eyeball radii of an eye's centre.
    """

    a: str
    b: str
    degrees: float
    reach: str
    whole: Reprojection
    eye_region: Reprojection


def load_perceptual() -> Perceptual | None:
    """LPIPS of two pictures of at least 64 px (NaN below), None where its weights are not installed."""
    from gazenerf.training.perceptual import load_lpips

    try:
        lpips = load_lpips()
    except UserError:
        return None

    def measure(a: np.ndarray, b: np.ndarray) -> float:
        if min(a.shape[:2]) < 64:
            return math.nan
        batches = [torch.from_numpy(np.ascontiguousarray(x, np.float32)).permute(2, 0, 1)[None] for x in (a, b)]
        with torch.no_grad():
            return float(lpips(*batches))

    return measure


def angle_between(a: Camera, b: Camera) -> float:
    """Degrees between two cameras' viewing directions."""
    cosine = float(a.world_from_camera[:3, 2] @ b.world_from_camera[:3, 2])
    return math.degrees(math.acos(min(1.0, max(-1.0, cosine))))


def view_pairs(cameras: Sequence[Camera]) -> list[tuple[int, int, float, str]]:
    """(first, second, degrees, reach) of the pairs of cameras whose angle is in `REACHES`, each once."""
    out = []
    for i, a in enumerate(cameras):
        for j in range(i + 1, len(cameras)):
            degrees = angle_between(a, cameras[j])
            out += [(i, j, degrees, name) for name, (low, high) in REACHES.items() if low <= degrees <= high]
    return out


def measure_pair(
    names: tuple[str, str],
    views: tuple[StreamView, StreamView],
    degrees: float,
    reach: str,
    eyes: tuple[np.ndarray, float],
    metres_per_unit: float,
    perceptual: Perceptual | None = None,
) -> tuple[dict[Part, PairReading], TextureFollow]:
    """Every part of one view against another, and the merged picture's fine texture.

    The eyes stream's picture is background around the eyes, so it is judged one pixel inside the
    eyes' own silhouette.

    Args:
        names: Of the two views; the second is warped into the first.
        eyes: Centres (2, 3) and radius of the eyeballs, world units.
        perceptual: Measures LPIPS of the merged picture.
    """
    a, b = views
    readings: dict[Part, PairReading] = {}
    follow = None
    for part, mine in a.geometry.items():
        other = b.geometry[part]
        carried = carry(mine, other)
        away = np.linalg.norm(carried.points[..., None, :] - eyes[0], axis=-1).min(axis=-1)
        near = np.nan_to_num(away, nan=np.inf) < EYE_REGION * eyes[1]
        where = eroded(np.isfinite(mine.depth)) if part == "eyes" else np.ones_like(near)
        pictures = (a.images[part], b.images[part])
        whole, region = (
            reproject(
                mine, other, metres_per_unit, *pictures, where=mask, carried=carried,
                perceptual=perceptual if part == "head" else None,
            )
            for mask in (where, where & near)
        )  # fmt: skip
        readings[part] = PairReading(*names, degrees, reach, whole, region)
        if part == "head":
            follow = texture_follow(*names, pictures, (mine.depth, other.depth), carried)
    assert follow is not None
    return readings, follow
