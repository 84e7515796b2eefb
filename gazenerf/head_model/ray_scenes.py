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
