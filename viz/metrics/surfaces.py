"""The field's surface against the reference's: distances before and after a rigid fit, the fits, and the eyes."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from gazenerf.evaluation.face_crop import FaceCrop, face_crop
from gazenerf.export.mesh.sphere_fit import fit_sphere
from gazenerf.head_model.interface import EYE_LEFT, EYE_RIGHT, HeadMesh
from gazenerf.viz.metrics.agreement import DepthView
from gazenerf.viz.metrics.definitions import COSINE, NOT_NEGATIVE, SHARE, Definition, Finding
from gazenerf.viz.metrics.error_bars import jackknife
from gazenerf.viz.metrics.surface_agreement import surface_agreement, surface_samples
from gazenerf.viz.metrics.surface_fit import SurfaceSamples, align
from gazenerf.viz.reference.views import ReferenceView

AS_SURFACES = "Field against the reference, as surfaces"
FACE_CROP = "Field against the reference, face crop"
FRAME_AND_EYES = "Frame and eyes"

_FAR = (
    "Parts of the field's surface are not on the head; the error mesh shows where in colour. Train longer, or clean "
    "the mesh before use."
)
_LACKING = (
    "Parts of the head are missing from the field's surface or lie elsewhere; the error mesh shows where in colour, "
    "and a longer training or more views of that side help."
)
_FITTED = (
    "The shape itself is wrong, not just its position, so moving the head will not help: train longer or fit the head "
    "model to the person again."
)
_SCORE = (
    "Too little of the surface is as close as this; if the looser F-scores pass, the surface is rough, else look for "
    "missing or misplaced parts in the error mesh."
)

DEFINITIONS = (
    Definition(
        "surface_accuracy_mm", "accuracy: field to reference", "mm",
        "The mean distance of points on the field's surface from the reference head.",
        passes=1.5, warns=3.0, group=AS_SURFACES, bounds=NOT_NEGATIVE,
        advice=_FAR,
        method="Mean distance of the field's points from the reference.",
    ),
    Definition(
        "surface_completeness_mm", "completeness: reference to field", "mm",
        "The mean distance of points on the reference head from the field's surface.",
        passes=1.5, warns=3.0, group=AS_SURFACES, bounds=NOT_NEGATIVE,
        advice=_LACKING,
        method="Mean distance of the reference's points from the field.",
    ),
    Definition(
        "chamfer_mm", "Chamfer distance", "mm",
        "The mean distance between the field's surface and the reference head, measured both ways.",
        passes=1.5, warns=3.0, group=AS_SURFACES, bounds=NOT_NEGATIVE,
        advice="The surfaces lie apart: if the distance after a rigid fit passes, the head is only misplaced, else "
        "its shape is wrong.",
        method="Mean of accuracy and completeness.",
        finding=Finding(0.3, 2),
    ),
    Definition(
        "chamfer_aligned_mm", "Chamfer distance after a rigid fit", "mm",
        "The same distance after the field's surface is moved and turned onto the reference, so that shape alone "
        "counts.",
        passes=1.0, warns=2.0, group=AS_SURFACES, bounds=NOT_NEGATIVE,
        advice=_FITTED,
        method="Chamfer distance after a rigid fit of the field to the reference.",
        finding=Finding(0.15, 2),
    ),
    Definition(
        "normal_consistency", "normal consistency", "",
        "Whether both surfaces face the same way where they meet; 1 is everywhere the same direction.",
        passes=0.95, warns=0.9, higher_is_better=True, group=AS_SURFACES, bounds=COSINE,
        advice="The surface is bumpier or flatter than the head, which shading shows: smooth the mesh or train longer.",
        method="Mean cosine between normals of nearest points, both ways.",
    ),
    *(
        Definition(
            f"f_score_{limit:g}mm", f"F-score at {limit:g} mm", "",
            f"The share of both surfaces that lies within {limit:g} mm of the other; 1 is all of both.",
            passes=passes, warns=warns, higher_is_better=True, group=AS_SURFACES, bounds=SHARE,
            advice=_SCORE,
            method=f"Harmonic mean of the shares of points, each way, within {limit:g} mm; 0 when both are 0.",
            finding=finding,
        )
        for limit, passes, warns, finding in (
            (1.0, 0.5, 0.3, Finding(0.95, 3)), (2.0, 0.8, 0.6, None), (5.0, 0.95, 0.9, None),
        )
    ),
    Definition(
        "face_accuracy_mm", "face crop, accuracy: field to reference", "mm",
        "The mean distance of the field's surface from the reference within the face alone.",
        passes=1.5, warns=3.0, group=FACE_CROP, bounds=NOT_NEGATIVE,
        advice=_FAR,
        method="Accuracy of the field's points in the crop.",
    ),
    Definition(
        "face_completeness_mm", "face crop, completeness: reference to field", "mm",
        "The mean distance of the reference from the field's surface within the face alone.",
        passes=1.5, warns=3.0, group=FACE_CROP, bounds=NOT_NEGATIVE,
        advice=_LACKING,
        method="Completeness of the reference's points in the crop.",
    ),
    Definition(
        "face_chamfer_mm", "face crop, Chamfer distance", "mm",
        "The mean distance between both surfaces within the face alone, measured both ways.",
        passes=1.5, warns=3.0, group=FACE_CROP, bounds=NOT_NEGATIVE,
        advice="The face is off by more than hair and neck could explain: look at the error mesh, and at the distance "
        "after a rigid fit to tell position from shape.",
        method="Mean of the two.",
        finding=Finding(0.3, 2),
    ),
    Definition(
        "face_chamfer_aligned_mm", "face crop, Chamfer distance after a rigid fit of it", "mm",
        "The same distance after the face is moved and turned onto the reference, so that the face's shape alone "
        "counts.",
        passes=1.0, warns=2.0, group=FACE_CROP, bounds=NOT_NEGATIVE,
        advice=_FITTED,
        method="Chamfer distance after a rigid fit of the crop.",
        finding=Finding(0.15, 2),
    ),
    Definition(
        "frame_shift_mm", "frame shift", "mm",
        "How far the whole head lies from where the reference head is.",
        passes=1.0, warns=2.0, group=FRAME_AND_EYES, bounds=NOT_NEGATIVE,
        advice="The head is misplaced in the world, which shifts everything measured against the reference: check the "
        "cameras of the training data.",
        method="Shift, at the world's origin, of the similarity fit of the field to the reference.",
        finding=Finding(0.3, 2),
    ),
    Definition(
        "frame_turn_deg", "frame turn", "deg",
        "By how much the whole head is turned against the reference head.",
        passes=0.5, warns=1.0, group=FRAME_AND_EYES, bounds=NOT_NEGATIVE,
        advice="The head is turned, so gazes measured in the world are off by as much: check the cameras' poses and "
        "the head-pose convention of the training data.",
        method="Angle of that fit's rotation.",
        finding=Finding(0.25, 2),
    ),
    Definition(
        "scale_percent", "size difference, absolute", "%",
        "By how many per cent the head is larger or smaller than the reference head.",
        passes=1.0, warns=2.0, group=FRAME_AND_EYES, bounds=NOT_NEGATIVE,
        advice="Exported meshes will have a wrong size: check the unit of the data and metres_per_unit of the "
        "checkpoint.",
        method="Absolute difference in size by that fit; `surfaces` in report.json has the sign, positive where the "
        "field is larger.",
        finding=Finding(0.3, 2),
    ),
    Definition(
        "eye_centre_mm", "eyeball centre, the worse eye", "mm",
        "How far the centre of an eyeball lies from the head model's, for the eye that is worse.",
        passes=1.0, warns=2.0, group=FRAME_AND_EYES, bounds=NOT_NEGATIVE,
        advice="The eyes sit elsewhere than in the head model, so the lids will not fit them and the gaze measured by "
        "the iris is biased: fit the head model to the person again.",
        method="Distance between centres of spheres of the head model's eyeball radius, fitted to the field's and to "
        "the reference's points where the reference shows an eye; the worse eye.",
        finding=Finding(0.3, 2),
    ),
)  # fmt: skip
"""Field against the reference as surfaces: distances, in the face crop too, and how field and head model differ."""


NAMES = tuple(definition.name for definition in DEFINITIONS)
"""What `measure_surfaces` gives. Shift and turn are those of a similarity fit, since a rigid one turns a difference in
size into both; `scale_percent` has a sign here, positive where the field is larger."""

LEFT_EYE, RIGHT_EYE = EYE_LEFT + 1, EYE_RIGHT + 1
"""Values of `ReferenceView.parts`."""

MIN_SAMPLES, MIN_EYE_PIXELS = 200, 40


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
        count: Samples of each of the two surfaces.
        seed: Of the samples.

    Returns:
        `NAMES` to value; NaN where too little is seen, or the mesh has no landmarks for a face crop.
    """
    mm = 1000.0 * metres_per_unit
    mine, theirs = surface_samples(views, count, seed), surface_samples(references, count, seed + 1)
    if min(len(mine.points), len(theirs.points)) < MIN_SAMPLES:
        return dict.fromkeys(NAMES, math.nan)
    plain = surface_agreement(mine, theirs, metres_per_unit)
    rigid, similar = align(mine, theirs), align(mine, theirs, scale=True)
    fitted = surface_agreement(mine.moved(rigid), theirs, metres_per_unit)
    return {
        "surface_accuracy_mm": plain.accuracy_mm,
        "surface_completeness_mm": plain.completeness_mm,
        "chamfer_mm": plain.chamfer_mm,
        "chamfer_aligned_mm": fitted.chamfer_mm,
        "normal_consistency": plain.normal_consistency,
        **{f"f_score_{limit}mm": score for limit, score in plain.f_score.items()},
        **_face(mine, theirs, face_crop(mesh), metres_per_unit),
        "frame_shift_mm": float(np.linalg.norm(similar.translation)) * mm,
        "frame_turn_deg": float(np.rad2deg(similar.angle)),
        "scale_percent": 100.0 * (1.0 / similar.scale - 1.0),
        "eye_centre_mm": _eyes_apart(views, references, mesh) * mm,
    }


