"""Where a head's density can be: a boolean grid, and the samples of rays that lie in it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
import torch.nn.functional as F

from gazenerf.field.sampling import box_interval
from gazenerf.heads.march import Density


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
        margin: int = 2,
        within: torch.Tensor | None = None,
    ) -> Occupancy:
        """Sample a density at the cell centres and grow what exceeds the threshold (per world unit) by `margin` cells.

        The default margin, about 9 mm for the bundled box, covers how far lids move with the gaze.
        `within` (2, 3) is a box outside which the density is known to be 0 and not queried.
        """
        step = (box[1] - box[0]) / size
        axes = [box[0, i] + step[i] * (torch.arange(size, device=box.device) + 0.5) for i in range(3)]
        low, high = [0] * 3, [size] * 3
        if within is not None:
            low = [int((axes[i] < within[0, i]).sum()) for i in range(3)]
            high = [int((axes[i] <= within[1, i]).sum()) for i in range(3)]
        values = torch.zeros(size, size, size, device=box.device)
        y, z = (axes[i][low[i] : high[i]] for i in (1, 2))
        for first in range(low[0], high[0], 8):
            x = axes[0][first : min(first + 8, high[0])]
            found = density(torch.cartesian_prod(x, y, z)).reshape(len(x), len(y), len(z))
            values[first : first + len(x), low[1] : high[1], low[2] : high[2]] = found
        dense = values > threshold
        grown = F.max_pool3d(dense[None, None].float(), 2 * margin + 1, stride=1, padding=margin)[0, 0] > 0
        return cls(grown, box, values)

    @classmethod
    def union(cls, parts: Sequence[Occupancy]) -> Occupancy:
        """What any of some occupancies of one box holds, with the sum of their densities."""
        cells, density = parts[0].cells, parts[0].density
        for part in parts[1:]:
            cells, density = cells | part.cells, density + part.density
        return cls(cells, parts[0].box, density)

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
        size: int = 4,
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
