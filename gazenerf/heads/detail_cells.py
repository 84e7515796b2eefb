"""Which pixel of a picture shows each cell of a map of detail."""

from __future__ import annotations

import numpy as np
import torch
from scipy.interpolate import LinearNDInterpolator

from gazenerf.field.detail import EXTENT, detail_coordinates
from gazenerf.heads.bound import BoundHead
from gazenerf.heads.interface import GeometryView
from gazenerf.heads.surface_detail import surface_places

GRAZING, FRONTAL = 0.25, 0.55
"""Cosines between normal and view: pixels count not at all below the first and fully from the second."""

SOLID = 0.99
"""Opacity from which a feature pixel shows the surface alone."""


def seen_cells(
    bound: BoundHead, geometry: GeometryView, size: int, cells: tuple[int, int]
) -> tuple[np.ndarray, np.ndarray]:
    """Where a picture shows each cell of a map of detail.

    Args:
        bound: The head at the gaze at which the picture shows it.
        geometry: Of the picture's feature map.
        size: Of the square picture.
        cells: Rows and columns of the map.

    Returns:
        pixels (H, W, 2) float32, for `cv2.remap`, and trust (H, W) float32 in [0, 1] in them; 0 where a cell is not
        shown, or at a grazing angle.
    """
    points = geometry.points()
    _, rays = geometry.camera.rays()
    normals = np.cross(np.gradient(points, axis=1), np.gradient(points, axis=0))
    facing = np.abs((normals * rays).sum(-1)) / np.linalg.norm(normals, axis=-1).clip(1e-12)
    hit = np.isfinite(facing) & np.isfinite(geometry.depth) & (geometry.opacity > SOLID)
    if np.count_nonzero(hit) < 4:  # no triangle
        return np.full((*cells, 2), -1.0, np.float32), np.zeros(cells, np.float32)
    with bound.head.quickly():
        there = torch.from_numpy(points[hit].astype(np.float32)).to(bound.device)
        places = detail_coordinates(surface_places(bound, there)).cpu().numpy()
    pixel = size / geometry.camera.width
    told = np.column_stack([(np.argwhere(hit)[:, ::-1] + 0.5) * pixel - 0.5, facing[hit]])
    rows, columns = ((np.arange(count) + 0.5) * 2.0 / count - 1.0 for count in cells)
    centres = np.stack(np.meshgrid(columns, rows), axis=-1)
    found = LinearNDInterpolator(places * EXTENT, told)(centres * EXTENT)
    found = np.nan_to_num(found, nan=-1.0).astype(np.float32)
    return found[..., :2], np.clip((found[..., 2] - GRAZING) / (FRONTAL - GRAZING), 0.0, 1.0)
