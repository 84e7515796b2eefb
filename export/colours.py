"""Vertex colours baked from rendered views, blended by angle and visibility."""

from __future__ import annotations

import cv2
import numpy as np
import trimesh
from scipy.spatial import KDTree

from export.raycast import cast_rays
from gazenerf.field.interface import BoundField, Part
from gazenerf.geometry import Camera

VIEWS = ((0, 0), (30, 0), (-30, 0), (60, 10), (-60, 10), (0, 25), (0, -25), (90, 0), (-90, 0), (150, 5), (-150, 5))
"""Yaw and pitch, degrees, of the views that colours are taken from."""


def bake_vertex_colours(
    bound: BoundField, mesh: trimesh.Trimesh, part: Part, size: int = 512
) -> tuple[np.ndarray, float]:
    """Colour every vertex from pictures of its own part.

    A view counts with the third power of the cosine between its ray and the normal, where nothing
    lies in between. Vertices that no view sees take the colour of the nearest one that is seen.

    Returns:
        (V, 3) uint8 sRGB, and the share of vertices that some view sees.
    """
    vertices, normals = np.asarray(mesh.vertices), np.asarray(mesh.vertex_normals)
    total, weight = np.zeros((len(vertices), 3)), np.zeros(len(vertices))
    for yaw, pitch in VIEWS:
        camera = Camera.orbit(float(np.deg2rad(yaw)), float(np.deg2rad(pitch)), size=size)
        image = bound.render(camera, (part,)).images[part]
        offset = vertices - camera.position
        distance = np.linalg.norm(offset, axis=1)
        direction = offset / distance[:, None]
        facing = -(direction * normals).sum(axis=1)
        near = np.flatnonzero(facing > 0.15)
        hit = cast_rays(mesh, np.broadcast_to(camera.position, (len(near), 3)), direction[near])
        near = near[np.abs(hit - distance[near]) < 0.02]
        pixels, _ = camera.project(vertices[near])
        colour = cv2.remap(
            image.astype(np.float32),
            (pixels[:, 0] - 0.5).astype(np.float32)[None],
            (pixels[:, 1] - 0.5).astype(np.float32)[None],
            cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_REPLICATE,
        )[0]
        share = facing[near] ** 3
        total[near] += share[:, None] * colour
        weight[near] += share
    seen = weight > 1e-6
    if seen.any():
        total[seen] /= weight[seen, None]
        if not seen.all():
            _, nearest = KDTree(vertices[seen]).query(vertices[~seen])
            total[~seen] = total[seen][nearest]
    return np.clip(np.round(255.0 * total), 0, 255).astype(np.uint8), float(seen.mean())


def vertex_colours(mesh: trimesh.Trimesh) -> np.ndarray | None:
    """(V, 4) uint8 sRGB, None where the mesh has none."""
    visual = mesh.visual
    if visual is None or visual.kind != "vertex":
        return None
    return np.asarray(visual.vertex_colors)  # pyright: ignore[reportAttributeAccessIssue]


def linear_from_srgb(colours: np.ndarray) -> np.ndarray:
    """Linear light from sRGB values in [0, 1] (IEC 61966-2-1)."""
    return np.where(colours <= 0.04045, colours / 12.92, ((colours + 0.055) / 1.055) ** 2.4)
