"""Density where a surface can be: coarse first, then cell by cell along it, the same surface as of the dense grid."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from gazenerf.devices import points_at_once
from gazenerf.export.surface.densities import DensityGrid, grid_points, grid_shape, query
from gazenerf.export.surface.known_surface import certainly_empty
from gazenerf.heads.interface import BoundField, Part

COARSE = 64
"""Coarse points along the longest side; pieces smaller than their spacing can be missed."""

CELLS = 2**17
"""Cells in one step along the surface, so that index arrays stay small."""

SLAB = 2**21
"""Points that are filled in or checked at a time."""

Empty = Callable[[np.ndarray], np.ndarray]
"""World points (N, 3) to (N,) bool: there is certainly no density at or above the levels."""

_QUERIED, _WANTED, _EMPTY = np.uint8(1), np.uint8(2), np.uint8(4)
_KNOWN = _QUERIED | _EMPTY
_CORNERS = np.stack(np.meshgrid([0, 1], [0, 1], [0, 1], indexing="ij"), axis=-1).reshape(8, 3)


def refine_density(
    bound: BoundField,
    part: Part,
    box: np.ndarray,
    resolution: int,
    levels: tuple[float, float],
    *,
    factor: int | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> DensityGrid:
    """The grid of `sample_density`, queried only near surfaces of levels between two densities.

    See `refine_grid`.

    Args:
        bound, part, box, resolution: As for `sample_density`.
        levels: Lowest and highest density at which a surface will be taken.
        factor: Fine cells along a coarse cell; so many that `COARSE` coarse points span the box if None.
        progress: Called with (cells done, cells known to be wanted).

    Raises:
        UserError: as `sample_density`.
    """
    shape, spacing = grid_shape(box, resolution)
    return refine_grid(bound, part, np.asarray(box[0], np.float64), shape, spacing, levels, factor, progress)


def refine_grid(
    bound: BoundField,
    part: Part,
    origin: np.ndarray,
    shape: tuple[int, int, int],
    spacing: float,
    levels: tuple[float, float],
    factor: int | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> DensityGrid:
    """Density at a given grid, exact at the corners of every cell that a surface of the levels crosses.

    Every `factor`-th point is queried, except those that `certainly_empty` names, whose density counts as 0, and
    every point between two of them that lie on different sides of the levels. From the crossings found there,
    cells are followed: a crossed cell is queried at its eight corners and leads on through its crossed faces. All
    other points repeat the last known value before them along z; where that makes a cell look crossed, its coarse
    cell is queried whole, and followed, until no such cell is left. Outside the grid the density is 0.

    So every crossed cell of the finished grid is exact at all corners, and what is found is whole: a
    surface goes on through a face whose corners are exact, into a cell that is crossed in the
    finished grid, too. And every surface comes out that passes between two coarse neighbours on
    different sides of it and of the levels, since all points between them are exact; missed are only
    pieces, plates and gaps thinner than a coarse cell that no such pair tells of.

    Args:
        origin: (3,) world position of the first point.
        shape: Points along each axis, at least 2.
        spacing: World units between points.
        bound, part, levels, factor, progress: As for `refine_density`.
    """
    if factor is None:
        factor = max(2, round(max(shape) / COARSE))
    front = _Front(bound, part, np.asarray(origin, np.float64) - spacing, shape, spacing, levels, progress)
    ticks = [np.unique(np.concatenate([[0], np.arange(1, n, factor), [n, n + 1]])) for n in shape]
    cells = front.sides_of_coarse(ticks, certainly_empty(bound, part, levels[0]))
    while len(cells):
        front.follow(cells)
        front.fill()
        cells = front.guessed_crossings(ticks)
    return DensityGrid(front.values[1:-1, 1:-1, 1:-1], np.asarray(origin, np.float64), spacing, front.queries)


@dataclass
class _Front:
    """A grid that is being queried along surfaces, in a frame of zeros where surfaces are closed.

    Points and cells are named by flat indices; a cell by its corner nearest to the origin, which is
    the frame's.
    """

    bound: BoundField
    part: Part
    origin: np.ndarray
    inside: tuple[int, int, int]
    spacing: float
    levels: tuple[float, float]
    progress: Callable[[int, int], None] | None = None
    queries: int = 0
    values: np.ndarray = field(init=False)

    def __post_init__(self) -> None:
        self.shape = tuple(n + 2 for n in self.inside)
        self.values = np.zeros(self.shape, dtype=np.float32)
        self.state = np.full(self.shape, _QUERIED, dtype=np.uint8)
        self.state[1:-1, 1:-1, 1:-1] = 0
        self._flat, self._marks = self.values.reshape(-1), self.state.reshape(-1)
        _, ny, nz = self.shape
        self._strides = np.array([ny * nz, nz, 1])
        self._corners = _CORNERS @ self._strides
        self._done = 0
        self._at_once = points_at_once(self.bound.device)

    def query_points(self, points: np.ndarray) -> None:
        """Query the field at points (n,) not yet queried, each once."""
        points = points[(self._marks[points] & _QUERIED) == 0]
        if not len(points):
            return
        points = np.unique(points)
        for chunk in np.split(points, range(self._at_once, len(points), self._at_once)):
            self._flat[chunk] = query(self.bound, grid_points(chunk, self.shape, self.origin, self.spacing), self.part)
        self._marks[points] |= _QUERIED
        self.queries += len(points)

    def differ(self, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        """Whether a level lies between two densities."""
        return (np.maximum(a, b) >= self.levels[0]) & (np.minimum(a, b) <= self.levels[1])

    def sides_of_coarse(self, ticks: list[np.ndarray], empty: Empty | None) -> np.ndarray:
        """Query coarse points that are not known to be empty and between those that differ.

        Returns the cells around crossings found there. Points that are known to be empty count as known, with a density
        of 0, until a surface comes so near that they are queried.
        """
        coarse = _flat(np.meshgrid(*ticks, indexing="ij"), self._strides)
        points = coarse.reshape(-1)
        if empty is not None:
            points = points[(self._marks[points] & _QUERIED) == 0]
            nothing = empty(grid_points(points, self.shape, self.origin, self.spacing))
            self._marks[points[nothing]] |= _EMPTY
            points = points[~nothing]
        self.query_points(points)
        values = self._flat[coarse]
        around = []
        for axis in range(3):
            near, far = (_along(axis, slice(None, -1)), _along(axis, slice(1, None)))
            mixed = self.differ(values[near], values[far])
            gaps = np.broadcast_to(
                np.diff(ticks[axis]).reshape([-1 if i == axis else 1 for i in range(3)]), mixed.shape
            )
            first, gap = coarse[near][mixed], gaps[mixed]
            steps = self._strides[axis] * np.arange(gap.max() if len(gap) else 0)
            edges = (first[:, None] + steps)[np.arange(len(steps)) < gap[:, None]]
            self.query_points(edges)
            edges = edges[self.differ(self._flat[edges], self._flat[edges + self._strides[axis]])]
            others = np.delete(self._strides, axis)
            place = np.stack(np.unravel_index(edges, self.shape), axis=-1)
            last = np.array(self.shape) - 2
            for back in ((0, 0), (0, 1), (1, 0), (1, 1)):
                shifted = np.delete(place, axis, axis=1) - back
                inside = ((shifted >= 0) & (shifted <= np.delete(last, axis))).all(axis=1)
                around.append(edges[inside] - others @ np.array(back))
        return np.unique(np.concatenate(around))

    def follow(self, cells: np.ndarray) -> None:
        """Query the corners of cells (n,) and of all that crossed faces lead to."""
        cells = cells[(self._marks[cells] & _WANTED) == 0]
        self._marks[cells] |= _WANTED
        waiting = [cells]
        known = self._done + len(cells)
        while waiting:
            cells = waiting.pop()
            if len(cells) > CELLS:
                waiting.append(cells[CELLS:])
                cells = cells[:CELLS]
            corners = cells[:, None] + self._corners
            self.query_points(corners.reshape(-1))
            found = self._beyond(cells, self._flat[corners])
            if len(found):
                waiting.append(found)
            self._done += len(cells)
            known += len(found)
            if self.progress is not None:
                self.progress(self._done, known)

    def _beyond(self, cells: np.ndarray, values: np.ndarray) -> np.ndarray:
        """Cells not yet wanted behind crossed faces of cells (n,) with corner values (n, 8); marks them."""
        reach = np.packbits(values >= self.levels[0], axis=1)[:, 0]
        stay = np.packbits(values <= self.levels[1], axis=1)[:, 0]
        place = np.unravel_index(cells, self.shape)
        found = []
        for axis in range(3):
            for side, step in ((0, -1), (1, 1)):
                face = np.packbits(_CORNERS[:, axis] == side)[0]
                end = 0 if side == 0 else self.shape[axis] - 2
                leads = ((reach & face) != 0) & ((stay & face) != 0) & (place[axis] != end)
                beside = cells[leads] + step * self._strides[axis]
                beside = beside[(self._marks[beside] & _WANTED) == 0]
                self._marks[beside] |= _WANTED
                found.append(beside)
        return np.concatenate(found)

    def fill(self) -> None:
        """Give points not queried the last value known before them along z."""
        for slab in self._slabs():
            _fill_along_last(self.values[slab], self.state[slab])

    def guessed_crossings(self, ticks: list[np.ndarray]) -> np.ndarray:
        """All cells of the coarse cells where a cell is crossed but was not queried at all corners.

        Two queried points tell of a surface between them that was not followed: a small piece.
        """
        found = []
        for slab in self._slabs():
            planes = slice(slab.start, slab.stop + 1)
            values = self.values[planes]
            bits = (values >= self.levels[0]).view(np.uint8)
            bits |= (values <= self.levels[1]).view(np.uint8) << 1
            bits |= ((self.state[planes] & _KNOWN) == 0).view(np.uint8) << 2
            for axis in (2, 1, 0):
                bits = bits[_along(axis, slice(None, -1))] | bits[_along(axis, slice(1, None))]
            place = np.argwhere(bits == 7)
            place[:, 0] += slab.start
            found.append(np.unique(self._blocks(place, ticks), axis=0))
        blocks = np.unique(np.concatenate(found), axis=0)
        first = np.stack([ticks[axis][blocks[:, axis]] for axis in range(3)], axis=-1)
        end = np.stack([ticks[axis][blocks[:, axis] + 1] for axis in range(3)], axis=-1)
        steps = np.arange(max(int(np.diff(t).max()) for t in ticks))
        offsets = np.stack(np.meshgrid(steps, steps, steps, indexing="ij"), axis=-1).reshape(-1, 3)
        place = first[:, None] + offsets
        return place[(place < end[:, None]).all(axis=-1)] @ self._strides

    def _slabs(self) -> list[slice]:
        planes = max(1, SLAB // (self.shape[1] * self.shape[2]))
        return [slice(i, i + planes) for i in range(0, self.shape[0], planes)]

    @staticmethod
    def _blocks(place: np.ndarray, ticks: list[np.ndarray]) -> np.ndarray:
        return np.stack([np.searchsorted(ticks[i], place[:, i], side="right") - 1 for i in range(3)], axis=-1)


def _fill_along_last(values: np.ndarray, state: np.ndarray) -> None:
    """Repeat values along the last axis where they were not queried, in place; the first was."""
    known = (state & _KNOWN) != 0
    last = np.where(known, np.arange(values.shape[-1], dtype=np.int32), np.int32(0))
    np.maximum.accumulate(last, axis=-1, out=last)
    values[...] = np.take_along_axis(values, last, axis=-1)


def _flat(place: list[np.ndarray] | tuple[np.ndarray, ...], strides: np.ndarray) -> np.ndarray:
    return sum((p * int(s) for p, s in zip(place, strides, strict=True)), np.zeros((), dtype=np.int64))


def _along(axis: int, part: slice) -> tuple[slice, ...]:
    return tuple(part if i == axis else slice(None) for i in range(3))
