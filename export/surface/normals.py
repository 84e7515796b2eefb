"""Normals of a mesh from the density that it was taken from."""

from __future__ import annotations

import numpy as np
import torch

from gazenerf.heads.interface import BoundField, Part
from gazenerf.heads.normals import TETRAHEDRON, density_gradient


def surface_normals(
    bound: BoundField, points: np.ndarray, part: Part, radius: float, fallback: np.ndarray
) -> np.ndarray:
    """(V, 3) float64 unit outward normals at world points (V, 3).

    Where the density is flat within `radius` world units, or its normal points the other way than
    `fallback` (V, 3), the fallback is taken.
    """
    with torch.no_grad():
        gradient = density_gradient(
            lambda places: bound.density(places.float(), part).double(),
            torch.from_numpy(np.asarray(points, dtype=np.float64)),
            radius,
            TETRAHEDRON,
        ).numpy()
    length = np.linalg.norm(gradient, axis=1, keepdims=True)
    normals = -gradient / np.maximum(length, 1e-12)
    wrong = (length[:, 0] < 1e-6) | ((normals * fallback).sum(axis=1) < 0)
    normals[wrong] = fallback[wrong]
    return normals
