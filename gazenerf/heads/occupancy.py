"""Where a head's density can be: a boolean grid, and the samples of rays that lie in it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
import torch.nn.functional as F

from gazenerf.field.sampling import box_interval
from gazenerf.heads.march import Density

FAINT = 0.1
"""Share of the threshold; beside a density above it every cell is looked at."""

MOVED = 2
"""Cells by which what moves with the gaze may leave the cells that it occupies with the eyes straight ahead."""

OPAQUE = 8.0
"""Density per world unit from which a cell hides what is behind it; what lies outside such cells is seen."""


@dataclass(frozen=True)
class Occupancy:
    """A grid over a box: True where density may exceed a threshold, grown by a margin.

    Attributes:
        cells: (G, G, G) bool, indexed [x, y, z].
        box: (2, 3) float32.
        density: (G, G, G) float32 per world unit at the cells' centres, as sampled.
    """

    cells: torch.Tensor
    box: torch.Tensor
    density: torch.Tensor

    @classmethod
    def of(
        cls,
        density: Density,
        box: torch.Tensor,
        size: int = 64,
        threshold: float = 0.5,
        margin: int = 1,
        within: torch.Tensor | None = None,
        every: bool = False,
    ) -> Occupancy:
        """Sample a density at the cell centres and grow what exceeds the threshold (per world unit) by `margin` cells.

        Args:
            density: Of one stream.
            box: (2, 3) world units.
            size: Cells along each axis.
            threshold: Density per world unit above which a cell is occupied.
            margin: Cells.
            within: (2, 3) box outside which the density is known to be 0 and not queried.
            every: Sample every cell: the slow reference. Otherwise every second one along each axis, and
                the others only near some density that is not opaque all around: a third of a head's box.
        """
        points = _centres(box, size)
        known = _inside(points, within)
        values = torch.zeros(size, size, size, device=box.device)
        if not every:
            coarse = torch.zeros_like(known)
            coarse[::2, ::2, ::2] = True
            values[coarse & known] = density(points[coarse & known])
            known &= _unsure(values[::2, ::2, ::2], threshold, size) & ~coarse
            values = torch.where(coarse, values, _doubled(values[::2, ::2, ::2], size))
        values[known] = density(points[known])
        return cls(_grown(values > threshold, margin), box, values)

    @classmethod
    def union(cls, parts: Sequence[Occupancy]) -> Occupancy:
        """What any of some occupancies of one box holds, with the sum of their densities."""
        cells, density = parts[0].cells, parts[0].density
        for part in parts[1:]:
            cells, density = cells | part.cells, density + part.density
        return cls(cells, parts[0].box, density)

    def moving_near(self, other: Occupancy, threshold: float = 0.5, margin: int = MOVED) -> Occupancy:
        """The same, grown by `margin` cells where another occupancy or its surroundings are.

        About 9 mm for the bundled box, which covers how far lids move with the gaze.
        """
        near = _grown(other.cells, margin)
        return Occupancy(self.cells | (self.grown(margin, threshold).cells & near), self.box, self.density)

    def grown(self, margin: int, threshold: float = 0.5) -> Occupancy:
        """The same with another margin."""
        return Occupancy(_grown(self.density > threshold, margin), self.box, self.density)

    @property
    def share(self) -> float:
        """Occupied share of the box."""
        return float(self.cells.float().mean())

    def bounds(self) -> torch.Tensor | None:
        """(2, 3) smallest box around the occupied cells, None when there are none."""
        found = self.cells.nonzero()
        if not len(found):
            return None
        step = (self.box[1] - self.box[0]) / self.cells.shape[0]
        return torch.stack([self.box[0] + step * found.amin(0), self.box[0] + step * (found.amax(0) + 1)])

    def at(self, points: torch.Tensor) -> torch.Tensor:
        """(...,) bool: is each point (..., 3) in an occupied cell; False outside the box."""
        size = self.cells.shape[0]
        place = (points - self.box[0]) / (self.box[1] - self.box[0]) * size
        inside = ((place >= 0) & (place < size)).all(dim=-1)
        index = place.long().clamp(0, size - 1)
        return self.cells[index[..., 0], index[..., 1], index[..., 2]] & inside


def _grown(cells: torch.Tensor, margin: int) -> torch.Tensor:
    """(G, G, G) bool: cells, and those at most so many from one of them along each axis."""
    return F.max_pool3d(cells[None, None].float(), 2 * margin + 1, stride=1, padding=margin)[0, 0] > 0


def _centres(box: torch.Tensor, size: int) -> torch.Tensor:
    """(G, G, G, 3) centres of the cells of a box (2, 3)."""
    step = (box[1] - box[0]) / size
    place = torch.arange(size, device=box.device) + 0.5
    axes = torch.meshgrid(*(box[0, i] + step[i] * place for i in range(3)), indexing="ij")
    return torch.stack(axes, dim=-1)


def _inside(points: torch.Tensor, within: torch.Tensor | None) -> torch.Tensor:
    """(...) bool: which points (..., 3) lie in a box (2, 3)."""
    if within is None:
        return torch.ones(points.shape[:-1], dtype=torch.bool, device=points.device)
    return ((points >= within[0]) & (points <= within[1])).all(-1)


def _unsure(coarse: torch.Tensor, threshold: float, size: int) -> torch.Tensor:
    """(G, G, G) bool: cells near a density of every second cell that is neither all empty nor all opaque."""
    around = coarse[None, None]
    some = F.max_pool3d((around > FAINT * threshold).float(), 3, stride=1, padding=1)[0, 0] > 0
    full = F.max_pool3d((around <= OPAQUE).float(), 3, stride=1, padding=1)[0, 0] == 0
    return _doubled(some & ~full, size)


def _doubled(coarse: torch.Tensor, size: int) -> torch.Tensor:
    """(G, G, G): each value of a grid of every second cell, for its cell and those after it."""
    fine = coarse
    for axis in range(3):
        fine = fine.repeat_interleave(2, axis).narrow(axis, 0, size)
    return fine


class OccupiedSteps:
    """Even samples through an occupancy's box, those in occupied cells only; see `gazenerf.heads.march.Steps`.

    Args:
        occupancy: Of the density that is looked for.
        rays_o, rays_d: (R, 3).
        count: Samples through the box.
        size: Samples per ray and block.
        window: Nearest and farthest distance (R,) that are looked at; the whole box when None.
    """

    def __init__(
        self,
        occupancy: Occupancy,
        rays_o: torch.Tensor,
        rays_d: torch.Tensor,
        count: int = 96,
        size: int = 2,
        window: tuple[torch.Tensor, torch.Tensor] | None = None,
    ) -> None:
        near, far = box_interval(rays_o, rays_d, occupancy.box)
        self.width = ((far - near) / count).clamp(min=1e-9)
        t = near[:, None] + (torch.arange(count, device=near.device) + 0.5) * self.width[:, None]
        occupied = occupancy.at(rays_o[:, None] + t[..., None] * rays_d[:, None])
        if window is not None:
            occupied &= (t >= window[0][:, None]) & (t <= window[1][:, None])
        order = torch.argsort((~occupied).to(torch.uint8), dim=1, stable=True)
        self._numbers, self._t = occupied.sum(1), t.gather(1, order)
        self._start, self._size = 0, size

    def first(self) -> torch.Tensor:
        """Rays that meet an occupied cell."""
        return (self._numbers > 0).nonzero()[:, 0]

    def block(self, rays: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """The next samples in occupied cells."""
        t = self._t[rays, self._start : self._start + self._size]
        place = torch.arange(self._start, self._start + t.shape[1], device=t.device)
        return t, place < self._numbers[rays, None]

    def ahead(self, rays: torch.Tensor, hit: torch.Tensor) -> torch.Tensor:
        """Rays without a surface that have occupied samples left."""
        self._start += self._size
        return rays[~hit & (self._numbers[rays] > self._start)]
