"""Catmull-Clark subdivision as a sparse matrix, so that a fine mesh stays linear in a coarse one."""

from __future__ import annotations

import numpy as np
from scipy import sparse


def catmull_clark(quads: np.ndarray, vertices: int) -> tuple[sparse.csr_matrix, np.ndarray]:
    """One level of Catmull-Clark subdivision of a quad mesh (boundary edges stay sharp curves).

    Args:
        quads: (Q, 4) vertex indices.
        vertices: Number of vertices.

    Returns:
        matrix (V', V) that maps coarse positions to fine ones, and the fine quads (4Q, 4).
    """
    count = len(quads)
    corners = np.stack([quads, np.roll(quads, -1, axis=1)], axis=-1).reshape(-1, 2)
    edges, inverse, uses = np.unique(np.sort(corners, axis=1), axis=0, return_inverse=True, return_counts=True)
    inverse = inverse.reshape(count, 4)
    face_rows = np.repeat(np.arange(count), 4)
    face_points = sparse.csr_matrix((np.full(4 * count, 0.25), (face_rows, quads.ravel())), (count, vertices))
    ends = sparse.csr_matrix(
        (np.ones(2 * len(edges)), (np.repeat(np.arange(len(edges)), 2), edges.ravel())), (len(edges), vertices)
    )
    touching = sparse.csr_matrix((np.ones(4 * count), (inverse.ravel(), face_rows)), (len(edges), count))
    inner = uses == 2
    edge_points = sparse.diags(np.where(inner, 0.25, 0.5)) @ ends + sparse.diags(np.where(inner, 0.25, 0.0)) @ (
        touching @ face_points
    )
    faces_of = sparse.csr_matrix((np.ones(4 * count), (quads.ravel(), face_rows)), (vertices, count))
    valence = np.maximum(np.asarray(faces_of.sum(axis=1)).ravel(), 1.0)
    middles = 0.5 * ends
    edges_of = ends.T.tocsr()
    degree = np.maximum(np.asarray(edges_of.sum(axis=1)).ravel(), 1.0)
    smooth = (
        sparse.diags(1.0 / valence**2) @ (faces_of @ face_points)
        + sparse.diags(2.0 / (valence * degree)) @ (edges_of @ middles)
        + sparse.diags((valence - 3.0) / valence)
    )
    rim_edges = sparse.diags(np.where(inner, 0.0, 1.0)) @ ends
    on_rim = np.asarray(ends.T @ (~inner).astype(float)).ravel() > 0
    rim = 0.75 * sparse.identity(vertices) + 0.125 * (
        rim_edges.T @ ends - sparse.diags(np.asarray(rim_edges.sum(axis=0)).ravel())
    )
    moved = sparse.diags(np.where(on_rim, 0.0, 1.0)) @ smooth + sparse.diags(np.where(on_rim, 1.0, 0.0)) @ rim
    matrix = sparse.csr_matrix(sparse.vstack([moved, edge_points, face_points]))
    edge_index = vertices + inverse
    face_index = vertices + len(edges) + np.arange(count)
    fine = np.stack(
        [np.stack([quads[:, i], edge_index[:, i], face_index, edge_index[:, i - 1]], axis=1) for i in range(4)],
        axis=1,
    ).reshape(-1, 4)
    return matrix, fine


def subdivide(quads: np.ndarray, vertices: int, levels: int) -> tuple[sparse.csr_matrix, np.ndarray]:
    """Several levels at once: matrix (V', V) and the fine quads."""
    matrix, count = sparse.csr_matrix(sparse.identity(vertices)), vertices
    for _ in range(levels):
        step, quads = catmull_clark(quads, count)
        matrix, count = sparse.csr_matrix(step @ matrix), len(step.indptr) - 1
    return matrix, quads


def triangles(quads: np.ndarray) -> np.ndarray:
    """(2Q, 3) triangles of quads."""
    return np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
