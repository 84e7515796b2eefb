"""Two surfaces compared as points with normals, before and after a rigid fit.

The points are what the views show: each pixel's depth along its ray. A surface that no view shows is
not judged.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import KDTree

from gazenerf.evaluation.face_crop import FaceCrop, face_crop
from gazenerf.head_model.interface import EYE_LEFT, EYE_RIGHT, HeadMesh
from gazenerf.viz.metrics.agreement import DepthView, eroded
from gazenerf.viz.metrics.error_bars import jackknife
from gazenerf.viz.metrics.surface_fit import SurfaceSamples, align
from gazenerf.viz.reference.views import ReferenceView

F_LIMITS_MM = (1.0, 2.0, 5.0)
"""Distances of the F-score."""

SURFACE_GAUGES = (
    "surface_accuracy_mm",
    "surface_completeness_mm",
    "chamfer_mm",
    "normal_consistency",
    *(f"f_score_{limit:g}mm" for limit in F_LIMITS_MM),
    "chamfer_aligned_mm",
    "face_accuracy_mm",
    "face_completeness_mm",
    "face_chamfer_mm",
    "face_chamfer_aligned_mm",
    "frame_shift_mm",
    "frame_turn_deg",
    "scale_percent",
    "eye_centre_mm",
)
"""What `measure_surfaces` gives: distances without alignment, the Chamfer distance after a rigid fit, the
same in the NoW face crop, the shift (at the world's origin), turn and size of a similarity fit, and how
far the worse eye's sphere is from the reference's. The size is by how many per cent the field is larger
than the reference. Shift and turn are the similarity's, since a rigid fit turns a difference of size into
both."""

LEFT_EYE, RIGHT_EYE = EYE_LEFT + 1, EYE_RIGHT + 1
"""Values of `ReferenceView.parts`."""

MIN_SAMPLES, MIN_EYE_PIXELS = 200, 40


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
        seen = eroded(np.isfinite(view.depth))
        seen &= np.isfinite(view.normals).all(axis=-1)
        rays_o, rays_d = view.camera.rays()
        points.append(rays_o[seen] + view.depth[seen][:, None] * rays_d[seen])
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

    The distance of a point is that to the tangent plane of the nearest sample within three sample
    spacings, and to the sample beyond.

    Args:
        crop: Judge points inside it only; each side is still measured to the whole of the other.
    """
    there, cosine_there = _distances(field.points, field.normals, reference)
    back, cosine_back = _distances(reference.points, reference.normals, field)
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


def _distances(points: np.ndarray, normals: np.ndarray, surface: SurfaceSamples) -> tuple[np.ndarray, np.ndarray]:
    """Distances (N,) of points from a surface, and cosines (N,) between the normals."""
    tree = KDTree(surface.points)
    gap, nearest = tree.query(points)
    some = surface.points[:: max(1, len(surface.points) // 500)]
    spacing = float(np.median(np.asarray(tree.query(some, k=2)[0])[:, 1]))
    gap, nearest = np.asarray(gap), np.asarray(nearest)
    planes = np.abs(((points - surface.points[nearest]) * surface.normals[nearest]).sum(-1))
    cosine = (normals * surface.normals[nearest]).sum(-1)
    return np.where(gap <= 3.0 * spacing + planes, np.minimum(planes, gap), gap), cosine


def measure_surfaces(
    views: Sequence[DepthView],
    references: Sequence[ReferenceView],
    mesh: HeadMesh,
    metres_per_unit: float,
    *,
    count: int = 100_000,
    seed: int = 0,
) -> dict[str, float]:
    """Surface distances as the frames are and after a rigid fit, the fits themselves, and the eyes' centres.

    Args:
        views: The field's, with normals.
        references: Of the same cameras.
        mesh: What the references show.
        count: Samples a side.
        seed: Of the samples.

    Returns:
        `SURFACE_GAUGES` to value; NaN where too little is seen, or the mesh has no landmarks for a face crop.
    """
    mm = 1000.0 * metres_per_unit
    mine, theirs = surface_samples(views, count, seed), surface_samples(references, count, seed + 1)
    if min(len(mine.points), len(theirs.points)) < MIN_SAMPLES:
        return dict.fromkeys(SURFACE_GAUGES, float("nan"))
    plain = surface_agreement(mine, theirs, metres_per_unit)
    rigid, similar = align(mine, theirs), align(mine, theirs, scale=True)
    fitted = surface_agreement(mine.moved(rigid), theirs, metres_per_unit)
    values = (
        plain.accuracy_mm, plain.completeness_mm, plain.chamfer_mm, plain.normal_consistency,
        *(plain.f_score[f"{limit:g}"] for limit in F_LIMITS_MM),
        fitted.chamfer_mm,
        *_face(mine, theirs, face_crop(mesh), metres_per_unit),
        float(np.linalg.norm(similar.translation)) * mm,
        float(np.rad2deg(similar.angle)),
        100.0 * (1.0 / similar.scale - 1.0),
        _eyes_apart(views, references, mesh) * mm,
    )  # fmt: skip
    return dict(zip(SURFACE_GAUGES, values, strict=True))


def _face(
    mine: SurfaceSamples, theirs: SurfaceSamples, crop: FaceCrop | None, metres_per_unit: float
) -> tuple[float, float, float, float]:
    """Accuracy, completeness and Chamfer distance in the face crop, and the last after a rigid fit of the crop, mm."""
    nothing = float("nan")
    if crop is None:
        return nothing, nothing, nothing, nothing
    inside = crop.contains(mine.points)
    if min(inside.sum(), crop.contains(theirs.points).sum()) < MIN_SAMPLES:
        return nothing, nothing, nothing, nothing
    plain = surface_agreement(mine, theirs, metres_per_unit, crop)
    rigid = align(SurfaceSamples(mine.points[inside], mine.normals[inside]), theirs)
    fitted = surface_agreement(mine.moved(rigid), theirs, metres_per_unit, crop)
    return plain.accuracy_mm, plain.completeness_mm, plain.chamfer_mm, fitted.chamfer_mm


def surface_errors(
    views: Sequence[DepthView],
    references: Sequence[ReferenceView],
    mesh: HeadMesh,
    metres_per_unit: float,
    *,
    groups: int = 4,
    count: int = 10_000,
    seed: int = 0,
) -> dict[str, float]:
    """Half widths of the 95 % intervals of `measure_surfaces`: every n-th view left out in turn, other samples each.

    Args:
        groups: In how many parts the views are split; NaN for fewer than two views.
        count: Samples a side.
    """
    groups = min(groups, len(views))
    found = [
        measure_surfaces(
            [view for i, view in enumerate(views) if i % groups != left_out],
            [view for i, view in enumerate(references) if i % groups != left_out],
            mesh, metres_per_unit, count=count, seed=seed + 2 * left_out + 2,
        )
        for left_out in range(groups if groups > 1 else 0)
    ]  # fmt: skip
    return {name: jackknife([values[name] for values in found]) for name in SURFACE_GAUGES}


def _eyes_apart(views: Sequence[DepthView], references: Sequence[ReferenceView], mesh: HeadMesh) -> float:
    """Largest distance, world units, between an eye's sphere in the field and in the reference, same pixels."""
    worst = float("nan")
    for part in (LEFT_EYE, RIGHT_EYE):
        pairs = []
        for view, reference in zip(views, references, strict=True):
            both = (reference.parts == part) & np.isfinite(view.depth)
            rays_o, rays_d = view.camera.rays()
            pairs.append(
                [rays_o[both] + depth[both][:, None] * rays_d[both] for depth in (view.depth, reference.depth)]
            )
        mine, theirs = (np.concatenate(points) for points in zip(*pairs, strict=True))
        if len(mine) >= MIN_EYE_PIXELS:
            gap = np.linalg.norm(sphere_centre(mine, mesh.eye_radius) - sphere_centre(theirs, mesh.eye_radius))
            worst = float(np.fmax(worst, gap))
    return worst


def sphere_centre(points: np.ndarray, radius: float, iterations: int = 30) -> np.ndarray:
    """(3,) centre of the sphere of a known radius through points (N, 3) of its front.

    Least squares; after five steps, points farther from the sphere than three times the median and
    5 % of the radius are left out, so that some lid among the points does not pull it.

    Args:
        points: At least three, world units.
        radius: World units.
        iterations: Gauss-Newton steps.
    """
    centre = points.mean(axis=0) - np.array([0.0, 0.0, radius])
    for i in range(iterations):
        offsets = points - centre
        length = np.linalg.norm(offsets, axis=1)
        error = radius - length
        kept = np.abs(error) <= max(3.0 * float(np.median(np.abs(error))), 0.05 * radius) if i >= 5 else slice(None)
        step, *_ = np.linalg.lstsq(-(offsets / length[:, None])[kept], error[kept], rcond=None)
        centre = centre + step
        if i >= 5 and np.abs(step).max() < 1e-9:
            break
    return centre
