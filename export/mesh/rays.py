"""Depth of a mesh along rays and distance to it: by open3d where it can be loaded."""

from __future__ import annotations

from typing import Any

import numpy as np
import trimesh

from gazenerf.export.mesh.triangles import to_pyvista


class RayCaster:
    """Casts rays at one mesh, prepared once. By VTK without open3d.

    Args:
        mesh: What rays meet.
    """

    def __init__(self, mesh: trimesh.Trimesh) -> None:
        self._mesh, self._scene = mesh, ray_scene(mesh)

    def __call__(self, rays_o: np.ndarray, rays_d: np.ndarray) -> np.ndarray:
        """Distance (N,) to the first hit of rays (N, 3), NaN where there is none; world units."""
        if self._scene is None:
            return _cast_vtk(self._mesh, rays_o, rays_d)
        rays = np.empty((len(rays_o), 6), np.float32)
        rays[:, :3], rays[:, 3:] = rays_o, rays_d
        hit = self._scene.cast_rays(rays)["t_hit"].numpy()
        return np.where(np.isfinite(hit), hit.astype(np.float64), np.nan)


def cast_rays(mesh: trimesh.Trimesh, rays_o: np.ndarray, rays_d: np.ndarray) -> np.ndarray:
    """Distance (N,) to the first hit of rays (N, 3), NaN where there is none; world units. See `RayCaster`."""
    return RayCaster(mesh)(rays_o, rays_d)


def nearest_distance(mesh: trimesh.Trimesh, points: np.ndarray) -> np.ndarray:
    """(N,) distance of points (N, 3) to a mesh. By VTK without open3d."""
    scene = ray_scene(mesh)
    if scene is None:
        found: Any = to_pyvista(mesh).find_closest_cell(points, return_closest_point=True)
        return np.linalg.norm(np.asarray(found[1]) - points, axis=1)
    return scene.compute_distance(np.ascontiguousarray(points, dtype=np.float32)).numpy()


def ray_scene(mesh: trimesh.Trimesh) -> Any | None:
    """An open3d scene of one mesh, None where open3d cannot be loaded."""
    try:
        import open3d as o3d
    except (ImportError, OSError):
        return None
    scene = o3d.t.geometry.RaycastingScene()
    tensor = o3d.core.Tensor.from_numpy
    scene.add_triangles(
        tensor(np.ascontiguousarray(mesh.vertices, dtype=np.float32)),
        tensor(np.ascontiguousarray(mesh.faces, dtype=np.uint32)),
    )
    return scene


def _cast_vtk(mesh: trimesh.Trimesh, rays_o: np.ndarray, rays_d: np.ndarray, reach: float = 100.0) -> np.ndarray:
    """The slow route: one ray at a time."""
    surface = to_pyvista(mesh)
    out = np.full(len(rays_o), np.nan)
    for i, (origin, direction) in enumerate(zip(rays_o, rays_d, strict=True)):
        points, _ = surface.ray_trace(origin, origin + reach * direction)
        if np.size(points):
            out[i] = float(np.linalg.norm(np.asarray(points).reshape(-1, 3) - origin, axis=1).min())
    return out
