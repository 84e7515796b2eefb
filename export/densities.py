"""Density on a regular grid, and what a grid costs."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from scipy import ndimage

from gazenerf.errors import UserError
from gazenerf.field.interface import BoundField, Part

MAX_RESOLUTION = 1024
CHUNK = 2**17
MEMORY_SHARE = 0.5
BYTES_A_POINT = 14
"""Peak bytes a grid point while a volume is sampled, refined and meshed (measured, rounded up)."""

Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class DensityGrid:
    """Density at the points of a regular grid.

    Attributes:
        values: (nx, ny, nz) float32 per world unit.
        origin: (3,) world position of values[0, 0, 0].
        spacing: World units between neighbours, the same along every axis.
        queries: How many points the field was asked for.
    """

    values: np.ndarray
    origin: np.ndarray
    spacing: float
    queries: int

    def axes(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """World coordinates along x, y, z."""
        x, y, z = (self.origin[i] + self.spacing * np.arange(self.values.shape[i]) for i in range(3))
        return x, y, z


def grid_shape(box: np.ndarray, resolution: int) -> tuple[tuple[int, int, int], float]:
    """Points along each axis and their spacing, `resolution` along the longest side.

    Raises:
        UserError: the resolution is out of range or the grid would not fit in memory.
    """
    if not 8 <= resolution <= MAX_RESOLUTION:
        raise UserError(f"--resolution must lie between 8 and {MAX_RESOLUTION}, got {resolution}")
    box = np.asarray(box, dtype=np.float64)
    extent = box[1] - box[0]
    if box.shape != (2, 3) or not np.isfinite(box).all() or (extent <= 0).any():
        raise UserError("the box must be two finite corners, the lower one first")
    spacing = float(extent.max() / (resolution - 1))
    nx, ny, nz = (int(n) for n in np.floor(extent / spacing + 1e-9) + 1)
    needed, there = nx * ny * nz * BYTES_A_POINT, available_memory()
    if needed > MEMORY_SHARE * there:
        raise UserError(
            f"a grid of {nx}x{ny}x{nz} needs about {needed / 2**30:.1f} GiB, {there / 2**30:.1f} GiB are free; "
            "lower --resolution"
        )
    return (nx, ny, nz), spacing


def available_memory() -> int:
    """Bytes of memory that are free now; total memory where the system does not say."""
    try:
        return os.sysconf("SC_AVPHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    except (ValueError, OSError, AttributeError):
        return 8 * 2**30


def query(bound: BoundField, points: np.ndarray, part: Part) -> np.ndarray:
    """Density (N,) float32 at points (N, 3), checked.

    Raises:
        UserError: the field returns NaN, infinite or negative densities.
    """
    with torch.no_grad():
        values = bound.density(torch.from_numpy(np.ascontiguousarray(points, dtype=np.float32)), part).float().numpy()
    if not np.isfinite(values).all() or (values < 0).any():
        raise UserError("the field returns NaN, infinite or negative densities; its weights are damaged")
    return values


def sample_density(
    bound: BoundField, part: Part, box: np.ndarray, resolution: int, progress: Progress | None = None
) -> DensityGrid:
    """The dense grid: every point is asked for. The slow reference of `export.refine`."""
    shape, spacing = grid_shape(box, resolution)
    origin = np.asarray(box[0], dtype=np.float64)
    values = np.empty(shape, dtype=np.float32)
    total = values.size
    flat = values.reshape(-1)
    for start in range(0, total, CHUNK):
        index = np.arange(start, min(start + CHUNK, total))
        flat[index] = query(bound, grid_points(index, shape, origin, spacing), part)
        if progress is not None:
            progress(int(index[-1]) + 1, total)
    return DensityGrid(values, origin, spacing, total)


def grid_points(index: np.ndarray, shape: tuple[int, ...], origin: np.ndarray, spacing: float) -> np.ndarray:
    """World positions (N, 3) of flat grid indices (N,)."""
    place = np.stack(np.unravel_index(index, shape), axis=-1)
    return origin + spacing * place


def fill_enclosed(face: DensityGrid, eyes: DensityGrid | None, level: float) -> DensityGrid:
    """The face volume with everything that face and eyes enclose made solid.

    A trained density is right near the surfaces that pictures show and arbitrary deep inside, where
    it leaves caves and inner walls. What cannot be reached from outside without crossing face or eyes
    and is not eye becomes solid.
    """
    wall = face.values > level
    if eyes is not None:
        wall = wall | (eyes.values > level)
    outside = np.empty(wall.shape, dtype=np.int32)
    ndimage.label(~wall, output=outside)
    border = np.zeros(wall.shape, dtype=bool)
    for axis in range(3):
        for side in (0, -1):
            border[(slice(None),) * axis + (side,)] = True
    reached = np.isin(outside, np.unique(outside[border & ~wall]))
    inner = ~reached & ~wall
    values = np.where(inner, np.float32(2.0 * level), face.values)
    return DensityGrid(values, face.origin, face.spacing, face.queries)
