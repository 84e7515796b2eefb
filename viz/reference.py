"""Renders of the reference head mesh: Mitsuba, pyrender, and open3d as a third opinion.

All give depth, normals and part ids at exact pixel centres, so that a field can be compared with
them, and they with each other, pixel by pixel.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from gazenerf.errors import UserError
from gazenerf.geometry import Camera
from gazenerf.head_model import HeadMesh

RENDERERS = ("mitsuba", "pyrender", "open3d")

FIXES = {
    "mitsuba": "pip install mitsuba",
    "pyrender": "install libegl1 (Debian: apt-get install libegl1)",
    "open3d": "install libusb-1.0-0 and libgomp1 (Debian: apt-get install libusb-1.0-0 libgomp1)",
}

_PROBES = {
    "mitsuba": "import mitsuba; mitsuba.set_variant('scalar_rgb'); mitsuba.load_dict({'type': 'sphere'})",
    "pyrender": "import os; os.environ.setdefault('PYOPENGL_PLATFORM', 'egl'); import pyrender; "
    "pyrender.OffscreenRenderer(8, 8)",
    "open3d": "import open3d; open3d.t.geometry.RaycastingScene()",
}


@dataclass(frozen=True)
class ReferenceView:
    """What a renderer says of the reference mesh from one camera.

    Attributes:
        camera: Its size is the size of the arrays.
        depth: (H, W) float32 Euclidean distance, world units, NaN where nothing is hit.
        normals: (H, W, 3) float32 interpolated unit normals, world frame, NaN where nothing is hit.
        parts: (H, W) uint8: 0 background, 1 face, 2 left eye, 3 right eye.
        renderer: Which one.
    """

    camera: Camera
    depth: np.ndarray
    normals: np.ndarray
    parts: np.ndarray
    renderer: str


@cache
def usable(renderer: str) -> bool:
    """Whether a renderer starts here; tried in another process, so that a crash stays there.

    Raises:
        UserError: unknown renderer.
    """
    if renderer not in RENDERERS:
        raise UserError(f"unknown reference renderer {renderer!r}; there are {', '.join(RENDERERS)}")
    try:
        done = subprocess.run([sys.executable, "-c", _PROBES[renderer]], capture_output=True, timeout=120, check=False)
    except (OSError, subprocess.TimeoutExpired):
        return False
    return done.returncode == 0


def render_reference(mesh: HeadMesh, cameras: list[Camera], renderer: str) -> list[ReferenceView]:
    """Views of a head mesh.

    Args:
        mesh: The head, world units.
        cameras: All of one size.
        renderer: One of `RENDERERS`; call `usable` first.
    """
    return {"mitsuba": _mitsuba, "pyrender": _pyrender, "open3d": _open3d}[renderer](mesh, cameras)


def _pyrender(mesh: HeadMesh, cameras: list[Camera]) -> list[ReferenceView]:
    from gazenerf.data.rasterizer import Rasterizer

    views = []
    with Rasterizer((cameras[0].width, cameras[0].height), supersampling=1) as rasterizer:
        for camera in cameras:
            raster = rasterizer.render(mesh, np.zeros_like(mesh.vertices), camera)
            depth = np.where(raster.parts > 0, raster.depth, np.nan).astype(np.float32)
            views.append(ReferenceView(camera, depth, rasterizer.normals(mesh, camera), raster.parts, "pyrender"))
    return views


def _interpolated(mesh: HeadMesh, faces: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """(N, 3) unit vertex normals at barycentric weights (N, 3) of faces (N,)."""
    normals = (mesh.normals[mesh.faces[faces]] * weights[..., None]).sum(axis=1)
    return normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-9)


def _open3d(mesh: HeadMesh, cameras: list[Camera]) -> list[ReferenceView]:
    import open3d as o3d

    tensor = o3d.core.Tensor.from_numpy
    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(
        tensor(np.ascontiguousarray(mesh.vertices, dtype=np.float32)),
        tensor(np.ascontiguousarray(mesh.faces, dtype=np.uint32)),
    )
    views = []
    for camera in cameras:
        rays_o, rays_d = camera.rays()
        answer = scene.cast_rays(tensor(np.concatenate([rays_o, rays_d], axis=-1).astype(np.float32)))
        t = answer["t_hit"].numpy()
        seen = np.isfinite(t)
        face = answer["primitive_ids"].numpy()[seen].astype(np.int64)
        uv = answer["primitive_uvs"].numpy()[seen]
        weights = np.stack([1.0 - uv.sum(axis=1), uv[:, 0], uv[:, 1]], axis=1)
        normals = np.full((*t.shape, 3), np.nan, np.float32)
        normals[seen] = _interpolated(mesh, face, weights)
        parts = np.zeros(t.shape, np.uint8)
        parts[seen] = mesh.face_part[face] + 1
        views.append(ReferenceView(camera, np.where(seen, t, np.nan).astype(np.float32), normals, parts, "open3d"))
    return views


def _mitsuba(mesh: HeadMesh, cameras: list[Camera]) -> list[ReferenceView]:
    """Rays through exact pixel centres, one by one in the scalar variant, which runs everywhere."""
    import mitsuba as mi
    import trimesh

    mi.set_variant("scalar_rgb")
    with tempfile.TemporaryDirectory() as folder:
        shapes: dict[str, object] = {"type": "scene"}
        for part in np.unique(mesh.face_part):
            path = Path(folder) / f"part{part}.ply"
            trimesh.Trimesh(
                mesh.vertices, mesh.part_faces(int(part)), vertex_normals=mesh.normals, process=False
            ).export(path, vertex_normal=True)
            shapes[f"part{part}"] = {"type": "ply", "filename": str(path), "id": f"part{part}"}
        scene = mi.load_dict(shapes)
    lower, upper = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    views = []
    for camera in cameras:
        rays_o, rays_d = camera.rays()
        depth = np.full(rays_d.shape[:2], np.nan, np.float32)
        normals = np.full(rays_d.shape, np.nan, np.float32)
        parts = np.zeros(depth.shape, np.uint8)
        origin = mi.Point3f(*camera.position)
        for row, column in np.argwhere(_meets_box(rays_o, rays_d, lower, upper)):
            hit = scene.ray_intersect(mi.Ray3f(origin, mi.Vector3f(*rays_d[row, column])))
            if hit.is_valid():
                depth[row, column] = hit.t
                normals[row, column] = hit.sh_frame.n
                parts[row, column] = int(hit.shape.id()[4:]) + 1
        views.append(ReferenceView(camera, depth, normals, parts, "mitsuba"))
    return views


def _meets_box(rays_o: np.ndarray, rays_d: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
    slope = np.where(np.abs(rays_d) < 1e-12, 1e-12, rays_d)
    a, b = (lower - rays_o) / slope, (upper - rays_o) / slope
    return np.minimum(a, b).max(axis=-1) <= np.maximum(a, b).min(axis=-1)
