"""Two surfaces compared as points with normals.

The points are what the views show: each pixel's depth along its ray. A surface that no view shows is
not judged.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gazenerf.evaluation.face_crop import FaceCrop
from gazenerf.evaluation.surface import SurfaceDistance
from gazenerf.viz.metrics.agreement import DepthView, eroded
from gazenerf.viz.metrics.surface_fit import SurfaceSamples

F_LIMITS_MM = (1.0, 2.0, 5.0)
"""Distances of the F-score."""


@dataclass(frozen=True)
class SurfaceAgreement:
    """How far two surfaces are apart.

    Attributes:
        accuracy_mm: Mean distance from the field's points to the reference's surface.
        completeness_mm: Mean distance from the reference's points to the field's surface.
        chamfer_mm: Mean of the two.
        normal_consistency: Mean cosine between normals of nearest points, both ways.
        f_score: Limit in mm to F-score in [0, 1]; 0 when precision and recall are both 0.
    """

    accuracy_mm: float
    completeness_mm: float
    chamfer_mm: float
    normal_consistency: float
    f_score: dict[str, float]


def surface_samples(views: Sequence[DepthView], count: int, seed: int = 0) -> SurfaceSamples:
    """At most `count` random points of what views show, one pixel inside their silhouettes.

    Args:
        views: With depth and normals.
        count: Most points to keep.
        seed: Of the choice.
    """
    points, normals = [], []
    for view in views:
        if view.normals is None:
            raise ValueError("surface samples need views with normals")
        seen = eroded(np.isfinite(view.depth)) & np.isfinite(view.normals).all(axis=-1)
        points.append(view.camera.unproject(view.depth)[seen])
        normals.append(view.normals[seen].astype(np.float64))
    stacked, directions = np.concatenate(points), np.concatenate(normals)
    if len(stacked) > count:
        chosen = np.random.default_rng(seed).choice(len(stacked), count, replace=False)
        stacked, directions = stacked[chosen], directions[chosen]
    return SurfaceSamples(stacked, directions)


def surface_agreement(
    field: SurfaceSamples, reference: SurfaceSamples, metres_per_unit: float, crop: FaceCrop | None = None
) -> SurfaceAgreement:
    """Distances both ways between surfaces of at least one sample each.

    Distances are those of `gazenerf.evaluation.surface.SurfaceDistance`.

    Args:
        field, reference: Their samples, world units.
        metres_per_unit: Of the world.
        crop: Judge points inside it only; each side is still measured to the whole of the other.
    """
    there, cosine_there = _distances(field, reference)
    back, cosine_back = _distances(reference, field)
    if crop is not None:
        mine, theirs = crop.contains(field.points), crop.contains(reference.points)
        there, cosine_there, back, cosine_back = there[mine], cosine_there[mine], back[theirs], cosine_back[theirs]
    there, back = 1000.0 * metres_per_unit * there, 1000.0 * metres_per_unit * back
    scores = {}
    for limit in F_LIMITS_MM:
        precision, recall = float((there <= limit).mean()), float((back <= limit).mean())
        both = precision + recall
        scores[f"{limit:g}"] = 2.0 * precision * recall / both if both > 0 else 0.0
    accuracy, completeness = float(there.mean()), float(back.mean())
    cosine = 0.5 * float(cosine_there.mean() + cosine_back.mean())
    return SurfaceAgreement(accuracy, completeness, 0.5 * (accuracy + completeness), cosine, scores)


def _distances(samples: SurfaceSamples, surface: SurfaceSamples) -> tuple[np.ndarray, np.ndarray]:
    """Distances (N,) of samples from a surface, and cosines (N,) between the normals."""
    distances, normals = SurfaceDistance(surface.points, surface.normals).measure(samples.points)
    return distances, (samples.normals * normals).sum(-1)
