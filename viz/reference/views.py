"""Renders of the reference head mesh: Mitsuba, pyrender, and open3d as a third opinion.

All give depth, normals and part ids at exact pixel centres, so that a field can be compared with
them, and they with each other, pixel by pixel.
"""

from __future__ import annotations

import subprocess
import sys
from dataclasses import dataclass
from functools import cache

import numpy as np

from gazenerf.errors import UserError
from gazenerf.geometry import Camera
from gazenerf.head_model import HeadMesh
from gazenerf.head_model.interface import PICTURE_LABELS
from gazenerf.head_model.ray_scenes import barycentric

RENDERERS = ("mitsuba", "pyrender", "open3d")

PATHS = 16
"""Light paths per pixel of Mitsuba's pictures."""

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
        colour: (H, W, 3) float32 sRGB picture on black, None when it was not asked for or open3d rendered.
    """

    camera: Camera
    depth: np.ndarray
    normals: np.ndarray
    parts: np.ndarray
    renderer: str
    colour: np.ndarray | None = None


def usable(renderer: str) -> bool:
    """Whether a renderer starts here; tried in another process, so that a crash stays there.

    Raises:
        UserError: unknown renderer.
    """
    return obstacle(renderer) is None


@cache
def obstacle(renderer: str) -> str | None:
    """What keeps a renderer from starting, and the fix, in one line; None when it starts.

    Raises:
        UserError: unknown renderer.
    """
    if renderer not in RENDERERS:
        raise UserError(f"unknown reference renderer {renderer!r}; there are {', '.join(RENDERERS)}")
    try:
        done = subprocess.run(
            [sys.executable, "-c", _PROBES[renderer]], capture_output=True, text=True, timeout=120, check=False
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        return f"{type(error).__name__}; {FIXES[renderer]}"
    if done.returncode == 0:
        return None
    spoken = done.stderr.strip().splitlines() or [f"it ended with code {done.returncode}"]
    return f"{spoken[-1].strip()[:160]}; {FIXES[renderer]}"


def render_reference(
    mesh: HeadMesh, cameras: list[Camera], renderer: str, illumination: np.ndarray | None = None
) -> list[ReferenceView]:
    """Views of a head mesh.

    Args:
        mesh: The head, world units.
        cameras: All of one size.
        renderer: One of `RENDERERS`; call `usable` first.
        illumination: (27,) spherical-harmonic light; asks for pictures, path traced by Mitsuba,
            shaded at the vertices by pyrender.
    """
    return {"mitsuba": _mitsuba, "pyrender": _pyrender, "open3d": _open3d}[renderer](mesh, cameras, illumination)


def _pyrender(mesh: HeadMesh, cameras: list[Camera], illumination: np.ndarray | None) -> list[ReferenceView]:
    from gazenerf.data.rasterizer import Rasterizer
    from gazenerf.head_model.shading import shade

    views = []
    with Rasterizer((cameras[0].width, cameras[0].height), supersampling=1) as rasterizer:
        for camera in cameras:
            if illumination is None:
                colours = np.zeros_like(mesh.vertices)
            else:
                colours = shade(mesh, illumination, camera.position)
            raster = rasterizer.render(mesh, colours, camera)
            picture = None if illumination is None else raster.image.astype(np.float32) / 255.0
            depth = np.where(raster.parts > 0, raster.depth, np.nan).astype(np.float32)
            normals = rasterizer.normals(mesh, camera)
            views.append(ReferenceView(camera, depth, normals, raster.parts, "pyrender", picture))
    return views


def _interpolated(mesh: HeadMesh, faces: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """(N, 3) unit vertex normals at barycentric weights (N, 3) of faces (N,)."""
    normals = (mesh.normals[mesh.faces[faces]] * weights[..., None]).sum(axis=1)
    return normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-9)


def _open3d(mesh: HeadMesh, cameras: list[Camera], illumination: np.ndarray | None) -> list[ReferenceView]:
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
        normals = np.full((*t.shape, 3), np.nan, np.float32)
        normals[seen] = _interpolated(mesh, face, barycentric(answer, seen))
        parts = np.zeros(t.shape, np.uint8)
        parts[seen] = PICTURE_LABELS[mesh.face_part[face]]
        views.append(ReferenceView(camera, np.where(seen, t, np.nan).astype(np.float32), normals, parts, "open3d"))
    return views


def _mitsuba(mesh: HeadMesh, cameras: list[Camera], illumination: np.ndarray | None) -> list[ReferenceView]:
    from gazenerf.data.mitsuba_scene import MitsubaScene

    scene = MitsubaScene(mesh, illumination, catchlight=False)
    views = []
    for camera in cameras:
        depth, normals, parts = scene.geometry(camera)
        picture = None if illumination is None else scene.picture(camera, PATHS)
        views.append(ReferenceView(camera, depth, normals, parts, "mitsuba", picture))
    return views
