"""Surfaces made manifold and closed, and a count of where they cross themselves."""

from __future__ import annotations

import numpy as np
import trimesh

from gazenerf.export.mesh.rays import ray_scene
from gazenerf.export.mesh.triangles import from_pyvista, joined, to_pyvista

EDGE_END = 1e-3
"""Share of an edge at either end where its own faces are met in single precision."""

RAYS = 2**17
"""Edges that are tested for crossings at a time."""


def repair(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """A manifold copy: every edge has at most two faces, every vertex one fan of them.

    Repeated faces are dropped. Where sheets touch along an edge, faces with the solid between them
    stay together, or with the air where that is not enough, so a closed surface stays closed; faces
    that find no such partner end there. Sheets that touched keep their places and get vertices of
    their own.
    """
    faces = np.asarray(mesh.faces)[mesh.unique_faces()]
    vertices = np.asarray(mesh.vertices)
    for solid in (True, False):
        vertices, faces = _taken_apart(vertices, faces, solid)
    return trimesh.Trimesh(vertices, faces, process=False)


def _taken_apart(vertices: np.ndarray, faces: np.ndarray, solid: bool) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and faces where only partners share vertices."""
    near, far = _partners(vertices, faces, solid)
    first, second = [], []
    for a in range(3):
        for b in range(3):
            same = faces[near, a] == faces[far, b]
            first.append(3 * near[same] + a)
            second.append(3 * far[same] + b)
    group = joined(np.concatenate(first), np.concatenate(second), faces.size)
    _, corner, number = np.unique(group, return_index=True, return_inverse=True)
    return vertices[faces.ravel()[corner]], number.reshape(-1, 3)


def _partners(vertices: np.ndarray, faces: np.ndarray, solid: bool) -> tuple[np.ndarray, np.ndarray]:
    """Pairs of faces (n,), (n,) that go on into each other across an edge."""
    start, end = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    face = np.repeat(np.arange(len(faces)), 3)
    low, high = np.minimum(start, end), np.maximum(start, end)
    edge = np.unique(low.astype(np.int64) * len(vertices) + high, return_inverse=True)[1]
    count = np.bincount(edge)
    order = np.argsort(edge, kind="stable")
    simple = order[count[edge[order]] == 2].reshape(-1, 2)
    near, far = [face[simple[:, 0]]], [face[simple[:, 1]]]
    third = np.roll(faces, -2, axis=1).ravel()
    crowded = order[count[edge[order]] > 2]
    for group in np.split(crowded, np.flatnonzero(np.diff(edge[crowded])) + 1) if len(crowded) else []:
        axis = vertices[high[group[0]]] - vertices[low[group[0]]]
        axis = axis / max(float(np.linalg.norm(axis)), 1e-300)
        arm = vertices[third[group]] - vertices[low[group[0]]]
        side = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
        turned = group[np.argsort(np.arctan2(arm @ np.cross(axis, side), arm @ side), kind="stable")]
        # in this order a face that runs up the edge has the solid before it, one that runs down after it
        up = start[turned] == low[turned]
        other = 1 if solid else -1
        pair = up & ~np.roll(up, other)
        near.append(face[turned[pair]])
        far.append(face[np.roll(turned, other)[pair]])
    return np.concatenate(near), np.concatenate(far)


def close_holes(mesh: trimesh.Trimesh, radius: float) -> trimesh.Trimesh:
    """A copy whose holes up to a radius, world units, are covered with triangles (VTK)."""
    if mesh.is_watertight:
        return mesh
    reach = float(np.linalg.norm(mesh.extents))
    closed = from_pyvista(to_pyvista(mesh).fill_holes(min(radius, reach)))
    if not closed.is_winding_consistent:
        trimesh.repair.fix_winding(closed)
    return closed


def self_intersections(mesh: trimesh.Trimesh) -> int | None:
    """How many faces are pierced by an edge that none of their vertices is on; None without open3d."""
    scene = ray_scene(mesh)
    if scene is None:
        return None
    vertices, faces = np.asarray(mesh.vertices, dtype=np.float64), np.asarray(mesh.faces)
    edges = np.asarray(mesh.edges_unique)
    pierced = np.zeros(len(faces), dtype=bool)
    for begin in range(0, len(edges), RAYS):
        ends = edges[begin : begin + RAYS]
        origin, way = vertices[ends[:, 0]], vertices[ends[:, 1]] - vertices[ends[:, 0]]
        rays = np.concatenate([origin + EDGE_END * way, way], axis=1).astype(np.float32)
        first = scene.cast_rays(rays)["t_hit"].numpy()
        hit = first < 1.0 - 2.0 * EDGE_END  # hardly any: listing all that the few meet is slow
        if not hit.any():
            continue
        ends, origin, way = ends[hit], origin[hit], way[hit]
        found = scene.list_intersections(rays[hit])
        ray, face, t = (found[name].numpy() for name in ("ray_ids", "primitive_ids", "t_hit"))
        near = (t > -0.01) & (t < 1.01)
        ray, face = ray[near].astype(np.int64), face[near].astype(np.int64)
        apart = (faces[face][:, :, None] != ends[ray][:, None, :]).all(axis=(1, 2))
        ray, face = ray[apart], face[apart]
        pierced[face[_pierce(origin[ray], way[ray], vertices[faces[face]])]] = True
    return int(pierced.sum())


def _pierce(origin: np.ndarray, way: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Whether segments from origin (n, 3) along way (n, 3) pass through triangles (n, 3, 3) (Moeller and Trumbore)."""
    one, two = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    p = np.cross(way, two)
    slope = np.einsum("ij,ij->i", one, p)
    scale = np.where(slope == 0, np.inf, slope)
    to = origin - corners[:, 0]
    q = np.cross(to, one)
    u, v, t = (np.einsum("ij,ij->i", a, b) / scale for a, b in ((to, p), (way, q), (two, q)))
    return (slope != 0) & (u > 0) & (v > 0) & (u + v < 1) & (t > 0) & (t < 1)
