"""Normals of a density: minus its gradient."""

from __future__ import annotations

import numpy as np
import torch

from gazenerf.heads.interface import BoundField, Part

CHUNK = 2**13

CORNERS = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]]) / np.sqrt(3.0)
"""Of a tetrahedron, (4, 3) unit vectors: sum over corners of corner x value is 4/3 of a linear function's slope."""


def density_normals(
    bound: BoundField, points: np.ndarray, part: Part, radius: float, fallback: np.ndarray
) -> np.ndarray:
    """(V, 3) float64 unit outward normals at world points (V, 3).

    Differences over the corners of a tetrahedron `radius` world units away average the gradient over
    that scale, where automatic differentiation would show every grain of a trained density. Where it
    is flat, or points the other way than `fallback` (V, 3), the fallback is taken.
    """
    values = np.empty((4, len(points)))
    with torch.no_grad():
        for i, corner in enumerate(CORNERS):
            moved = torch.from_numpy((points + radius * corner).astype(np.float32))
            values[i] = torch.cat([bound.density(chunk, part) for chunk in moved.split(CHUNK)]).numpy()
    gradient = values.T @ CORNERS
    length = np.linalg.norm(gradient, axis=1, keepdims=True)
    normals = -gradient / np.maximum(length, 1e-12)
    wrong = (length[:, 0] < 1e-6) | ((normals * fallback).sum(axis=1) < 0)
    normals[wrong] = fallback[wrong]
    return normals
