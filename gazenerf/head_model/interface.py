"""What any parametric head offers: a mesh in the world frame from codes and a gaze."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from gazenerf.geometry import Gaze
from gazenerf.head_model.points import LinearAlbedo, SkinPoints
from gazenerf.subjects import Codes

FACE, EYE_LEFT, EYE_RIGHT, MOUTH, HAIR = 0, 1, 2, 3, 4
"""Values of `HeadMesh.face_part`: skin, the subject's left and right eyeball, teeth with gums and tongue, hair."""

NOT_EYES = FACE, MOUTH, HAIR
"""Parts that belong to the face stream and to the face in label images."""

PICTURE_LABELS = np.array([1, 2, 3, 1, 1], np.uint8)
"""Of each part in label images, where 0 is the background: hair and what is between the lips belong to the face."""


@dataclass(frozen=True)
class HeadMesh:
    """A head with true eyeballs, posed, in the world frame and units (see docs/conventions.md).

    Attributes:
        vertices: (V, 3) float32.
        faces: (F, 3) int32, counter-clockwise seen from outside. Parts share no vertices.
        face_part: (F,) uint8: FACE, EYE_LEFT, EYE_RIGHT, MOUTH or HAIR.
        normals: (V, 3) float32 unit, outward.
        albedo: (V, 3) float32 linear RGB in [0, 1].
        landmarks: Name to (3,); the 68 standard ones are "0".."67", plus "iris_left", "iris_right".
        eye_centres: (2, 3) centres of rotation, left then right (the subject's).
        eye_radius: World units.
        metres_per_unit: Size of a world unit.
        occlusion: (V,) float32 share of the surroundings each vertex sees, None when unknown.
    """

    vertices: np.ndarray
    faces: np.ndarray
    face_part: np.ndarray
    normals: np.ndarray
    albedo: np.ndarray
    landmarks: dict[str, np.ndarray]
    eye_centres: np.ndarray
    eye_radius: float
    metres_per_unit: float = 0.1
    occlusion: np.ndarray | None = None

    def part_faces(self, *parts: int) -> np.ndarray:
        """(F', 3) the faces of some parts, indices into all vertices."""
        return self.faces[np.isin(self.face_part, parts)]


class HeadModel(Protocol):
    """A parametric head."""

    @property
    def code_sizes(self) -> tuple[int, int, int, int]:
        """(identity, expression, texture, illumination)."""
        ...

    @property
    def name(self) -> str:
        """Names the model in files."""
        ...

    @property
    def expression_names(self) -> tuple[str, ...]:
        """Of the expression coefficients; those that are ARKit's mean what ARKit's mean."""
        ...

    @property
    def hair_names(self) -> tuple[str, ...]:
        """Of the hair codes; none of models without hair."""
        ...

    @property
    def landmark_vertices(self) -> np.ndarray:
        """(68,) vertices of the skin that are the standard landmarks."""
        ...

    def eye_centres(self, identity: np.ndarray) -> np.ndarray:
        """(2, 3) centres of rotation of an identity code, left then right, world units; linear in the code."""
        ...

    def mesh(self, codes: Codes, gaze: Gaze) -> HeadMesh:
        """The posed head; lids follow the gaze."""
        ...

    def skin_points(self, vertices: np.ndarray) -> SkinPoints:
        """Vertices (K,) of the skin as a differentiable function of codes and gaze, as `mesh` has them."""
        ...

    def albedo_at(self, vertices: np.ndarray) -> LinearAlbedo:
        """Albedo of vertices (K,) of `mesh`, eyeballs included, as a function of the texture code."""
        ...