def _face(
    mine: SurfaceSamples, theirs: SurfaceSamples, crop: FaceCrop | None, metres_per_unit: float
) -> dict[str, float]:
    """The metrics of the face crop; NaN without a crop, or where it holds too few samples."""
    names = ("face_accuracy_mm", "face_completeness_mm", "face_chamfer_mm", "face_chamfer_aligned_mm")
    if crop is None:
        return dict.fromkeys(names, math.nan)
    inside = crop.contains(mine.points)
    if min(inside.sum(), crop.contains(theirs.points).sum()) < MIN_SAMPLES:
        return dict.fromkeys(names, math.nan)
    plain = surface_agreement(mine, theirs, metres_per_unit, crop)
    rigid = align(SurfaceSamples(mine.points[inside], mine.normals[inside]), theirs)
    fitted = surface_agreement(mine.moved(rigid), theirs, metres_per_unit, crop)
    values = (plain.accuracy_mm, plain.completeness_mm, plain.chamfer_mm, fitted.chamfer_mm)
    return dict(zip(names, values, strict=True))


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
        count: Samples of each of the two surfaces.
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
    return {name: jackknife([values[name] for values in found]) for name in NAMES}


def _eyes_apart(views: Sequence[DepthView], references: Sequence[ReferenceView], mesh: HeadMesh) -> float:
    """Largest distance, world units, between an eye's sphere in the field and in the reference, same pixels."""
    worst = float("nan")
    for part in (LEFT_EYE, RIGHT_EYE):
        pairs = []
        for view, reference in zip(views, references, strict=True):
            both = (reference.parts == part) & np.isfinite(view.depth)
            pairs.append([view.camera.unproject(depth)[both] for depth in (view.depth, reference.depth)])
        mine, theirs = (np.concatenate(points) for points in zip(*pairs, strict=True))
        if len(mine) >= MIN_EYE_PIXELS:
            a, b = (fit_sphere(points, radius=mesh.eye_radius).centre for points in (mine, theirs))
            gap = np.linalg.norm(a - b)
            worst = float(np.fmax(worst, gap))
    return worst
