"""What the subject's head model says of an exported mesh."""

from __future__ import annotations

import numpy as np
import trimesh

from gazenerf.evaluation.face_crop import face_crop
from gazenerf.export.mesh.rays import nearest_distance
from gazenerf.head_model.interface import NOT_EYES, HeadMesh

POINTS = 50_000
"""Points spread over a surface whose distances are taken."""


def distance_in_face_crop(mesh: trimesh.Trimesh, reference: HeadMesh) -> float:
    """Median distance, world units, of a surface to the head model's face, within the face crop.

    Args:
        mesh: World units.
        reference: The head model; the crop is `gazenerf.evaluation.face_crop`'s.

    Returns:
        NaN where no part of the surface lies in the crop, or the model has no landmarks.
    """
    crop = face_crop(reference)
    if crop is None:
        return float("nan")
    points = np.asarray(trimesh.sample.sample_surface(mesh, POINTS, seed=0)[0])
    points = points[crop.contains(points)]
    if not len(points):
        return float("nan")
    face = trimesh.Trimesh(reference.vertices, reference.part_faces(*NOT_EYES), process=False)
    return float(np.median(nearest_distance(face, points)))
