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
from gazenerf.viz.metrics.drift import TextureFollow, texture_follow
from gazenerf.viz.metrics.reprojection import Perceptual, Reprojection, carry, reproject
from gazenerf.viz.metrics.stream_views import StreamView

REACHES = {"short": (2.0, 8.0), "long": (24.0, 36.0)}
"""Angles, degrees, between the views of a pair; about 5 and about 30."""

EYE_REGION = 2.0
"""The eye region is surface within so many eyeball radii of an eye's centre."""


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
