"""Surfaces of heads for open3d's ray casting, one thread each."""

from __future__ import annotations

from typing import Any

import numpy as np

from gazenerf.geometry import Camera


def ray_scene(vertices: np.ndarray, *parts: np.ndarray) -> Any:
    """A scene of triangles; its geometries are numbered as the parts are given.

    Args:
        vertices: (V, 3).
        parts: (F, 3) indices into them.
    """
    from open3d import t

    scene = t.geometry.RaycastingScene(nthreads=1)
    for faces in parts:
        scene.add_triangles(tensor(vertices), tensor(faces, np.uint32))
    return scene


def tensor(values: np.ndarray, kind: type = np.float32) -> Any:
    """An array as open3d takes it."""
    from open3d import core

    return core.Tensor.from_numpy(np.ascontiguousarray(values, kind))


def rays_of(camera: Camera) -> Any:
    """(H, W, 6) rays through a camera's pixel centres, as open3d casts them."""
    return tensor(np.concatenate(camera.rays(), axis=-1))


def barycentric(found: Any, where: Any = ...) -> np.ndarray:
    """(..., 3) float32 weights of the corners of the triangles that open3d found; arguments as `interpolated`."""
    uv = found["primitive_uvs"].numpy()[where]
    return np.concatenate([1.0 - uv.sum(axis=-1, keepdims=True), uv], axis=-1)


def interpolated(values: np.ndarray, faces: np.ndarray, found: Any, where: Any = ...) -> np.ndarray:
    """(N, C) values (V, C) of vertices where rays or closest points that open3d found lie on faces (F, 3).

    Args:
        values: Of vertices.
        faces: Of the geometry that they lie on.
        found: By open3d.
        where: Which of what was found; all by default.
    """
    corners = faces[found["primitive_ids"].numpy()[where]]
    return (values[corners] * barycentric(found, where)[..., None]).sum(axis=-2)
