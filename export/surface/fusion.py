"""Surfaces that know nothing of a threshold: rendered depth fused, or a solid fitted to oriented points.

Both see the field only through its depth in pictures, so they are a second opinion on the isosurface.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
import trimesh

from gazenerf.errors import UserError
from gazenerf.export.mesh.cleaning import without_collapsed
from gazenerf.export.surface.densities import grid_shape
from gazenerf.export.surface.density_surface import Surface, part_box
from gazenerf.geometry import Camera
from gazenerf.heads.interface import BoundField, GeometryView, Part
from gazenerf.progress import Progress, silent

SURFACES = ("isosurface", "tsdf", "poisson")

RINGS = ((-50.0, 6), (-15.0, 8), (20.0, 8), (55.0, 6))
"""Pitch, degrees, and how many cameras stand around the part there."""

POLES = (89.0, -89.0)
"""Pitch, degrees, of the cameras above and below."""

PIXELS_A_VOXEL = 1.5
MAX_PICTURE = 512


@dataclass(frozen=True)
class _Frame:
    """A cube around a part, and cameras that see all of it.

    Attributes:
        centre: (3,) world units.
        side: World units.
        spacing: World units between grid points.
        grid: Points along the cube's sides.
        cameras: Around it.
    """

    centre: np.ndarray
    side: float
    spacing: float
    grid: int
    cameras: list[Camera]


def open3d() -> Any:
    """The open3d module.

    Raises:
        UserError: it cannot be loaded.
    """
    try:
        import open3d

        return open3d
    except (ImportError, OSError) as error:
        raise UserError(
            f"this needs open3d, which cannot be loaded ({error}); "
            "pip install open3d, and on Debian: apt-get install libusb-1.0-0 libgomp1"
        ) from error


def fused_surface(
    bound: BoundField,
    part: Part,
    how: str,
    *,
    resolution: int,
    progress: Progress = silent,
) -> Surface:
    """The surface of one part from its depth in pictures all around.

    Args:
        how: `tsdf`: truncated signed distances fused in a grid (Curless and Levoy 1996); `poisson`: a
            screened Poisson solid (Kazhdan and Hoppe 2013) fitted to the pictures' points and normals.
        resolution: Grid points along the longest side of the part's box.
        progress: Told about stages.

    Raises:
        UserError: open3d cannot be loaded, impossible resolution, or no surface is seen.
    """
    o3d = open3d()
    box, queries = part_box(bound, part)
    frame = _frame(box, resolution)
    views = []
    for i, camera in enumerate(frame.cameras):
        progress(f"{part} depth", i, len(frame.cameras))
        views.append(_inside(bound.render_geometry(camera, part, normals=how == "poisson"), frame))
    if not any(np.isfinite(view.depth).any() for view in views):
        raise UserError(f"no view shows the {part} volume; it is empty, or the field's box misses the head")
    mesh = (_tsdf if how == "tsdf" else _poisson)(o3d, frame, views)
    mesh = without_collapsed(mesh)
    if mesh.volume < 0:
        mesh.invert()
    step = "TSDF fusion" if how == "tsdf" else "screened Poisson"
    steps = (f"{step} of {len(views)} depth maps of {frame.cameras[0].width} px",)
    return Surface(mesh, (frame.grid,) * 3, frame.spacing, queries, steps)


def _frame(box: np.ndarray, resolution: int) -> _Frame:
    _, spacing = grid_shape(np.asarray(box), resolution)
    centre = np.asarray(box).mean(axis=0)
    side = float(np.ptp(box, axis=0).max()) + 4.0 * spacing
    grid = round(side / spacing)
    size = min(MAX_PICTURE, int(np.ceil(PIXELS_A_VOXEL * grid / 8.0)) * 8)
    distance = max(4.0 * side, 3.0)
    fov = 2.0 * float(np.arctan(0.5 * np.sqrt(3.0) * side / distance))
    angles = [(360.0 * i / count, pitch) for pitch, count in RINGS for i in range(count)]
    angles += [(0.0, pitch) for pitch in POLES]
    target = (float(centre[0]), float(centre[1]), float(centre[2]))
    cameras = [
        Camera.orbit(*np.deg2rad(place), distance=distance, size=size, fov=fov, target=target) for place in angles
    ]
    return _Frame(centre, side, spacing, grid, cameras)


def _inside(view: GeometryView, frame: _Frame) -> GeometryView:
    """A view without the depth of what lies outside the cube."""
    away = np.abs(view.points() - frame.centre).max(axis=-1)
    return replace(view, depth=np.where(away <= 0.5 * frame.side, view.depth, np.nan).astype(np.float32))


def _tsdf(o3d: Any, frame: _Frame, views: list[GeometryView]) -> trimesh.Trimesh:
    volume = o3d.pipelines.integration.UniformTSDFVolume(
        length=frame.side,
        resolution=frame.grid,
        sdf_trunc=2.5 * frame.spacing,
        color_type=o3d.pipelines.integration.TSDFVolumeColorType.NoColor,
        origin=frame.centre - 0.5 * frame.side,
    )
    for view in views:
        camera = view.camera
        behind = float(np.linalg.norm(camera.position - frame.centre) + frame.side)
        seen = np.isfinite(view.depth)
        rim = cv2.dilate(seen.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
        # 0 is unknown: a pixel just off the silhouette must not carve what its neighbour shows
        depth = np.where(seen, view.depth_z, np.where(rim, 0.0, behind)).astype(np.float32)
        grey = o3d.geometry.Image(np.zeros_like(depth))
        picture = o3d.geometry.RGBDImage.create_from_color_and_depth(
            grey, o3d.geometry.Image(depth), depth_scale=1.0, depth_trunc=2.0 * behind, convert_rgb_to_intensity=False
        )
        # open3d has the centre of the first pixel at 0, not at 0.5
        lens = o3d.camera.PinholeCameraIntrinsic(
            camera.width, camera.height, camera.fx, camera.fy, camera.cx - 0.5, camera.cy - 0.5
        )
        volume.integrate(picture, lens, camera.camera_from_world)
    return _checked(volume.extract_triangle_mesh())


def _poisson(o3d: Any, frame: _Frame, views: list[GeometryView]) -> trimesh.Trimesh:
    points, normals = [], []
    for view in views:
        assert view.normals is not None
        facing = -(view.camera.rays()[1] * view.normals).sum(axis=-1)
        used = np.isfinite(view.depth) & (np.nan_to_num(facing, nan=-1.0) > 0.3)
        points.append(view.points()[used])
        normals.append(view.normals[used])
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(np.concatenate(points).astype(np.float64)))
    cloud.normals = o3d.utility.Vector3dVector(np.concatenate(normals).astype(np.float64))
    cloud = cloud.voxel_down_sample(0.7 * frame.spacing)
    if len(cloud.points) < 100:
        raise UserError("too few surface points to fit a solid to; raise --resolution")
    solid, _ = o3d.geometry.TriangleMesh.create_from_point_cloud_poisson(
        cloud, depth=round(np.log2(frame.grid)), scale=1.1, n_threads=1
    )
    return _checked(solid)


def _checked(surface: Any) -> trimesh.Trimesh:
    vertices, faces = np.asarray(surface.vertices), np.asarray(surface.triangles)
    if not len(faces):
        raise UserError("the depth maps hold no surface; raise --resolution")
    return trimesh.Trimesh(vertices, faces, process=False)
