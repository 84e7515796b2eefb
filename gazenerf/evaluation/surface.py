"""Depth and surface of a field against what a capture and the head model know."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial import KDTree

from gazenerf.geometry import Camera
from gazenerf.head_model.interface import HeadMesh
from gazenerf.heads.interface import GeometryView


def halved_depth(depth: np.ndarray, max_step: float = 0.05) -> np.ndarray:
    """(H/2, W/2) depth at the centres of 2 x 2 blocks, NaN at holes and edges.

    Args:
        depth: (H, W) Euclidean, world units, 0 or NaN where there is no surface; even sides.
        max_step: World units; blocks that span more straddle an edge.
    """
    height, width = depth.shape
    if height % 2 or width % 2:
        raise ValueError(f"a depth map of {width}x{height} cannot be halved")
    blocks = depth.reshape(height // 2, 2, width // 2, 2).transpose(0, 2, 1, 3).reshape(height // 2, width // 2, 4)
    good = (np.nan_to_num(blocks) > 0).all(-1)
    low, high = blocks.min(-1), blocks.max(-1)
    good &= np.nan_to_num(high - low, nan=np.inf) <= max_step
    return np.where(good, blocks.mean(-1), np.nan)


def every_nth(camera: Camera, step: int) -> Camera:
    """The camera whose pixel (i, j) has the ray of pixel (step * i, step * j) of another."""
    if step == 1:
        return camera
    return replace(
        camera,
        fx=camera.fx / step,
        fy=camera.fy / step,
        cx=(camera.cx - 0.5) / step + 0.5,
        cy=(camera.cy - 0.5) / step + 0.5,
        width=-(-camera.width // step),
        height=-(-camera.height // step),
    )


def depth_errors(geometry: GeometryView, depth: np.ndarray) -> np.ndarray:
    """Absolute depth differences, world units, on the pixels where both have a surface.

    Args:
        geometry: Its depth is (H, W).
        depth: (H, W) NaN where there is no surface.
    """
    both = np.isfinite(geometry.depth) & np.isfinite(depth)
    return np.abs(geometry.depth[both] - depth[both])


def silhouette_iou(geometry: GeometryView, coverage: np.ndarray) -> float:
    """Intersection over union of opacity above one half and coverage (H, W) above one half."""
    a, b = geometry.opacity > 0.5, coverage > 0.5
    union = float((a | b).sum())
    return float((a & b).sum()) / union if union else float("nan")


def surface_points(geometry: GeometryView) -> np.ndarray:
    """(N, 3) world points of the pixels that show a surface."""
    return geometry.points()[np.isfinite(geometry.depth)]


class SurfaceDistance:
    """Distances from a surface of which samples with normals are known.

    The distance of a point is that to the tangent plane of the nearest sample where the point lies above the
    neighbourhood of that sample, and to the sample itself beyond.

    Args:
        points: (N, 3) samples, world units.
        normals: (N, 3) unit.
        spacing: Typical distance between neighbouring samples, world units; the median distance of about 500 samples
            to their nearest neighbour by default.
    """

    def __init__(self, points: np.ndarray, normals: np.ndarray, spacing: float | None = None) -> None:
        self._points, self._normals = points, normals
        self._tree = KDTree(points)
        if spacing is None:
            some = points[:: max(1, len(points) // 500)]
            spacing = float(np.median(np.asarray(self._tree.query(some, k=2)[0])[:, 1]))
        self._near = 3.0 * spacing

    @classmethod
    def of_mesh(cls, mesh: HeadMesh) -> SurfaceDistance:
        """From a head's mesh, whose samples are face centres and vertices."""
        corners = mesh.vertices[mesh.faces].astype(np.float64)
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        lengths = np.linalg.norm(normals, axis=1, keepdims=True)
        good = lengths[:, 0] > 1e-12
        return cls(
            np.concatenate([corners[good].mean(1), mesh.vertices.astype(np.float64)]),
            np.concatenate([normals[good] / lengths[good], mesh.normals.astype(np.float64)]),
            float(np.sqrt(np.median(lengths))),
        )

    def measure(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Unsigned distances (N,), world units, of points (N, 3), and the normals (N, 3) of the nearest samples."""
        found, nearest = self._tree.query(points)
        gap, normals = np.asarray(found), self._normals[nearest]
        plane = np.abs(((points - self._points[nearest]) * normals).sum(-1))
        return np.where(gap <= self._near + plane, np.minimum(plane, gap), gap), normals

    def __call__(self, points: np.ndarray) -> np.ndarray:
        """Unsigned distances (N,), world units, of points (N, 3)."""
        return self.measure(points)[0]
