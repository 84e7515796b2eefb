"""How the skin about the eyes moves in a picture when the gaze changes, as the head model drives it."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from scipy.sparse import coo_matrix, diags
from scipy.sparse.linalg import splu

from gazenerf.geometry import Camera
from gazenerf.head_model.interface import EYE_LEFT, EYE_RIGHT, FACE, HeadMesh
from gazenerf.head_model.ray_scenes import barycentric, ray_scene, rays_of, tensor

LARGEST_SIDE = 200
"""Pixels: motion is computed in pictures no larger than this, it is smooth."""

SMOOTHING = 0.02
"""Standard deviation of the smoothing of the motion, in picture sides."""

HIDDEN_UNITS = 0.01
"""World units by which something must lie in front of a point to hide it."""


def lid_motion(source: HeadMesh, target: HeadMesh, camera: Camera) -> np.ndarray:
    """Where the skin that a picture shows at the target gaze lies in the picture at the source gaze.

    Each pixel's ray is cast at the head at the target gaze; the same point of the skin at the source gaze is projected.
    Eyeballs, and skin that is hidden at the source gaze (folded behind the lid), take the harmonic continuation of
    what surrounds them.

    Args:
        source, target: One head at two gazes, world frame.
        camera: Of the picture.

    Returns:
        (H, W, 2) float32 pixels, x first, to add to a pixel of the target picture; zero where both heads agree.
    """
    factor = min(1.0, LARGEST_SIDE / max(camera.width, camera.height))
    view = camera.resized(max(2, round(camera.width * factor)), max(2, round(camera.height * factor)))
    face, weights, known = skin_hits(target, view)
    motion = np.zeros((view.height, view.width, 2))
    corners = source.part_faces(FACE)[face[known]]
    before, after = ((mesh.vertices[corners] * weights[known][..., None]).sum(axis=1) for mesh in (source, target))
    moved = view.project(before.astype(np.float64))[0] - view.project(after.astype(np.float64))[0]
    seen = visible(source, view.position, before)
    motion[known] = moved
    known[known] = seen
    if not known.any():
        return np.zeros((camera.height, camera.width, 2), np.float32)
    motion = harmonic_fill(motion, known, np.ones_like(known))
    motion = cv2.GaussianBlur(motion, (0, 0), max(0.5, SMOOTHING * max(view.width, view.height)))
    scale = np.array([camera.width / view.width, camera.height / view.height])
    full = cv2.resize(motion, (camera.width, camera.height), interpolation=cv2.INTER_CUBIC)
    return (full * scale).astype(np.float32)


def skin_hits(mesh: HeadMesh, camera: Camera) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """What of the skin each pixel shows.

    Returns:
        (H, W) indices into `mesh.part_faces(FACE)`, (H, W, 3) barycentric weights, (H, W) bool where skin is seen.
    """
    found = _cast(mesh, camera)
    skin = found["geometry_ids"].numpy() == FACE
    return np.where(skin, found["primitive_ids"].numpy(), 0).astype(np.int64), barycentric(found), skin


def shown_part(mesh: HeadMesh, camera: Camera, part: int) -> np.ndarray:
    """(H, W) bool: the pixels that show FACE, EYE_LEFT or EYE_RIGHT."""
    return _cast(mesh, camera)["geometry_ids"].numpy() == part


def visible(mesh: HeadMesh, position: np.ndarray, points: np.ndarray) -> np.ndarray:
    """(N,) bool: whether nothing of a head hides points (N, 3) from a camera's position (3,)."""
    away = points - position
    distance = np.linalg.norm(away, axis=1)
    rays = np.concatenate([np.broadcast_to(position, away.shape), away / distance[:, None]], axis=1)
    return _scene(mesh).cast_rays(tensor(rays), nthreads=1)["t_hit"].numpy() > distance - HIDDEN_UNITS


def harmonic_fill(values: np.ndarray, known: np.ndarray, domain: np.ndarray) -> np.ndarray:
    """Values continued from where they are known by the smoothest function (Laplace's equation).

    Args:
        values: (H, W, C).
        known: (H, W) bool.
        domain: (H, W) bool, where values are wanted; nothing flows across its border.

    Returns:
        (H, W, C) float64: `values` where known, the continuation elsewhere in the domain, zero outside of it and where
        nothing known is connected.
    """
    known = known & domain
    out = np.where(known[..., None], values, 0.0).astype(np.float64)
    _, labels = cv2.connectedComponents(domain.astype(np.uint8), connectivity=4)
    touched = np.unique(np.asarray(labels)[known])
    unknown = domain & ~known & np.isin(labels, touched)
    index = np.full(domain.shape, -1)
    index[unknown] = np.arange(unknown.sum())
    if not unknown.any():
        return out
    rows, columns, degree = [], [], np.zeros(unknown.sum())
    right = np.zeros((unknown.sum(), values.shape[-1]))
    for axis in (0, 1):
        first, last = [slice(None)] * 2, [slice(None)] * 2
        first[axis], last[axis] = slice(None, -1), slice(1, None)
        for here, there in ((tuple(first), tuple(last)), (tuple(last), tuple(first))):
            joined = unknown[here] & (unknown | known)[there]
            mine, other = index[here][joined], index[there][joined]
            np.add.at(degree, mine, 1.0)
            inner = other >= 0
            rows.append(mine[inner])
            columns.append(other[inner])
            np.add.at(right, mine[~inner], out[there][joined][~inner])
    row, column = np.concatenate(rows), np.concatenate(columns)
    matrix = diags(degree) - coo_matrix((np.ones(len(row)), (row, column)), shape=(len(degree), len(degree)))
    out[unknown] = splu(matrix.tocsc()).solve(right)
    return out


def _cast(mesh: HeadMesh, camera: Camera) -> dict[str, Any]:
    return _scene(mesh).cast_rays(rays_of(camera), nthreads=1)


def _scene(mesh: HeadMesh) -> Any:
    """The head for ray casting; its geometries are numbered as its parts."""
    return ray_scene(mesh.vertices, *(mesh.part_faces(part) for part in (FACE, EYE_LEFT, EYE_RIGHT)))
