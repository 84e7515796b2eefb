"""Normals of a mesh as it is, so that light falls on it as its triangles lie."""

from __future__ import annotations

import numpy as np
import trimesh


def vertex_normals(mesh: trimesh.Trimesh) -> np.ndarray:
    """(V, 3) float64 unit normals: the mean of the faces around a vertex, weighted by their angles there.

    Where faces have no area or cancel out, the direction from the middle of the mesh is taken.
    """
    fresh = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)  # a mesh may carry other normals
    normals = np.array(fresh.vertex_normals, dtype=np.float64)
    bad = ~(np.abs(np.linalg.norm(normals, axis=1) - 1.0) < 1e-3)
    if bad.any():
        away = np.asarray(mesh.vertices)[bad] - np.asarray(mesh.bounds).mean(axis=0)
        length = np.linalg.norm(away, axis=1, keepdims=True)
        normals[bad] = np.where(length > 0.0, away / np.where(length > 0.0, length, 1.0), [0.0, 0.0, 1.0])
    return normals
