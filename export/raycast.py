"""Depth of a mesh along rays: open3d where it can be loaded, VTK else."""

from __future__ import annotations

import numpy as np
import trimesh


def cast_rays(mesh: trimesh.Trimesh, rays_o: np.ndarray, rays_d: np.ndarray) -> np.ndarray:
    """Distance (N,) to the first hit of rays (N, 3), NaN where there is none; world units."""
    try:
        import open3d as o3d
    except (ImportError, OSError):
        return _cast_vtk(mesh, rays_o, rays_d)
    scene = o3d.t.geometry.RaycastingScene()
    tensor = o3d.core.Tensor.from_numpy
    scene.add_triangles(
        tensor(np.ascontiguousarray(mesh.vertices, dtype=np.float32)),
        tensor(np.ascontiguousarray(mesh.faces, dtype=np.uint32)),
    )
    rays = tensor(np.concatenate([rays_o, rays_d], axis=1).astype(np.float32))
    hit = scene.cast_rays(rays)["t_hit"].numpy().astype(np.float64)
    return np.where(np.isfinite(hit), hit, np.nan)


def _cast_vtk(mesh: trimesh.Trimesh, rays_o: np.ndarray, rays_d: np.ndarray, reach: float = 100.0) -> np.ndarray:
    """The slow route: one ray at a time."""
    import pyvista as pv

    faces = np.concatenate([np.full((len(mesh.faces), 1), 3), mesh.faces], axis=1)
    surface = pv.PolyData(np.asarray(mesh.vertices), faces.ravel())
    out = np.full(len(rays_o), np.nan)
    for i, (origin, direction) in enumerate(zip(rays_o, rays_d, strict=True)):
        points, _ = surface.ray_trace(origin, origin + reach * direction)
        if np.size(points):
            out[i] = float(np.linalg.norm(np.asarray(points).reshape(-1, 3) - origin, axis=1).min())
    return out
