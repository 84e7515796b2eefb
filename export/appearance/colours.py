"""Colours of surface points, blended from rendered views by angle and visibility."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import trimesh
from scipy.spatial import KDTree

from gazenerf.export.mesh.rays import RayCaster
from gazenerf.geometry import Camera
from gazenerf.heads.interface import BoundField, Part

VIEWS = ((0, 0), (30, 0), (-30, 0), (60, 10), (-60, 10), (0, 25), (0, -25), (90, 0), (-90, 0), (150, 5), (-150, 5))
"""Yaw and pitch, degrees, of the views that colours are taken from."""

PICTURE = 512
"""Width of those views, pixels."""

CHUNK = 2**20
"""Points that are cast and sampled at once."""

FILL_FROM = 200_000
"""Seen points, at most, that unseen ones take their colour from."""


NEAR_DEPTH = 0.15
"""World units between a point and the depth of its pixel beyond which the picture shows something else."""


@dataclass(frozen=True)
class PartPicture:
    """A picture of one part.

    Attributes:
        camera: Its camera.
        image: (H, W, 3) float32 sRGB in [0, 1].
        opacity: (H, W) float32.
        depth: (h, w) float32 Euclidean, world units, perhaps coarser; NaN where there is no surface.
    """

    camera: Camera
    image: np.ndarray
    opacity: np.ndarray
    depth: np.ndarray


def part_pictures(bound: BoundField, part: Part, views: tuple[tuple[float, float], ...] = VIEWS) -> list[PartPicture]:
    """Pictures of one part from orbit cameras at `views`, yaw and pitch in degrees, `PICTURE` pixels wide."""
    pictures, size = [], PICTURE
    for yaw, pitch in views:
        camera = Camera.orbit(float(np.deg2rad(yaw)), float(np.deg2rad(pitch)), size=size)
        view = bound.render(camera, (part,))
        geometry = view.geometry[part]
        opacity = cv2.resize(geometry.opacity, (size, size), interpolation=cv2.INTER_LINEAR)
        pictures.append(PartPicture(camera, view.images[part].astype(np.float32), opacity, geometry.depth))
    return pictures


def blend_colours(
    pictures: list[PartPicture], mesh: trimesh.Trimesh, points: np.ndarray, normals: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Colour of points on a mesh from pictures of it.

    A view counts with the third power of the cosine between its ray and the normal, less where the
    background shines through the part, where nothing lies in between and the picture is of about
    that depth. Points that no view sees take the colour of the nearest one that is seen.

    Args:
        pictures: Of the same part as the mesh.
        mesh: What hides points from views, world units.
        points, normals: (N, 3) on its surface.

    Returns:
        (N, 3) uint8 sRGB, and (N,) bool, whether some view sees the point.
    """
    total, weight = np.zeros((len(points), 3), np.float32), np.zeros(len(points), np.float32)
    cast = RayCaster(mesh)
    for start in range(0, len(points), CHUNK):
        chunk = slice(start, start + CHUNK)
        for picture in pictures:
            _add_view(picture, cast, points[chunk], normals[chunk], total[chunk], weight[chunk])
    seen = weight > 1e-6
    if seen.any():
        total[seen] /= weight[seen, None]
        if not seen.all():
            known = np.flatnonzero(seen)
            if len(known) > FILL_FROM:
                known = known[np.linspace(0, len(known) - 1, FILL_FROM).astype(int)]
            _, nearest = KDTree(points[known]).query(points[~seen])
            total[~seen] = total[known[nearest]]
    return np.clip(np.round(255.0 * total), 0, 255).astype(np.uint8), seen


def _add_view(
    picture: PartPicture,
    cast: RayCaster,
    points: np.ndarray,
    normals: np.ndarray,
    total: np.ndarray,
    weight: np.ndarray,
) -> None:
    """Add what one picture shows of points to their weighted sums, in place. Rays are cast last: they cost most."""
    camera = picture.camera
    offset = points - camera.position.astype(points.dtype)
    distance = np.sqrt(np.einsum("nc,nc->n", offset, offset))
    facing = -np.einsum("nc,nc->n", offset, normals) / distance
    near = np.flatnonzero(facing > 0.15)
    pixels, _ = camera.project(points[near])
    near, pixels = _shown(picture, near, pixels, distance)
    at_x, at_y = np.ascontiguousarray((pixels - 0.5).astype(np.float32).T)
    solid = np.clip(2.0 * sample(picture.opacity, at_x, at_y) - 1.0, 0.0, 1.0)
    there = solid > 0.0
    near, at_x, at_y, solid = near[there], at_x[there], at_y[there], solid[there]
    hit = cast(np.broadcast_to(camera.position, (len(near), 3)), offset[near] / distance[near, None])
    free = np.abs(hit - distance[near]) < 0.02
    near, at_x, at_y, solid = near[free], at_x[free], at_y[free], solid[free]
    share = facing[near] ** 3 * solid
    total[near] += (share[:, None] * sample(picture.image, at_x, at_y)).astype(np.float32)
    weight[near] += share.astype(np.float32)


def _shown(
    picture: PartPicture, near: np.ndarray, pixels: np.ndarray, distance: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Those of the points `near` that lie in the picture, and that it shows rather than something off the mesh."""
    inside = ((pixels >= 0) & (pixels < [picture.camera.width, picture.camera.height])).all(axis=1)
    near, pixels = near[inside], pixels[inside]
    height, width = picture.depth.shape
    column, row = (pixels * [width / picture.camera.width, height / picture.camera.height]).astype(int).T
    shown = np.abs(picture.depth[np.minimum(row, height - 1), np.minimum(column, width - 1)] - distance[near])
    agrees = np.isnan(shown) | (shown < NEAR_DEPTH)
    return near[agrees], pixels[agrees]


def sample(image: np.ndarray, x: np.ndarray, y: np.ndarray, width: int = 2**14) -> np.ndarray:
    """An image's values at N places, bilinear; places are in array indices, x along columns."""
    if not len(x):
        return np.zeros((0, *image.shape[2:]), image.dtype)
    rows = -(-len(x) // width)
    places = np.zeros((2, rows * width), np.float32)
    places[0, : len(x)], places[1, : len(x)] = x, y
    grid = places.reshape(2, rows, width)
    found = cv2.remap(image, grid[0], grid[1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return found.reshape(rows * width, *image.shape[2:])[: len(x)]


def with_vertex_colours(mesh: trimesh.Trimesh, rgb: np.ndarray) -> trimesh.Trimesh:
    """A copy of a mesh with vertex colours (V, 3) uint8 sRGB; normals are kept."""
    rgba = np.concatenate([rgb, np.full((len(rgb), 1), 255, np.uint8)], axis=1)
    return trimesh.Trimesh(
        mesh.vertices, mesh.faces, vertex_normals=mesh.vertex_normals, vertex_colors=rgba, process=False
    )


def vertex_colours(mesh: trimesh.Trimesh) -> np.ndarray | None:
    """(V, 4) uint8 sRGB, None where the mesh has none."""
    visual = mesh.visual
    if visual is None or visual.kind != "vertex":
        return None
    return np.asarray(visual.vertex_colors)  # pyright: ignore[reportAttributeAccessIssue]


def linear_from_srgb(colours: np.ndarray) -> np.ndarray:
    """Linear light from sRGB values in [0, 1] (IEC 61966-2-1)."""
    return np.where(colours <= 0.04045, colours / 12.92, ((colours + 0.055) / 1.055) ** 2.4)
