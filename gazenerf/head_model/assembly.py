"""Skin and two turned eyeballs become one head mesh."""

from __future__ import annotations

import numpy as np

from gazenerf.geometry import Gaze
from gazenerf.head_model.eyes import build_eye_mesh
from gazenerf.head_model.interface import EYE_LEFT, EYE_RIGHT, FACE, HeadMesh
from gazenerf.head_model.lids import lid_shadow


def assemble(
    skin: np.ndarray,
    faces: np.ndarray,
    albedo: np.ndarray,
    marks: np.ndarray,
    centres: np.ndarray,
    radius: float,
    iris_codes: np.ndarray,
    gaze: Gaze,
    metres_per_unit: float,
    occlusion: np.ndarray | None = None,
) -> HeadMesh:
    """A head mesh with both eyes at a gaze.

    Args:
        skin: (V, 3) posed skin, world units.
        faces: (F, 3) of the skin.
        albedo: (V, 3) linear RGB of the skin.
        marks: (68,) skin vertices of the standard landmarks.
        centres: (2, 3) centres of rotation, left then right.
        radius: Of the eyeballs.
        iris_codes: (IRIS_CODES,).
        gaze: Head frame.
        metres_per_unit: Size of a world unit.
        occlusion: (V,) share of the surroundings that the skin sees; None counts as all.
    """
    eye = build_eye_mesh()
    eye_albedo = eye.albedo(iris_codes)
    turned = (eye.vertices @ gaze.rotation().T).astype(np.float32)
    count, n_eye = len(skin), len(eye.vertices)
    vertices = np.concatenate([skin, *(centre + radius * turned for centre in centres)]).astype(np.float32)
    all_faces = np.concatenate([faces, eye.faces + count, eye.faces + count + n_eye]).astype(np.int32)
    landmarks = {str(i): vertices[vertex] for i, vertex in enumerate(marks)}
    landmarks["iris_left"] = vertices[count + eye.iris]
    landmarks["iris_right"] = vertices[count + n_eye + eye.iris]
    shadow = lid_shadow(turned)
    open_share = np.ones(count, np.float32) if occlusion is None else occlusion
    parts = np.array([FACE, EYE_LEFT, EYE_RIGHT], np.uint8)
    return HeadMesh(
        vertices=vertices,
        faces=all_faces,
        face_part=np.repeat(parts, [len(faces), len(eye.faces), len(eye.faces)]),
        normals=vertex_normals(vertices, all_faces),
        albedo=np.concatenate([albedo, eye_albedo, eye_albedo]).astype(np.float32),
        landmarks=landmarks,
        eye_centres=centres.astype(np.float64),
        eye_radius=radius,
        metres_per_unit=metres_per_unit,
        occlusion=np.concatenate([open_share, shadow, shadow]).astype(np.float32),
    )


def vertex_normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """(V, 3) float32 unit normals, faces weighted by area."""
    a, b, c = (vertices[faces[:, i]].astype(np.float64) for i in range(3))
    cross = np.cross(b - a, c - a)
    normals = np.stack(
        [np.bincount(faces.ravel(), np.repeat(cross[:, i], 3), minlength=len(vertices)) for i in range(3)], axis=1
    )
    return (normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)).astype(np.float32)
