"""Normals of a density: minus its gradient."""

from __future__ import annotations

import numpy as np
import torch

from gazenerf.field.interface import BoundField, Part

CHUNK = 2**13


def density_normals(
    bound: BoundField, points: np.ndarray, part: Part, radius: float, fallback: np.ndarray
) -> np.ndarray:
    """(V, 3) float64 unit outward normals at world points (V, 3).

    Central differences over `radius` world units average the gradient over that scale. Where the
    density is flat, or points the other way than `fallback` (V, 3), the fallback is taken.
    """
    offsets = radius * np.concatenate([np.eye(3), -np.eye(3)])
    values = np.empty((6, len(points)))
    with torch.no_grad():
        for i, offset in enumerate(offsets):
            moved = torch.from_numpy((points + offset).astype(np.float32))
            values[i] = torch.cat([bound.density(chunk, part) for chunk in moved.split(CHUNK)]).numpy()
    gradient = (values[:3] - values[3:]).T
    length = np.linalg.norm(gradient, axis=1, keepdims=True)
    normals = -gradient / np.maximum(length, 1e-12)
    wrong = (length[:, 0] < 1e-6) | ((normals * fallback).sum(axis=1) < 0)
    normals[wrong] = fallback[wrong]
    return normals
