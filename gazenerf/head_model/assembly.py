"""Skin, two turned eyeballs, what lies behind the lips, and hair become one head mesh."""

from __future__ import annotations

import numpy as np

from gazenerf.geometry import Gaze
from gazenerf.head_model.eyes import build_eye_mesh
from gazenerf.head_model.interface import EYE_LEFT, EYE_RIGHT, FACE, HAIR, MOUTH, HeadMesh
from gazenerf.head_model.lids import lid_shadow
from gazenerf.head_model.mouth import light_behind_lips


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
    mouth: tuple[np.ndarray, np.ndarray, np.ndarray] | None = None,
    hair: tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray] | None = None,
) -> HeadMesh:
    """A head mesh with both eyes at a gaze. Vertices are those of the skin, the eyeballs, the mouth and the hair.

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
        mouth: Vertices (M, 3), faces (F', 3) and albedo (M, 3) of teeth, gums and tongue, where there are any.
        hair: Vertices (N, 3), faces (F'', 3), albedo (N, 3) and share of the surroundings that is seen (N,) of hair,
            where there is any.
    """
    eye = build_eye_mesh()
    eye_albedo = eye.albedo(iris_codes)
    turned = (eye.vertices @ gaze.rotation().T).astype(np.float32)
    count, n_eye = len(skin), len(eye.vertices)
    none = np.zeros((0, 3), np.float32), np.zeros((0, 3), np.int32), np.zeros((0, 3), np.float32)
    behind, behind_faces, behind_albedo = none if mouth is None else mouth
    outside, outside_faces, outside_albedo, outside_light = (*none, np.zeros(0, np.float32)) if hair is None else hair
    balls = [centre + radius * turned for centre in centres]
    vertices = np.concatenate([skin, *balls, behind, outside]).astype(np.float32)
    inner = count + 2 * n_eye
    pieces = [faces, eye.faces + count, eye.faces + count + n_eye, behind_faces + inner]
    pieces.append(outside_faces + inner + len(behind))
    all_faces = np.concatenate(pieces).astype(np.int32)
    landmarks = {str(i): vertices[vertex] for i, vertex in enumerate(marks)}
    landmarks["iris_left"] = vertices[count + eye.iris]
    landmarks["iris_right"] = vertices[count + n_eye + eye.iris]
    shadow = lid_shadow(turned)
    open_share = np.ones(count, np.float32) if occlusion is None else occlusion
    light = [open_share, shadow, shadow, light_behind_lips(behind, skin[marks]), outside_light]
    parts = np.array([FACE, EYE_LEFT, EYE_RIGHT, MOUTH, HAIR], np.uint8)
    return HeadMesh(
        vertices=vertices,
        faces=all_faces,
        face_part=np.repeat(parts, [len(piece) for piece in pieces]),
        normals=vertex_normals(vertices, all_faces),
        albedo=np.concatenate([albedo, eye_albedo, eye_albedo, behind_albedo, outside_albedo]).astype(np.float32),
        landmarks=landmarks,
        eye_centres=centres.astype(np.float64),
        eye_radius=radius,
        metres_per_unit=metres_per_unit,
        occlusion=np.concatenate(light).astype(np.float32),
    )


def vertex_normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """(V, 3) float32 unit normals, faces weighted by area."""
    a, b, c = (vertices[faces[:, i]].astype(np.float64) for i in range(3))
    cross = np.cross(b - a, c - a)
    normals = np.stack(
        [np.bincount(faces.ravel(), np.repeat(cross[:, i], 3), minlength=len(vertices)) for i in range(3)], axis=1
    )
    return (normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)).astype(np.float32)
