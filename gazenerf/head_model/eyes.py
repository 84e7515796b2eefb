"""An eyeball: sclera, limbus, iris with radial structure, pupil, and a gently bulging cornea.

Canonical frame: the centre of rotation is the origin, the optical axis is +Z, one unit is the
eyeball's radius. Sizes follow common anatomical means: radius 12 mm, visible iris 11.8 mm across,
pupil 4 mm, corneal apex about 0.5 mm proud of the sphere.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from gazenerf.head_model.lids import smoothstep
from gazenerf.head_model.points import LinearAlbedo

RADIUS_MM = 12.0
IRIS_MM = 5.9
PUPIL_MM = 2.0
CORNEA_BULGE = 0.04
IRIS_CODES = 4
ALBEDO_RANGE = (0.01, 0.95)

CORNEA_AHEAD = 0.47
"""Distance of the centre of the cornea's sphere from the eyeball's centre of rotation, in eyeball radii: 5.6 of 12 mm
(Guestrin and Eizenman 2006, IEEE TBME 53(6), use 7.8 mm for the cornea's radius and 4.2 mm from there to the pupil)."""

IRIS_ANGLE = float(np.arcsin(IRIS_MM / RADIUS_MM))
PUPIL_ANGLE = float(np.arcsin(PUPIL_MM / RADIUS_MM))
RINGS_END = 1.15 * IRIS_ANGLE
"""Angle up to which rings of vertices lie close together."""


@dataclass(frozen=True)
class EyeMesh:
    """The canonical eyeball.

    Attributes:
        vertices: (V, 3) in eyeball radii.
        faces: (F, 3) counter-clockwise from outside.
        mean: (V, 3) linear RGB albedo of the mean eye.
        basis: (IRIS_CODES, V, 3) albedo added per unit of each iris code.
        iris: Index of the vertex at the centre of the pupil.
        ring_angles: (R,) of the rings of vertices about the optical axis, radians; the others are the two poles.
    """

    vertices: np.ndarray
    faces: np.ndarray
    mean: np.ndarray
    basis: np.ndarray
    iris: int
    ring_angles: np.ndarray

    def albedo(self, codes: np.ndarray) -> np.ndarray:
        """(V, 3) linear RGB for iris codes (IRIS_CODES,): brown to blue, green, brightness, warmth."""
        return np.clip(self.mean + np.tensordot(codes, self.basis, 1), *ALBEDO_RANGE).astype(np.float32)


def surface_radius(angles: np.ndarray) -> np.ndarray:
    """Distance of the surface from the centre, in eyeball radii, at angles (...) from the optical axis."""
    return 1.0 + CORNEA_BULGE * (1.0 - smoothstep(0.0, 1.1 * IRIS_ANGLE, angles))


def reflecting_normals(places: np.ndarray, axis: np.ndarray) -> np.ndarray:
    """Normals by which an eye reflects: those of a human cornea over the iris, those of the ball around it.

    Args:
        places: (N, 3) on the surface, from the eyeball's centre, in eyeball radii.
        axis: (3,) unit, where the eye looks.

    Returns:
        (N, 3) unit.
    """
    outward = places / np.linalg.norm(places, axis=1, keepdims=True)
    cornea = places - CORNEA_AHEAD * axis
    cornea = cornea / np.linalg.norm(cornea, axis=1, keepdims=True)
    angle = np.arccos(np.clip(outward @ axis, -1.0, 1.0))
    white = smoothstep(0.95 * IRIS_ANGLE, 1.1 * IRIS_ANGLE, angle)[:, None]
    mixed = cornea + white * (outward - cornea)
    return mixed / np.linalg.norm(mixed, axis=1, keepdims=True)


@lru_cache(maxsize=1)
def build_eye_mesh(around: int = 64) -> EyeMesh:
    """The canonical eyeball, about 3,600 vertices, dense over the iris.

    Args:
        around: Vertices per ring.
    """
    angles = np.concatenate(
        [
            np.linspace(0.0, RINGS_END, 32)[1:],
            np.linspace(RINGS_END, np.pi, 26)[1:-1],
        ]
    )
    turn = 2.0 * np.pi * np.arange(around) / around
    theta = np.concatenate([[0.0], np.repeat(angles, around), [np.pi]])
    phi = np.concatenate([[0.0], np.tile(turn, len(angles)), [0.0]])
    vertices = surface_radius(theta)[:, None] * np.stack(
        [np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=1
    )
    faces = []
    last = len(theta) - 1
    for j in range(around):
        k = (j + 1) % around
        faces.append([0, 1 + j, 1 + k])
        for ring in range(len(angles) - 1):
            a, b = 1 + ring * around, 1 + (ring + 1) * around
            faces += [[a + j, b + j, b + k], [a + j, b + k, a + k]]
        base = 1 + (len(angles) - 1) * around
        faces.append([base + j, last, base + k])
    mean, basis = _eye_albedo(theta, phi)
    return EyeMesh(
        vertices.astype(np.float32), np.array(faces, np.int32), mean.astype(np.float32), basis.astype(np.float32), 0,
        angles,
    )  # fmt: skip


def with_eye_albedo(
    mean: np.ndarray,
    basis: np.ndarray,
    limits: tuple[float, float],
    vertices: np.ndarray,
    mouth: np.ndarray | None = None,
) -> LinearAlbedo:
    """Albedo of vertices (K,) of a mesh that `assemble` made.

    Args:
        mean, basis: (V, 3) and (T, V, 3) of the skin.
        limits: To which the skin's albedo is clipped.
        vertices: Of skin, eyeballs and mouth.
        mouth: (M, 3) albedo of what lies behind the lips, whatever the texture code; None where there is nothing.
    """
    eye = build_eye_mesh()
    first = len(mean) + 2 * len(eye.vertices)
    skin, behind = vertices < len(mean), vertices >= first
    ball = ~(skin | behind)
    on_eye = (vertices[ball] - len(mean)) % len(eye.vertices)
    found = np.zeros((len(basis) + IRIS_CODES, len(vertices), 3), np.float32)
    found[: len(basis), skin] = basis[:, vertices[skin]]
    found[len(basis) :, ball] = eye.basis[:, on_eye]
    means = np.zeros((len(vertices), 3), np.float32)
    means[skin], means[ball] = mean[vertices[skin]], eye.mean[on_eye]
    if mouth is not None:
        means[behind] = mouth[vertices[behind] - first]
    lowest, highest = (np.where(skin, ours, theirs)[:, None] for ours, theirs in zip(limits, ALBEDO_RANGE, strict=True))
    return LinearAlbedo(means, found, lowest, highest)


def _eye_albedo(theta: np.ndarray, phi: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(5)
    radial = sum(rng.normal() * np.cos(k * phi + rng.uniform(0, 2 * np.pi)) for k in rng.integers(7, 30, 14)) / np.sqrt(
        14
    )
    place = np.clip((theta - PUPIL_ANGLE) / (IRIS_ANGLE - PUPIL_ANGLE), 0.0, 1.0)
    collarette = np.exp(-(((place - 0.3) / 0.12) ** 2))
    iris = smoothstep(PUPIL_ANGLE * 0.9, PUPIL_ANGLE * 1.1, theta) * (
        1.0 - smoothstep(IRIS_ANGLE * 0.94, IRIS_ANGLE * 1.03, theta)
    )
    pupil = 1.0 - smoothstep(PUPIL_ANGLE * 0.9, PUPIL_ANGLE * 1.1, theta)
    limbus = np.exp(-(((theta - IRIS_ANGLE * 0.96) / (0.09 * IRIS_ANGLE)) ** 2))
    sclera = np.clip(1.0 - iris - pupil, 0.0, 1.0)
    pink = smoothstep(0.9, 1.9, theta)
    white = np.array([0.72, 0.67, 0.63]) - pink[:, None] * np.array([0.04, 0.16, 0.16])
    structure = (1.0 + 0.35 * radial * (0.3 + 0.7 * place) + 0.35 * collarette)[:, None]
    brown = np.array([0.15, 0.085, 0.045])
    shade = (1.0 - 0.75 * limbus)[:, None]
    mean = sclera[:, None] * white + (iris[:, None] * brown * structure + pupil[:, None] * 0.006)
    mean = mean * shade + 0.01
    inside = iris[:, None] * shade
    tint = np.array([[0.0, 0.11, 0.20], [0.0, 0.07, -0.01], [0.05, 0.05, 0.05], [0.06, 0.02, -0.01]])
    mix = [structure, structure * (0.5 + 0.5 * place)[:, None], structure, (0.3 + collarette)[:, None]]
    return mean, np.stack([inside * colour * weight for colour, weight in zip(tint, mix, strict=True)])
