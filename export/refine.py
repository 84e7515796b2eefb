"""Density where a surface can be: coarse first, then along the surface, the same result as the dense grid."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from export.densities import CHUNK, DensityGrid, Progress, grid_points, grid_shape, query
from gazenerf.field.interface import BoundField, Part

FACTOR = 4
"""Fine cells along the side of a coarse cell."""

CELLS = 2**13
"""Coarse cells in one round, so that index arrays stay small."""

_CORNERS = {"footprint": np.ones((2, 2, 2), dtype=bool), "mode": "nearest", "origin": (-1, -1, -1)}


def refine_density(
    bound: BoundField,
    part: Part,
    box: np.ndarray,
    resolution: int,
    levels: tuple[float, float],
    *,
    factor: int = FACTOR,
    progress: Progress | None = None,
) -> DensityGrid:
    """The grid of `sample_density`, asked for only near surfaces of levels between two densities.

    A grid `factor` times coarser is sampled first. Coarse cells whose corners do not all lie on one
    side of the levels are asked for all their points; where a surface leaves such a cell through a
    face, the neighbour is asked for too, until no surface leaves. Elsewhere points take the nearest
    coarse value, which lies on the same side. So every connected surface that any coarse point tells
    of comes out as in the dense grid; only separate pieces smaller than a coarse cell can be missed.

    Args:
        bound, part, box, resolution: As for `sample_density`.
        levels: Lowest and highest density at which a surface will be taken.
        factor: Fine cells along a coarse cell.
        progress: Called with (points asked for, points known to be wanted).

    Raises:
        UserError: as `sample_density`.
    """
    shape, spacing = grid_shape(box, resolution)
    origin = np.asarray(box[0], dtype=np.float64)
    cells = tuple(int(np.ceil((n - 1) / factor)) for n in shape)
    coarse_shape = tuple(n + 1 for n in cells)
    index = np.arange(int(np.prod(coarse_shape)))
    coarse = np.concatenate(
        [
            query(bound, grid_points(chunk, coarse_shape, origin, factor * spacing), part)
            for chunk in np.array_split(index, len(index) // CHUNK + 1)
        ]
    ).reshape(coarse_shape)
    nearest = [np.minimum(np.round(np.arange(n) / factor).astype(int), m) for n, m in zip(shape, cells, strict=True)]
    values = coarse[np.ix_(*nearest)]
    front = _FrontOfCells(values, cells, factor, levels)
    mixed = (ndimage.maximum_filter(coarse, **_CORNERS) > levels[0]) & (
        ndimage.minimum_filter(coarse, **_CORNERS) <= levels[1]
    )
    waiting = np.argwhere(mixed[:-1, :-1, :-1])
    front.wanted[tuple(waiting.T)] = True
    flat, asked, queries, done = values.reshape(-1), np.zeros(values.size, dtype=bool), len(index), 0
    while len(waiting):
        now, waiting = waiting[:CELLS], waiting[CELLS:]
        places = front.points(now)
        fresh = np.unique(places)
        fresh = fresh[~asked[fresh]]
        for start in range(0, len(fresh), CHUNK):
            chunk = fresh[start : start + CHUNK]
            flat[chunk] = query(bound, grid_points(chunk, shape, origin, spacing), part)
        asked[fresh] = True
        queries += len(fresh)
        waiting = np.concatenate([waiting, front.neighbours(now, places)])
        done += len(now)
        if progress is not None:
            progress(done, done + len(waiting))
    return DensityGrid(values, origin, spacing, queries)


@dataclass
class _FrontOfCells:
    """Which coarse cells are wanted, and where surfaces lead on.

    Attributes:
        values: (nx, ny, nz) the fine grid, filled in place.
        cells: Coarse cells along each axis.
        factor: Fine cells along a coarse cell.
        levels: Lowest and highest level.
    """

    values: np.ndarray
    cells: tuple[int, ...]
    factor: int
    levels: tuple[float, float]

    def __post_init__(self) -> None:
        self.wanted = np.zeros(self.cells, dtype=bool)
        steps = np.arange(self.factor + 1)
        self._offsets = np.stack(np.meshgrid(steps, steps, steps, indexing="ij"), axis=-1)

    def points(self, cells: np.ndarray) -> np.ndarray:
        """(k, f+1, f+1, f+1) flat indices of the fine points of cells (k, 3), their far faces included."""
        place = self.factor * cells[:, None, None, None] + self._offsets
        place = np.minimum(place, np.array(self.values.shape) - 1)
        return np.asarray(np.ravel_multi_index(tuple(np.moveaxis(place, -1, 0)), self.values.shape))

    def neighbours(self, cells: np.ndarray, places: np.ndarray) -> np.ndarray:
        """(m, 3) cells not yet wanted that share a face with a crossing; marks them wanted."""
        block = self.values.reshape(-1)[places]
        found = [np.empty((0, 3), dtype=cells.dtype)]
        for axis in range(3):
            for side, step in ((0, -1), (-1, 1)):
                face = np.take(block, side, axis=axis + 1).reshape(len(cells), -1)
                crossed = (face.max(axis=1) > self.levels[0]) & (face.min(axis=1) <= self.levels[1])
                beside = cells[crossed].copy()
                beside[:, axis] += step
                beside = beside[(beside[:, axis] >= 0) & (beside[:, axis] < self.cells[axis])]
                beside = beside[~self.wanted[tuple(beside.T)]]
                self.wanted[tuple(beside.T)] = True
                found.append(beside)
        return np.concatenate(found)
