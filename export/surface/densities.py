"""Density on a regular grid, and what a grid costs."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from scipy import ndimage

from gazenerf.devices import points_at_once
from gazenerf.errors import UserError
from gazenerf.field.distance import laplace_distance
from gazenerf.heads.interface import BoundField, Part

MAX_RESOLUTION = 1024
MEMORY_SHARE = 0.5
BYTES_PER_POINT = 16
"""Peak bytes per grid point where the head fills the box: 11.6 measured coarse to fine, 15.5 with every point kept."""


def meant_distances(density: np.ndarray, spread: float) -> np.ndarray:
    """Signed distances that densities mean, float32, of the same shape, world units, negative inside.

    Args:
        density: What `laplace_density` gave, per world unit.
        spread: `BoundField.surface_spread`.
    """
    return laplace_distance(torch.from_numpy(density), spread).numpy()


@dataclass(frozen=True)
class DensityGrid:
    """Density at the points of a regular grid.

    Attributes:
        values: (nx, ny, nz) float32 per world unit.
        origin: (3,) world position of values[0, 0, 0].
        spacing: World units between neighbours, the same along every axis.
        queries: At how many points the field was queried.
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
    needed, there = nx * ny * nz * BYTES_PER_POINT, available_memory()
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
    bound: BoundField, part: Part, box: np.ndarray, resolution: int, progress: Callable[[int, int], None] | None = None
) -> DensityGrid:
    """The dense grid: queried at every point. The slow reference of `gazenerf.export.surface.refine`."""
    shape, spacing = grid_shape(box, resolution)
    origin = np.asarray(box[0], dtype=np.float64)
    values = np.empty(shape, dtype=np.float32)
    total = values.size
    flat = values.reshape(-1)
    chunk = points_at_once(bound.device)
    for start in range(0, total, chunk):
        index = np.arange(start, min(start + chunk, total))
        flat[index] = query(bound, grid_points(index, shape, origin, spacing), part)
        if progress is not None:
            progress(int(index[-1]) + 1, total)
    return DensityGrid(values, origin, spacing, total)


def grid_points(index: np.ndarray, shape: tuple[int, ...], origin: np.ndarray, spacing: float) -> np.ndarray:
    """World positions (N, 3) of flat grid indices (N,)."""
    place = np.stack(np.unravel_index(index, shape), axis=-1)
    return origin + spacing * place


def extent(inside: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """First index of what is inside along each axis (3,), and one past its last; zeros where nothing is."""
    low, high = np.zeros(inside.ndim, dtype=int), np.zeros(inside.ndim, dtype=int)
    for axis in range(inside.ndim):
        held = np.flatnonzero(inside.any(axis=tuple(i for i in range(inside.ndim) if i != axis)))
        if len(held):
            low[axis], high[axis] = held[0], held[-1] + 1
    return low, high


def fill_enclosed(face: DensityGrid, eyes: DensityGrid | None, level: float) -> DensityGrid:
    """The face volume, cut down to what exceeds a level, with all that face and eyes enclose made solid.

    A trained density is right near the surfaces that pictures show and arbitrary deep inside, where
    it leaves caves and inner walls. What cannot be reached from outside without crossing face or eyes
    and is not eye becomes solid.

    Args:
        face: The face's density.
        eyes: The eyes', None where there are none; its points are points of the face's grid.
        level: Per world unit.
    """
    low, high = extent(face.values > level)
    if not high.any():
        return face
    offset = np.zeros(3, dtype=int)
    if eyes is not None:
        offset = np.round((eyes.origin - face.origin) / face.spacing).astype(int)
        eye_low, eye_high = extent(eyes.values > level)
        if eye_high.any():
            low = np.minimum(low, eye_low + offset)
            high = np.maximum(high, eye_high + offset)
    low, high = np.maximum(low - 1, 0), np.minimum(high + 1, face.values.shape)
    values = face.values[_box(low, high)].copy()
    wall = values > level
    if eyes is not None:
        # the eyes' points that lie in this box
        first = np.maximum(offset, low)
        last = np.minimum(offset + eyes.values.shape, high)
        if (last > first).all():
            wall[_box(first - low, last - low)] |= eyes.values[_box(first - offset, last - offset)] > level
    values[~_reached(wall) & ~wall] = np.float32(2.0 * level)
    return DensityGrid(values, face.origin + face.spacing * low, face.spacing, face.queries)


def _box(low: np.ndarray, high: np.ndarray) -> tuple[slice, ...]:
    return tuple(slice(int(a), int(b)) for a, b in zip(low, high, strict=True))


def _reached(wall: np.ndarray) -> np.ndarray:
    """Which points (nx, ny, nz) a way around the wall joins to the border, through 6-neighbours."""
    spaces = np.empty(wall.shape, dtype=np.uint16)
    try:
        ndimage.label(~wall, output=spaces)
    except RuntimeError:  # more spaces than the small type can number
        spaces = np.empty(wall.shape, dtype=np.int32)
        ndimage.label(~wall, output=spaces)
    outside = np.zeros(int(spaces.max()) + 1, dtype=bool)
    for axis in range(wall.ndim):
        for side in (0, -1):
            outside[np.take(spaces, side, axis=axis)] = True
    outside[0] = False
    return outside[spaces]
