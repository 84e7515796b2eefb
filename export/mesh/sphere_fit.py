"""Spheres fitted to the surfaces of eyes."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import trimesh
from scipy.optimize import least_squares
from scipy.spatial import KDTree

from gazenerf.errors import UserError


@dataclass(frozen=True)
class Eyeball:
    """A sphere fitted to one eye, world units.

    Attributes:
        centre: (3,) of rotation.
        radius: Of the sphere.
        residual: RMS distance of the fitted points from the sphere.
        points: How many were fitted.
        covered: Share of the sphere that the eye's surface follows within a tenth of the radius.
    """

    centre: np.ndarray
    radius: float
    residual: float
    points: int
    covered: float


def fit_sphere(points: np.ndarray, scale: float = 0.005, radius: float | None = None) -> Eyeball:
    """A sphere through most of the points (N, 3): soft-L1 geometric distance, then without outliers.

    Args:
        points: World units.
        scale: Distances, world units, beyond which a point counts less.
        radius: Of the sphere where it is known, world units; then only the centre is looked for, from the
            points' front (+Z).

    Raises:
        UserError: fewer than 20 points, or they do not lie on a sphere smaller than their spread allows.
    """
    points = np.asarray(points, dtype=np.float64)
    if len(points) < 20:
        raise UserError("an eye has too few surface points to fit a sphere; raise --resolution")
    if radius is None:
        system = np.concatenate([2.0 * points, np.ones((len(points), 1))], axis=1)
        first = np.linalg.lstsq(system, (points**2).sum(axis=1), rcond=None)[0]
        guess = np.append(first[:3], np.sqrt(max(first[3] + first[:3] @ first[:3], 1e-12)))
    else:
        guess = points.mean(axis=0) - [0.0, 0.0, radius]

    def distance(x: np.ndarray, some: np.ndarray) -> np.ndarray:
        return np.linalg.norm(some - x[:3], axis=1) - (x[3] if radius is None else radius)

    used = points
    for _ in range(3):
        solved = least_squares(distance, guess, loss="soft_l1", f_scale=scale, args=(used,), xtol=1e-12)
        guess = solved.x
        away = np.abs(distance(guess, points))
        used = points[away <= max(3.0 * float(np.median(away)), 0.2 * scale)]
    centre, found = guess[:3], float(abs(guess[3])) if radius is None else radius
    if not np.isfinite(guess).all() or found > 4.0 * float(np.ptp(points, axis=0).max()):
        raise UserError("the eyes volume does not look like spheres; the rig needs a field trained for longer")
    residual = float(np.sqrt(((np.linalg.norm(used - centre, axis=1) - found) ** 2).mean()))
    return Eyeball(centre, found, residual, len(used), _covered(points, centre, found))


def _covered(points: np.ndarray, centre: np.ndarray, radius: float, within: float = 0.1) -> float:
    """Share of a sphere that has a point (N, 3) within `within` radii, seen from its centre under 8 degrees away."""
    away = np.linalg.norm(points - centre, axis=1)
    near = np.abs(away - radius) < within * radius
    if not near.any():
        return 0.0
    even = trimesh.creation.icosphere(3).vertices
    gap, _ = KDTree((points[near] - centre) / away[near, None]).query(even)
    return float((gap < 2.0 * np.sin(np.deg2rad(4.0))).mean())


def fit_eyeballs(eyes: trimesh.Trimesh, front: bool = True) -> tuple[Eyeball, Eyeball]:
    """Spheres fitted to the left and right eye (the subject's) of an eyes mesh, world units.

    Args:
        front: Fit only what faces forward, the part that pictures have shown to the field.

    Raises:
        UserError: an eye is missing or is not round.
    """
    vertices, normals = np.asarray(eyes.vertices), np.asarray(eyes.vertex_normals)
    middle = float(eyes.bounds[:, 0].mean())
    fitted = []
    for side in (vertices[:, 0] > middle, vertices[:, 0] <= middle):
        eye = fit_sphere(vertices[side & (normals[:, 2] > 0.35) if front else side])
        fitted.append(replace(eye, covered=_covered(vertices[side], eye.centre, eye.radius)))
    return fitted[0], fitted[1]
